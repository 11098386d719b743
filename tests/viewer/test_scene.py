"""The scene says what the block says: frustums, residual vectors, the orthogonal bundle, ellipsoids; and the painter's poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solvers import Observations, Points
from solvers.block import Prior
from solvers.cameras import project
from tests.viewer.conftest import CAMERA, flat, make_state
from tests.viewer.test_actions import solve_all  # type: ignore[import-not-found]
from viewer_app import theme
from viewer_app.actions import ChoosePoint, Show, Step, SwitchPoint, update
from viewer_app.export import frustum_corners, glb, ply
from viewer_app.flying import Fly
from viewer_app.ground import lowered, nice
from viewer_app.home import LOW, PANEL, home, home_beside
from viewer_app.paint_viser import equal, frustum_pose
from viewer_app.picking import pick
from viewer_app.scene import CHI_95, scene, sight, vector_scale
from viewer_app.state import State
from viewer_app.values import Ellipsoid, Frusta, Frustum, Mesh, Plane, Segments


@pytest.fixture(scope="module")
def solved() -> State:
    return solve_all(make_state())


def test_every_kind_of_thing_is_there_in_its_colour(solved: State) -> None:
    found = scene(solved)
    kinds = {
        "/ground/terrain": Mesh,
        "/ground/grid": Segments,
        "/points/control": Segments,
        "/points/check": Segments,
        "/images/left/perspective/camera": Frustum,
        "/images/left/orthogonal/camera": Frustum,
        "/images/left/truth/camera": Frustum,
        "/images/left/initial/camera": Frustum,
        "/images/left/perspective/rays": Segments,
        "/images/left/perspective/residuals": Segments,
        "/images/left/orthogonal/parallel": Segments,
        "/images/left/orthogonal/plane": Plane,
        "/images/left/perspective/ellipsoid": Ellipsoid,
        "/images/right/perspective/camera": Frustum,
        "/images/left/difference": Segments,
    }
    assert {p: type(found.get(p)) for p in kinds} == kinds
    colours = {p: getattr(found[p], "colour", None) for p in kinds}
    assert (
        colours["/images/left/perspective/camera"] == theme.PERSPECTIVE
        and colours["/images/left/orthogonal/camera"] == theme.ORTHOGONAL
    )
    assert (
        colours["/images/left/truth/camera"] == theme.foreground(False)
        and colours["/images/left/initial/camera"] == theme.INITIAL
    )
    dark = scene(update(solved, Show("dark", True)))
    assert dark["/images/left/truth/camera"].colour == theme.foreground(True)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("terrain", "/ground/terrain"),
        ("rays", "/images/left/perspective/rays"),
        ("bundle", "/images/left/orthogonal/plane"),
        ("residuals", "/images/left/perspective/residuals"),
        ("ellipsoids", "/images/left/perspective/ellipsoid"),
        ("truth", "/images/left/truth/camera"),
        ("initial", "/images/left/initial/camera"),
        ("labels", "/points/names/G01"),
        ("perspective", "/images/left/perspective/camera"),
        ("orthogonal", "/images/left/orthogonal/camera"),
    ],
)
def test_each_switch_hides_its_thing(solved: State, name: str, path: str) -> None:
    assert path in scene(solved) and path not in scene(update(solved, Show(name, False)))


def test_without_terrain_there_is_a_plane_at_the_mean_height(solved: State) -> None:
    plane = scene(flat(solved))["/ground/plane"]
    assert isinstance(plane, Plane)
    heights = solved.assets.frame.to_local(solved.block.points.xyz)[:, 2]
    assert np.allclose(plane.corners[:, 2], heights.mean() - lowered(solved))


def test_residual_vectors_end_on_the_observed_rays(solved: State) -> None:
    seen = sight(solved, "perspective")
    assert seen is not None
    assert np.allclose(project(CAMERA, seen.exterior, seen.xyz + seen.vectors), seen.observed, atol=1e-6)
    drawn = scene(solved)["/images/left/perspective/residuals"]
    assert isinstance(drawn, Segments)
    assert np.allclose(drawn.points[:, 1] - drawn.points[:, 0], vector_scale(solved) * seen.vectors)


def test_the_orthogonal_bundle_is_parallel_and_meets_the_average_plane(solved: State) -> None:
    found = scene(solved)
    lines, plane, rays = (found[f"/images/left/orthogonal/{k}"] for k in ("parallel", "plane", "rays"))
    assert isinstance(lines, Segments) and isinstance(plane, Plane) and isinstance(rays, Segments)
    ways = lines.points[:, 1] - lines.points[:, 0]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    assert np.allclose(ways, ways[0], atol=1e-9)
    normal = np.cross(plane.corners[1] - plane.corners[0], plane.corners[2] - plane.corners[0])
    normal /= np.linalg.norm(normal)
    assert abs(abs(normal @ ways[0]) - 1) < 1e-9
    feet = rays.points[:, 1]
    assert np.allclose((feet - plane.corners[0]) @ normal, 0, atol=1e-6)
    assert np.allclose(np.cross(feet - lines.points[:, 0], ways[0]), 0, atol=1e-6)
    assert np.allclose(rays.points[:, 0], rays.points[0, 0])


def test_the_ellipsoid_is_the_95_percent_one_times_its_exaggeration(solved: State) -> None:
    drawn, solution = scene(solved)["/images/left/perspective/ellipsoid"], solved.solution("perspective")
    assert isinstance(drawn, Ellipsoid) and solution and solution.orientation
    q = drawn.axes @ np.diag((drawn.radii / solved.view.ellipsoid / CHI_95) ** 2) @ drawn.axes.T
    assert np.allclose(q, solution.orientation.covariance[:3, :3], rtol=1e-9)
    assert np.isclose(np.linalg.det(drawn.axes), 1.0)
    assert solved.view.ellipsoid == nice(solved.view.ellipsoid)
    assert "/images/left/perspective/ellipsoid" not in scene(update(solved, Step("first")))


def test_a_near_coincidence_is_drawn_exaggerated_and_says_so(solved: State) -> None:
    found = scene(solved)
    one, two = solved.exterior("perspective"), solved.exterior("orthogonal")
    assert one and two
    drawn, label = found["/images/left/difference"], found["/images/left/difference_label"]
    assert isinstance(drawn, Segments)
    factor = float(label.text.rsplit("× ", 1)[1])  # type: ignore[union-attr]
    assert np.allclose(drawn.points[0, 1] - drawn.points[0, 0], factor * (two.centre - one.centre))
    assert factor > 1


def test_a_point_switched_off_turns_grey_and_leaves_the_rays(solved: State) -> None:
    before, after = scene(solved), scene(update(solved, SwitchPoint("G02")))
    assert "/points/off" not in before and "/points/off" in after and "/points/chosen" in after
    rays = "/images/left/perspective/rays"
    assert len(after[rays].points) == len(before[rays].points) - 1  # type: ignore[union-attr]


def test_frustum_poses_agree_with_projection(solved: State) -> None:
    """Through viser's quaternion (x right, y down, z forward) a point lands where the collinearity equations put it."""
    import viser.transforms as tf

    exterior = solved.exterior("perspective")
    assert exterior is not None
    wxyz, position = frustum_pose(exterior)
    xyz = solved.assets.frame.to_local(solved.block.points.xyz)
    camera = tf.SO3(wxyz).inverse().apply(xyz - position)
    focal = CAMERA.c / CAMERA.pitch
    pixels = camera[:, :2] / camera[:, 2:] * focal + (np.array([CAMERA.width, CAMERA.height]) - 1) / 2
    assert np.allclose(pixels, project(CAMERA, exterior, xyz), atol=1e-6)


def test_frustum_corners_are_the_corners_of_the_photo(solved: State) -> None:
    frustum = scene(solved)["/images/left/perspective/camera"]
    assert isinstance(frustum, Frustum)
    pixels = project(CAMERA, frustum.exterior, frustum_corners(frustum))
    assert np.allclose(pixels, [[-0.5, -0.5], [5999.5, -0.5], [5999.5, 3999.5], [-0.5, 3999.5]], atol=1e-6)


def test_only_what_changed_differs(solved: State) -> None:
    one, two = scene(solved), scene(update(solved, ChoosePoint("G04")))
    assert {p for p in one.keys() | two.keys() if p not in one or p not in two or not equal(one[p], two[p])} == {
        "/points/chosen", "/points/names/G04"}


def test_a_click_means_the_point_under_it_or_the_image(solved: State) -> None:
    xyz = solved.assets.frame.to_local(solved.block.points.xyz)
    eye = np.array([20.0, -400.0, 250.0])
    assert pick(solved, eye, xyz[2] - eye, 0.005) == pick(solved, eye, 3 * (xyz[2] - eye), 0.005) == SwitchPoint("G03")
    assert pick(solved, eye, eye - xyz[2], 0.005) is None
    frustum = scene(solved)["/images/right/perspective/camera"]
    middle = frustum_corners(frustum).mean(axis=0)  # type: ignore[arg-type]
    chosen = pick(solved, eye, middle - eye, 1e-4)
    assert chosen == Fly("through", "right")


def test_projects_with_less_still_make_a_scene(solved: State) -> None:
    block = solved.block
    bare = make_state()
    nothing = replace(
        block.observations,
        image=block.observations.image[:0],
        point=block.observations.point[:0],
        pixel=block.observations.pixel[:0],
        sigma=block.observations.sigma[:0],
    )
    unmeasured = replace(bare, work=replace(bare.work, block=replace(block, observations=nothing)))
    assert "/points/control" in scene(unmeasured) and "/images/left/perspective/camera" not in scene(unmeasured)


def test_the_scene_leaves_as_glb_and_ply(solved: State) -> None:
    import io

    import trimesh

    found = scene(solved)
    back: Any = trimesh.load(io.BytesIO(glb(found)), file_type="glb")
    assert "/ground/terrain" in back.graph.nodes and "/images/left/perspective/camera" in back.graph.nodes
    mesh: Any = trimesh.load(io.BytesIO(ply(found)), file_type="ply")
    terrain = found["/ground/terrain"]
    assert isinstance(terrain, Mesh) and len(mesh.faces) > len(terrain.faces)
    low, high = mesh.bounds
    centre = solved.exterior("perspective")
    assert centre is not None and low[2] < -15 and high[2] >= centre.centre[2]


def test_an_image_of_which_only_the_position_is_known_is_a_cross_there(state: State) -> None:
    places = np.array([[500080.0, 5400180.0, 410.0], [500150.0, 5400230.0, 420.0]])
    images = tuple(replace(i, prior=Prior(centre=p)) for i, p in zip(state.block.images, places, strict=True))
    nothing = np.empty((0, 3))
    none = Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))
    block = replace(state.block, images=images, points=Points((), nothing, nothing, ()), observations=none)
    bare = replace(state, work=replace(state.work, block=block), assets=replace(state.assets, truth={}, terrain=None))
    found = scene(bare)
    for image, place in zip(images, bare.assets.frame.to_local(places), strict=True):
        cross = found[f"/images/{image.name}/georeferenced/position"]
        assert isinstance(cross, Segments) and cross.colour == theme.GEOREFERENCED
        assert np.allclose(cross.points.mean(axis=(0, 1)), place)
    eye, at, far = home(bare)
    assert np.linalg.norm(eye - at) < 10 * np.ptp(places, axis=0).max() < far
    hidden = scene(replace(bare, view=replace(bare.view, georeferenced=False)))
    assert not [p for p in hidden if p.endswith("/position")]


def test_images_that_gps_and_imu_alone_place_stand_there_with_few_nodes_for_many(
    state: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unsolved images are drawn at their priors: one by one as frustums, many of them in one node, at the same places."""
    priors = [Prior(centre=np.array([500080.0 + 9 * k, 5400180.0, 410.0]), angles=np.array([0.1, -0.2, 0.3 + k])) for k in (0, 1)]
    images = tuple(replace(i, prior=p) for i, p in zip(state.block.images, priors, strict=True))
    bare = replace(state, work=replace(state.work, block=replace(state.block, images=images)))
    one = {n: scene(bare)[f"/images/{n}/georeferenced/camera"] for n in ("left", "right")}
    monkeypatch.setattr("viewer_app.scene.MANY", 1)
    many = scene(bare)["/images/georeferenced"]
    other = one["right"]
    assert isinstance(many, Frusta) and isinstance(other, Frustum) and len(many.centres) == 1  # the chosen one is by itself
    assert np.allclose(many.centres[0], other.exterior.centre) and np.allclose(many.matrices[0], other.exterior.m, atol=1e-12)


@pytest.mark.parametrize("size", [(866, 800), (2146, 1440), (1700, 700), (500, 1400), (300, 300)])
def test_the_first_view_shows_every_point_and_camera_beside_the_panel(state: State, size: tuple[float, float]) -> None:
    solved = solve_all(state)
    eye, at = home_beside(solved, *size, np.radians(45))
    away = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(away, [0, 0, 1.0]) / np.linalg.norm(np.cross(away, [0, 0, 1.0]))
    cameras = [e.centre for i in solved.block.images if (e := solved.exterior("perspective", i.name)) is not None]
    places = np.vstack([solved.assets.frame.to_local(solved.block.points.xyz), *cameras]) - eye
    depth = places @ away
    x, y = (places @ axis / depth * size[1] / 2 / np.tan(np.radians(22.5)) for axis in (right, np.cross(right, away)))
    x, y = x + size[0] / 2, y + size[1] / 2  # from the lower left corner
    assert (depth > 0).all() and x.min() > 0 and y.min() > 0 and x.max() < size[0] and y.max() < size[1]
    if min(size) > 400:
        assert (x > PANEL).all() or (y > LOW).all()
