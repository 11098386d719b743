"""Wrong data of a block is found and named, and does not stop the rest."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Block
from solvers.orientation import adjust
from solvers.orientation.bundle.rescue import control_in_feet
from solvers.simulation import field_long_range, uav_block

BLOCK = uav_block(1, strips=2, images=3, ties=60, control=6, checks=3, fine=False).block


def given(change) -> Block:
    xyz = BLOCK.points.xyz.copy()
    change(xyz)
    return replace(BLOCK, points=replace(BLOCK.points, xyz=xyz))


def feet(xyz: np.ndarray) -> None:
    xyz[2] /= 0.3048


def height_in_feet(xyz: np.ndarray) -> None:
    xyz[2, 2] /= 0.3048


def exchanged(xyz: np.ndarray) -> None:
    xyz[[0, 3]] = xyz[[3, 0]]


def five_metres(xyz: np.ndarray) -> None:
    xyz[0, 0] += 5


@pytest.mark.parametrize(("change", "said"), [
    (feet, "'G0003' does not fit the others by .*its X, Y, Z look given in feet"),
    (height_in_feet, "'G0003' does not fit the others by .*its Z look given in feet"),
    (exchanged, "control points 'G0001' and 'G0004' look exchanged"), (five_metres, "'G0001' does not fit the others by 4.9")])
def test_wrong_control_is_named_and_left_out(change, said: str) -> None:
    import re

    got = adjust(given(change))
    assert got.trace.converged and got.sigma0 is not None and got.sigma0 < 1.3
    assert re.search(said, got.warnings[0]) and any("left out of the control" in w for w in got.warnings)
    assert got.check_rms is not None


def test_photos_exchanged_are_named() -> None:
    of = BLOCK.observations
    image = of.image.copy()
    image[of.image == 1], image[of.image == 4] = 4, 1
    got = adjust(replace(BLOCK, observations=replace(of, image=image)))
    assert got.trace.converged and got.sigma0 is not None and got.sigma0 < 1.3
    assert got.warnings[0].startswith("images 'S1_02' and 'S2_02' look exchanged")


def test_good_data_is_left_alone() -> None:
    assert not any("does not fit" in w or "exchanged" in w for w in adjust(BLOCK).warnings)


def test_all_coordinates_of_all_control_in_feet_are_named() -> None:
    assert BLOCK.crs == "local"
    got = adjust(given(lambda xyz: np.divide(xyz, 0.3048, out=xyz)))
    assert got.trace.converged and got.warnings[0].startswith("the control points look given in feet")
    assert not any("feet" in w for w in adjust(BLOCK).warnings)


def test_positions_too_coarse_to_tell_feet_accuse_nobody() -> None:
    rng, said = np.random.default_rng(5), 0
    at = {i.name: i.prior.centre for i in BLOCK.images if i.prior is not None and i.prior.centre is not None}
    middle = np.mean(list(at.values()), axis=0)
    near = {n: middle + 0.02 * (c - middle) for n, c in at.items()}  # a camera that hardly moved
    for _ in range(2000):
        images = tuple(replace(i, prior=replace(i.prior, centre=near[i.name] + rng.normal(0, 5, 3))) for i in BLOCK.images
                       if i.prior is not None)
        said += bool(control_in_feet(replace(BLOCK, images=images), near))
    assert said == 0


def test_heights_of_all_control_in_feet_are_named() -> None:
    xyz = BLOCK.points.xyz.copy()
    xyz[np.array(BLOCK.points.role) == "control", 2] /= 0.3048
    got = adjust(replace(BLOCK, points=replace(BLOCK.points, xyz=xyz)))
    assert got.warnings[0].startswith("the heights of all control points look given in feet")


def test_marks_exchanged_in_one_image_are_named() -> None:
    of = BLOCK.observations
    ties = [j for j, role in enumerate(BLOCK.points.role) if role == "tie"]
    rows = np.flatnonzero((of.image == 2) & np.isin(of.point, ties))[[3, 9]]
    point = of.point.copy()
    point[rows] = point[rows[::-1]]
    got = adjust(replace(BLOCK, observations=replace(of, point=point)))
    names = sorted(BLOCK.points.names[j] for j in of.point[rows])
    assert all(f"'{n}'" in got.warnings[0] for n in names) and "look exchanged in image" in got.warnings[0]


def test_a_mark_under_the_name_of_another_point_is_named_and_no_other() -> None:
    """Three rays and more to the point whose name was taken: all but one agree."""
    of = BLOCK.observations
    rays = np.bincount(of.point, minlength=len(BLOCK.points))
    ties = np.array(BLOCK.points.role) == "tie"
    here = set(of.point[of.image == 2].tolist())
    taken = next(j for j in np.flatnonzero(ties & (rays >= 3)) if j not in here)
    row = next(k for k in np.flatnonzero(of.image == 2) if ties[of.point[k]] and rays[of.point[k]] >= 3)
    point = of.point.copy()
    point[row] = taken
    got = adjust(replace(BLOCK, observations=replace(of, point=point)))
    name = BLOCK.points.names[taken]
    assert f"the mark of '{name}' in '{BLOCK.images[2].name}'; correct observations.csv" in got.warnings[0]
    assert got.trace.converged and got.sigma0 is not None and 0.7 < got.sigma0 < 1.3


def apart() -> Block:
    """The two strips, with no mark of the first that the second shares."""
    of = BLOCK.observations
    keep = (of.image >= 3) | ~np.isin(of.point, np.unique(of.point[of.image >= 3]))
    return replace(BLOCK, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                               sigma=of.sigma[keep]))


def test_parts_that_share_no_point_are_named() -> None:
    got = adjust(apart(), datum="both")
    assert any(w.startswith("the block falls into 2 parts that share no point") and "'S2_01'" in w for w in got.warnings)
    got = adjust(apart(), datum="free")
    assert len(got.orientations) == 3 and any("share no point; not adjusted is that of image(s) 'S" in w for w in got.warnings)


def test_a_flat_object_far_away_is_begun_with_both_reversals_tried() -> None:
    """28 targets nearly in one plane at 105 m, coordinates rounded to half a metre: each image has two solutions alike."""
    got = adjust(field_long_range(16, relief=0.2, images=3).block, datum="free")
    assert got.trace.converged and got.sigma0 is not None and 0.7 < got.sigma0 < 1.3
