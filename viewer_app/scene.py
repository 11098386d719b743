"""State -> scene values, pure: the ground, the points, and for every image its solutions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solvers import Block, Exterior, Interior
from solvers.cameras import ideal_photo
from solvers.geometry.rotation import exp_many
from solvers.orientation import Orientation

from . import theme
from .bars import furniture
from .bundle_rows import exterior as bundled
from .ground import ground, known_points, nice, points, site, symbol_size
from .kept import by_identity
from .looking import looked_through
from .sighting import position, prior
from .spots import spots
from .state import MODELS, ONE_PASS, PRINTED, WITH_PRIOR, Assets, State, Work
from .values import Ellipsoid, Frusta, Frustum, Label, Plane, Scene, Segments, dashed, frustum_corners

CHI_95 = 2.7954834829151074
"""Square root of the 95 % quantile of chi-square with 3 degrees of freedom: the factor of a 95 % error ellipsoid."""


DASHED = {
    ONE_PASS: (theme.ORTHOGONAL, 0.25, 1.35),
    PRINTED: (theme.ORTHOGONAL, 0.12, 1.5),
    WITH_PRIOR: (theme.PERSPECTIVE, 0.25, 0.9),
}
"""Solutions with the prior, drawn dashed in their model's colour: length of a dash and size, both in frustum depths."""

LINE = 0.45
"""Height of a line of words over a frustum, in frustum depths."""
COLOURS = {**theme.MODELS, **{model: colour for model, (colour, *_) in DASHED.items()}}


@dataclass(frozen=True, eq=False)
class Sight:
    """What one image sees of its control points at the row shown: everything drawn between camera and ground.

    names; xyz (n, 3) local; observed, projected (n, 2) px of the full photo; used (n,) takes part in the solution.
    """

    exterior: Exterior
    interior: Interior
    names: tuple[str, ...]
    xyz: np.ndarray
    observed: np.ndarray
    projected: np.ndarray
    used: np.ndarray

    @property
    def residuals(self) -> np.ndarray:
        """(n, 2) px, observed minus projected."""
        return self.observed - self.projected

    @property
    def vectors(self) -> np.ndarray:
        """(n, 3) m: from each point to its observed ray, at the point's depth; NaN behind the camera."""
        measured = self.interior.ideal(self.observed)
        computed = ideal_photo(self.interior.c, self.exterior, self.xyz)
        depth = -self.exterior.camera(self.xyz)[:, 2]
        offset = np.concatenate([measured - computed, np.zeros((len(self.xyz), 1))], axis=1)
        return (offset * (depth / self.interior.c)[:, None]) @ self.exterior.m


def scene(state: State, images: bool = True) -> Scene:
    """All that is to be seen; images: also those oriented one by one."""
    if not images:
        seen = {path: value for path, value in points(state).items() if path != "/points/tie"}
        return {**ground(state), **furniture(state, None), **seen, **spots(state)}
    found: Scene = {**ground(state), **furniture(state, vector_scale(state)), **points(state), **spots(state)}
    depth = frustum_depth(state)
    if len(state.block.images) > MANY:
        return found | _many(state, depth) | _image(state, state.image, depth)
    for image in state.block.images:
        found |= _image(state, image.name, depth)
    return found


MANY = 60
"""Images above which the others than the chosen one are drawn together, without names and photos."""


def _many(state: State, depth: float) -> Scene:
    """All images but the chosen one, one node per kind of solution."""
    found: Scene = {}
    half, chosen = _half(state.block), state.block.image_index(state.image)
    for model in MODELS:
        names, vectors = final_vectors(state.work, model)
        on = np.flatnonzero(names != chosen)
        if getattr(state.view, model) and len(on):
            size = depth * (1 if model == "perspective" else 1.2)
            centres, matrices = vectors[on, :3], vectors[on, 3:12].reshape(-1, 3, 3)
            found[f"/images/{model}"] = Frusta(centres, matrices, half[names[on]], size, theme.MODELS[model])
    if state.view.georeferenced:
        solved = np.concatenate([final_vectors(state.work, model)[0] for model in MODELS])
        every, centres, matrices = _priors(state.block, state.assets)
        on = ~np.isin(every, [*solved, chosen])
        if on.any():
            shown = Frusta(centres[on], matrices[on], half[every[on]], 0.7 * depth, theme.GEOREFERENCED)
            found["/images/georeferenced"] = shown
    return found


@by_identity(2)
def _priors(block: Block, assets: Assets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images (k,) by number whose prior is complete, its centres (k, 3) in the local frame and matrices (k, 3, 3)."""
    given = [(k, i.prior) for k, i in enumerate(block.images) if i.prior is not None]
    complete = [(k, p.centre, p.angles) for k, p in given if p.centre is not None and p.angles is not None]
    if not complete:
        return np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3))
    centres = assets.frame.to_local(np.array([centre for _, centre, _ in complete], float))
    omega, phi, kappa = (exp_many(-angle[:, None] * axis) for angle, axis in zip(
        np.array([angles for *_, angles in complete], float).T, np.eye(3), strict=True))
    return np.array([k for k, *_ in complete]), centres, kappa @ phi @ omega


@by_identity(4)
def _half(block: Block) -> np.ndarray:
    """Tangents (n, 2) of half the angles of view of every image."""
    cameras = np.array([(c.width * c.pitch[0], c.height * c.pitch[1]) for c in block.cameras.values()])
    cameras /= 2 * np.array([c.c for c in block.cameras.values()])[:, None]
    number = {name: k for k, name in enumerate(block.cameras)}
    return cameras[np.fromiter((number[image.camera] for image in block.images), int, len(block.images))]


@lru_cache(maxsize=4)
def final_vectors(work: Work, model: str) -> tuple[np.ndarray, np.ndarray]:
    """Images (k,) by number that have a solution by a model, and its last pose (k, 12): centre, matrix by rows."""
    solutions = work.solutions
    every = [solutions.get((image.name, model)) for image in work.block.images]
    names = [k for k, s in enumerate(every) if s is not None and s.rows]
    if not names:
        return np.zeros(0, int), np.zeros((0, 12))
    poses = np.concatenate([s.rows[-1].x[:12] for s in every if s is not None and s.rows])
    return np.array(names), poses.reshape(-1, 12)


def sight(state: State, model: str, image: str | None = None) -> Sight | None:
    """What an image (the chosen one) sees at the row shown by a model; None where there is no solution."""
    name, solution = image or state.image, state.solution(model, image)
    if solution is None or not solution.rows:
        return None
    return _sight(state.work, state.assets, model, name, state.row_of(solution, name))


@lru_cache(maxsize=16)
def _sight(work: Work, assets: Assets, model: str, name: str, row: int) -> Sight:
    block, solution = work.block, work.solutions[name, model]
    exterior = Exterior.from_vector(solution.rows[row].x)
    rows = block.seen_in(name, ("control", "check"))
    index = block.observations.point[rows]
    xyz = assets.frame.to_local(block.points.xyz[index])
    known = np.isfinite(xyz).all(axis=1)
    rows, index, xyz = rows[known], index[known], xyz[known]
    interior = block.camera_of(name)
    if solution.orientation and solution.orientation.interior:
        interior = solution.orientation.interior
    names = tuple(block.points.names[j] for j in index)
    rejected = set(solution.orientation.rejected) if solution.orientation else set()
    projected = interior.measured(ideal_photo(interior.c, exterior, xyz))
    control = [block.points.role[j] == "control" for j in index]
    used = np.array([c and n not in work.off and n not in rejected for n, c in zip(names, control, strict=True)], bool)
    return Sight(exterior, interior, names, xyz, block.observations.pixel[rows], projected, used)


def vector_scale(state: State) -> float:
    """The exaggeration of residual vectors that is drawn: the one asked for, less while they would leave the site."""
    seen = next((s for m in MODELS if getattr(state.view, m) and (s := sight(state, m)) is not None), None)
    longest = 0.0 if seen is None or not len(seen.xyz) else float(np.linalg.norm(np.nan_to_num(seen.vectors), axis=1).max())
    low, high = site(state)
    room = 0.3 * float((high - low)[:2].max())
    return state.view.vectors if longest * state.view.vectors <= room else max(nice(room / longest), min(1.0, state.view.vectors))


def shown_on_photo(state: State) -> Sight | None:
    """The solution whose residuals are drawn on the photo: the first there is."""
    return next((s for m in MODELS if (s := sight(state, m)) is not None), None)


def photo_scale(state: State) -> float:
    """The exaggeration of residual vectors on the photo: the one asked for, less while one would be longer than a fifth of it."""
    seen, wish = shown_on_photo(state), state.view.photo_vectors
    if seen is None:
        return wish
    longest, room = float(np.linalg.norm(np.nan_to_num(seen.residuals), axis=1).max(initial=0.0)), seen.interior.width / 5
    return wish if longest * wish <= room else min(wish, max(nice(room / longest), 1.0))


def frustum_depth(state: State) -> float:
    """Depth (m) at which image planes are drawn: a twelfth of the way to the ground, at least a tenth of the site; of what the
    images cover where no point is known."""
    xyz, at = _known(state), centres(state)
    spread = xyz if len(xyz) else at
    site = float(np.linalg.norm(np.ptp(spread, axis=0))) if len(spread) else 1.0
    far = float(np.median(np.linalg.norm(at - xyz.mean(axis=0), axis=1))) if len(at) and len(xyz) else 0.0
    return nice(max(0.07 * site, 0.08 * far, 1e-3))


def ellipsoid_scale(state: State, orientation: Orientation) -> float:
    """The exaggeration that makes an error ellipsoid about as large as a frustum."""
    largest = CHI_95 * float(np.sqrt(max(np.linalg.eigvalsh(orientation.covariance[:3, :3])[-1], 0.0)))
    return float(np.clip(nice(0.8 * frustum_depth(state) / largest), 1.0, 1000.0)) if largest > 0 else 1.0


def centres(state: State) -> np.ndarray:
    """Where the images are (n, 3), as far as anything says so."""
    if len(state.block.images) > MANY:
        found = next((v for m in MODELS if len(v := final_vectors(state.work, m)[1])), None)
        if found is not None:
            return found[:, :3]
    names = [i.name for i in state.block.images[: 4 * MANY]]
    at = [position(state, n) if (e := any_exterior(state, n)) is None else e.centre for n in names]
    return np.array([p for p in at if p is not None]).reshape(-1, 3)


def _known(state: State) -> np.ndarray:
    return known_points(state.assets, state.block.points)


def any_exterior(state: State, image: str) -> Exterior | None:
    """Where an image is, as far as anything says so, in the local frame."""
    for model in MODELS:
        solution = state.solution(model, image)
        if solution and solution.rows:
            return Exterior.from_vector(solution.rows[-1].x)
    return bundled(state, image) or state.assets.truth.get(image) or prior(state, image)


def _image(state: State, name: str, depth: float) -> Scene:
    view, chosen, found = state.view, name == state.image, Scene()
    path = "/images/" + name.replace("/", "_")
    interior = state.block.camera_of(name)
    px, py = interior.pitch
    lens = 2 * float(np.arctan(interior.height * py / 2 / interior.c)), interior.width * px / (interior.height * py)
    photo = state.assets.photos.get(name)
    thumbnail = photo.thumbnail if photo and view.photos and looked_through(state) != name else None
    for model in MODELS:
        exterior = state.exterior(model, name)
        if exterior is None or not getattr(view, model):
            continue
        first = model == "perspective"
        # The orthogonal frustum is a little larger, so that neither hides the other where they coincide.
        found[f"{path}/{model}/camera"] = Frustum(
            exterior,
            *lens,
            depth=depth * (1 if first else 1.2),
            colour=theme.MODELS[model],
            thickness=3.0 if chosen else 1.5,
            image=thumbnail if first else None,
        )
        found |= _ellipsoid(state, name, model, exterior, f"{path}/{model}/ellipsoid")
        if chosen:
            found |= _chosen(state, model, f"{path}/{model}")
    if chosen:
        found |= _with_prior(state, path, depth, lens)
    start = _start(state, name)
    if view.initial and chosen and start is not None:
        found[f"{path}/initial/camera"] = Frustum(start, *lens, depth * 0.8, theme.INITIAL, 1.5)
    given = prior(state, name)
    alone = all(state.exterior(model, name) is None for model in MODELS)
    if view.georeferenced and given is not None and (chosen or alone):
        shown = Frustum(given, *lens, depth * 0.7, theme.GEOREFERENCED, 3.0 if chosen and alone else 1.5)
        found[f"{path}/georeferenced/camera"] = replace(shown, image=thumbnail if alone else None)
    place = position(state, name)
    if view.georeferenced and given is None and place is not None:
        arms = place + symbol_size(state) * np.array([[[-1, 0, 0], [1, 0, 0]], [[0, -1, 0], [0, 1, 0]], [[0, 0, -1], [0, 0, 1]]])
        found[f"{path}/georeferenced/position"] = Segments(arms, theme.GEOREFERENCED, 3.0 if chosen else 1.5)
    truth = state.assets.truth.get(name)
    if view.truth and truth is not None:
        found[f"{path}/truth/camera"] = Frustum(truth, *lens, depth * 0.6, theme.foreground(view.dark), 1.0)
    somewhere = any_exterior(state, name)
    at = place if somewhere is None else somewhere.centre
    up = 0.35 * depth if somewhere is not None else 1.4 * symbol_size(state)
    if view.labels and at is not None and (chosen or not view.compared):
        found[f"{path}/label"] = image_name(name, at + np.array([0, 0, up]), chosen)
    return found | (_difference(state, path, depth) if chosen else {})


def image_name(name: str, at: np.ndarray, chosen: bool) -> Label:
    """An image's name over its frustum (3,); that of the chosen one is never hidden."""
    return Label(name, at, 1.15, "center-center") if chosen else Label(name, at, 0.9, "bottom-center")


def _start(state: State, name: str) -> Exterior | None:
    for model in MODELS:
        solution = state.solution(model, name)
        if solution and solution.rows:
            return Exterior.from_vector(solution.rows[0].x)
    return prior(state, name)


def _chosen(state: State, model: str, path: str) -> Scene:
    """Rays, bundle and residual vectors of the chosen image."""
    seen, view, found = sight(state, model), state.view, Scene()
    if seen is None or not seen.used.any():
        return found
    centre, on = seen.exterior.centre, seen.used
    vectors = np.nan_to_num(seen.vectors)
    if model == "perspective" and view.rays:
        found[f"{path}/rays"] = Segments(_lines(centre, (seen.xyz + vectors)[on]), theme.MODELS[model], 1.0)
    if model == "orthogonal" and view.bundle:
        found |= _bundle(state, seen, path)
    if view.residuals and (model == "perspective" or not view.perspective):
        ends = seen.xyz + vector_scale(state) * vectors
        found[f"{path}/residuals"] = Segments(np.stack([seen.xyz, ends], axis=1), theme.RESIDUAL, 3.0)
    return found


def _bundle(state: State, seen: Sight, path: str) -> Scene:
    """The orthogonal model made visible: parallel rays carry the points to the average plane, which is then seen in perspective.

    The plane goes through the centroid of the control, across the projecting direction: the mean ray when the bundle is
    re-centred, else the optical axis. Reference: Ono & Hattori 2002.
    """
    xyz, exterior = seen.xyz[seen.used], seen.exterior
    axis = -exterior.m[2]
    if state.work.settings.recentre:
        photo = seen.interior.ideal(seen.observed[seen.used])
        rays = np.column_stack([photo, np.full(len(photo), -seen.interior.c)])
        mean = (rays / np.linalg.norm(rays, axis=1)[:, None]).mean(axis=0) @ exterior.m
        axis = mean / np.linalg.norm(mean)
    middle = xyz.mean(axis=0)
    feet = xyz + ((middle - xyz) @ axis)[:, None] * axis
    reach = 0.3 * float((middle - exterior.centre) @ axis)
    right = exterior.m[0] - (exterior.m[0] @ axis) * axis
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    across = np.stack([(feet - middle) @ right, (feet - middle) @ up], axis=1)
    low, high = across.min(axis=0), across.max(axis=0)
    margin = 0.12 * max(float(np.linalg.norm(high - low)), 1e-3)
    low, high = low - margin, high + margin
    corners = middle + np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]) @ np.stack(
        [right, up]
    )
    colour = theme.ORTHOGONAL
    return {
        f"{path}/parallel": Segments(np.stack([xyz, feet - reach * axis], axis=1), colour, 1.5),
        f"{path}/rays": Segments(_lines(exterior.centre, feet), pale(colour, state.view.dark), 1.0),
        f"{path}/plane": Plane(corners, colour, 0.22),
        f"{path}/plane_edge": Segments(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), colour, 1.5),
    }


def _ellipsoid(state: State, name: str, model: str, exterior: Exterior, path: str, factor: float | None = None) -> Scene:
    """The 95 % error ellipsoid of a centre, a priori; only where the adjustment has ended, for there it holds."""
    solution = state.solution(model, name)
    ended = solution is not None and state.row_of(solution, name) >= len(solution.rows) - 1
    if not (state.view.ellipsoids and ended and solution and solution.orientation):
        return {}
    values, axes = np.linalg.eigh(solution.orientation.covariance[:3, :3])
    axes = axes * np.sign(np.linalg.det(axes))
    radii = CHI_95 * (state.view.ellipsoid if factor is None else factor) * np.sqrt(np.clip(values, 0, None))
    return {path: Ellipsoid(exterior.centre, axes, np.maximum(radii, 1e-6), COLOURS[model])}


def _with_prior(state: State, path: str, depth: float, lens: tuple[float, float]) -> Scene:
    """What the chosen image's prior allows as well, dashed: the papers' printed form, and the others when they are compared."""
    found, view = Scene(), state.view
    for model, (colour, dash, size) in DASHED.items():
        exterior = state.exterior(model)
        if exterior is None or not (view.printed if model == PRINTED else view.compared):
            continue
        at = f"{path}/{model.replace(' ', '_')}"
        corners = frustum_corners(Frustum(exterior, *lens, depth * size, colour))
        edges = np.concatenate([_lines(exterior.centre, corners), np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])
        found[f"{at}/camera"] = Segments(dashed(edges, dash * depth), colour, 2.0)
        solution = state.solution(model)
        if view.compared and solution and solution.orientation:
            factor = min(view.ellipsoid, ellipsoid_scale(state, solution.orientation))
            found |= _ellipsoid(state, state.image, model, exterior, f"{at}/ellipsoid", factor)
    return found


def _difference(state: State, path: str, depth: float) -> Scene:
    """Arrows from the perspective centre to the others, exaggerated where they nearly coincide; all of them when compared."""
    one, view, found = state.exterior("perspective"), state.view, Scene()
    if one is None or not view.perspective:
        return found
    up = 0.35 + LINE * (1 if view.compared else 2)  # above the names of neighbours
    shown = (["orthogonal"] if view.orthogonal else []) + (list(DASHED) if view.compared else [])
    for model in shown:
        two = state.exterior(model)
        length = 0.0 if two is None else float(np.linalg.norm(two.centre - one.centre))
        if two is None or not 1e-9 < length or (length >= 0.5 * depth and not view.compared):
            continue
        factor = max(nice(1.5 * depth / length), 1.0)
        end = one.centre + factor * (two.centre - one.centre)
        key = f"{path}/difference" + ("" if model == "orthogonal" else "/" + model.replace(" ", "_"))
        ink = theme.foreground(view.dark) if model == "orthogonal" else COLOURS[model]
        found[key] = Segments(np.stack([one.centre, end])[None], ink, 3.0)
        if view.labels:
            drawn = "" if model == "orthogonal" else _ellipsoid_words(state, model)
            words = f"{model} − perspective\n{length:.3f} m, drawn × {factor:g}{drawn}"
            found[f"{key}_label"] = Label(words, one.centre + np.array([0, 0, up * depth]), 0.85, "center-center")
            up += LINE
    return found


def _ellipsoid_words(state: State, model: str) -> str:
    """The exaggeration of a compared solution's ellipsoid where it is smaller than that of the others."""
    solution = state.solution(model)
    factor = ellipsoid_scale(state, solution.orientation) if solution and solution.orientation else state.view.ellipsoid
    return f", ellipsoid × {factor:g}" if state.view.ellipsoids and factor < state.view.ellipsoid else ""


def _lines(centre: np.ndarray, ends: np.ndarray) -> np.ndarray:
    return np.stack([np.broadcast_to(centre, ends.shape), ends], axis=1)


def pale(colour: theme.Colour, dark: bool) -> theme.Colour:
    """Half way to the background: lines have no transparency of their own."""
    back = theme.BACKGROUND_DARK if dark else theme.BACKGROUND_LIGHT
    r, g, b = ((c + d) // 2 for c, d in zip(colour, back, strict=True))
    return r, g, b
