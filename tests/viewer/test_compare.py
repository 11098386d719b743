"""Solutions through the prior, the Compare tab's tables, and ground coordinates by click."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solvers import Prior
from solvers.cameras import project
from solvers.orientation import Monoplotted
from solvers.orientation.oriented import ELLIPSE95
from tests.viewer.conftest import CAMERA, make_block, make_state
from viewer_app import theme
from viewer_app.actions import Plot, Show, Solved, Step, UsePoints, update
from viewer_app.app import App
from viewer_app.panels.compare import chosen_cluster, errors_table, predicted, solutions_table
from viewer_app.scene import scene
from viewer_app.solving_work import request
from viewer_app.spots import ellipse, ground_of, plotted
from viewer_app.state import ADVICE, COMPARED, MODELS, ONE_PASS, PRINTED, WITH_PRIOR, State, wanted
from viewer_app.values import Segments, dashed


def with_prior(sigmas: bool = True) -> State:
    """The hand-made site whose left image has a prior a few decimetres and tenths of a degree off."""
    state, (_, truth) = make_state(), make_block()
    at = truth["left"]
    prior = Prior(at.centre + np.array([0.3, -0.2, 0.4]), at.angles + np.radians([0.2, -0.1, 0.1]),
                  np.full(3, 0.5) if sigmas else None, np.radians([0.2, 0.2, 0.2]) if sigmas else None)
    left, right = state.block.images
    return replace(state, work=replace(state.work, block=replace(state.block, images=(replace(left, prior=prior), right))))


@pytest.fixture(scope="module")
def solved() -> State:
    """What the viewer's own worker finds."""
    import time

    with App(with_prior()) as app:
        end = time.monotonic() + 200
        while not app.settled() and time.monotonic() < end:
            time.sleep(0.01)
        return app.state


def test_the_prior_decides_what_is_asked_for() -> None:
    def models(state: State) -> list[str]:
        return [j.model for j in wanted(state) if j.image == "left"]

    assert models(make_state()) == [*MODELS, ADVICE]
    assert models(with_prior(sigmas=False)) == [*MODELS, ONE_PASS, PRINTED, ADVICE]
    assert models(with_prior()) == [*COMPARED, ADVICE]
    asked = {j.model: request(j) for j in wanted(with_prior()) if j.image == "left" and j.model != ADVICE}
    assert asked[PRINTED].one_pass and asked[PRINTED].form == "printed" and not asked[PRINTED].recentre
    assert asked[ONE_PASS].one_pass and asked[ONE_PASS].recentre and asked[WITH_PRIOR].prior == "weighted"


def test_every_solution_is_there_and_the_prior_helps(solved: State) -> None:
    found = {m: solved.solution(m) for m in COMPARED}
    assert all(s and s.orientation for s in found.values())
    sigma = {m: s.orientation.sigma for m, s in found.items() if s and s.orientation}
    assert (sigma[WITH_PRIOR] < sigma["perspective"]).all()


def test_the_printed_form_is_dashed_orange_and_the_others_join_on_request(solved: State) -> None:
    printed, one_pass = "/images/left/as_printed/camera", "/images/left/one_pass/camera"
    found = scene(solved)
    assert found[printed].colour == theme.ORTHOGONAL and one_pass not in found  # type: ignore[union-attr]
    lines = found[printed]
    exterior = solved.exterior(PRINTED)
    assert isinstance(lines, Segments) and len(lines.points) > 16 and exterior is not None
    assert np.abs(lines.points - exterior.centre).sum(axis=-1).min() < 1e-9
    assert printed not in scene(update(solved, Show("printed", False)))
    everything = scene(update(solved, Show("compared", True)))
    for model in ("one_pass", "as_printed", "with_prior"):
        for path in (f"{model}/camera", f"{model}/ellipsoid", f"difference/{model}"):
            assert f"/images/left/{path}" in everything


def test_differences_end_at_the_other_solution(solved: State) -> None:
    one, two = solved.exterior("perspective"), solved.exterior(WITH_PRIOR)
    found = scene(update(solved, Show("compared", True)))
    drawn, label = found["/images/left/difference/with_prior"], found["/images/left/difference/with_prior_label"]
    assert one and two and isinstance(drawn, Segments)
    factor = float(label.text.split("drawn × ")[1].split(",")[0])  # type: ignore[union-attr]
    assert np.allclose(drawn.points[0], [one.centre, one.centre + factor * (two.centre - one.centre)])


def test_dashes_cover_about_half_a_line_and_both_its_ends() -> None:
    line = np.array([[[0.0, 0, 0], [10.0, 0, 0]]])
    pieces = dashed(line, 1.0)
    lengths = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    assert np.allclose(lengths, lengths[0]) and 0.4 < lengths.sum() / 10 < 0.65
    assert np.allclose(pieces[0, 0], line[0, 0]) and np.allclose(pieces[-1, 1], line[0, 1])


def test_the_tables_say_predicted_and_actual(solved: State) -> None:
    words = solutions_table(solved)
    assert all(f"<br>{m}" in words for m in COMPARED) and words.count("±") == 30
    assert solutions_table(update(solved, Step("first"))).count("±") < 30
    errors = errors_table(solved)
    assert "actual" in errors and "error/σ" in errors
    unknown = replace(solved, assets=replace(solved.assets, truth={}))
    assert "from perspective" in errors_table(unknown) and ">actual" not in errors_table(unknown)
    advice = solved.solution(ADVICE)
    assert advice and advice.advice
    assert predicted(solved, WITH_PRIOR) is advice.advice.predicted["perspective with prior"].covariance
    own = solved.solution(PRINTED)
    assert own and own.orientation and predicted(solved, PRINTED) is own.orientation.covariance


def test_the_choice_of_control_has_a_name(solved: State) -> None:
    assert chosen_cluster(solved) == "all" and chosen_cluster(update(solved, UsePoints("group B"))) == "group B"


def test_a_place_projects_back_to_its_pixel(solved: State) -> None:
    state = update(solved, Plot(1234.0, 2345.0))
    [(_, place)] = plotted(state)
    solution = state.solution("perspective")
    assert isinstance(place, Monoplotted) and solution and solution.orientation
    local = state.assets.frame.to_local(place.ground)
    assert np.allclose(project(CAMERA, solution.orientation.local, local), [1234.0, 2345.0], atol=1e-6)
    heights = state.block.points.xyz[:, 2]
    ground = ground_of(state.work, state.assets)
    assert place.ground[2] == pytest.approx(heights.mean()) and ground.sigma == pytest.approx(heights.std())
    found = scene(state)
    assert {"/spots/1/cross", "/spots/1/ellipse", "/spots/1/label"} <= set(found)


def test_the_ellipse_holds_95_percent() -> None:
    a = np.array([[0.3, 0.1, 0.0], [0.0, 0.2, 0.05], [0.1, 0.0, 0.02]])
    covariance = a @ a.T
    ring = ellipse(covariance)
    inside = np.einsum("ni,ij,nj->n", ring[:, :2], np.linalg.inv(covariance[:2, :2]), ring[:, :2])
    assert np.allclose(np.sqrt(inside), ELLIPSE95)
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(2), covariance[:2, :2], 20000)
    share = (np.einsum("ni,ij,nj->n", draws, np.linalg.inv(covariance[:2, :2]), draws) < ELLIPSE95**2).mean()
    assert share == pytest.approx(0.95, abs=0.01)


def test_a_place_without_a_solution_says_why() -> None:
    [(_, why)] = plotted(update(make_state(), Plot(10.0, 10.0)))
    assert why == "left has no solution"


def test_a_solution_of_one_pass_arrives_like_any_other(solved: State) -> None:
    solution = solved.solution(ONE_PASS)
    job = next(j for j in wanted(with_prior()) if j.model == ONE_PASS)
    assert solution and solution.orientation
    again = update(with_prior(), Solved(job, solution.orientation.trace, solution.orientation))
    assert again.solution(ONE_PASS) is not None and again.view.ellipsoid == 0
