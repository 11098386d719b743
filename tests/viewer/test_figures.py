"""Figures beside the iterations say what the solution says; looking through an image puts every pixel on its own ray."""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers.cameras import project
from tests.viewer.conftest import CAMERA, make_state
from tests.viewer.test_actions import solve_all  # type: ignore[import-not-found]
from viewer_app import theme
from viewer_app.actions import Show, update
from viewer_app.figures import FIGURES, ChooseFigure, Figure, correlation, to_final
from viewer_app.flying import Fly, through
from viewer_app.looking import Looking, Opacity, looked_through
from viewer_app.overlay import overlay, textured_glb, view_through
from viewer_app.panels.figures import correlation_html, elements_html, residuals_html
from viewer_app.panels.legend import legend_html
from viewer_app.panels.widgets import css
from viewer_app.scene import sight, vector_scale
from viewer_app.state import State
from viewer_app.values import Overlay


@pytest.fixture(scope="module")
def solved(picture: Path) -> State:
    return solve_all(make_state(picture))


def test_the_figures_follow_each_other_and_unknown_ones_are_refused(solved: State) -> None:
    now, seen = solved, []
    for _ in FIGURES:
        seen.append(now.room(Figure).name)
        now = update(now, ChooseFigure())
    assert tuple(seen) == FIGURES and now.room(Figure) == Figure() and update(now, ChooseFigure("nonsense")) is now


def test_elements_end_at_their_final_values(solved: State) -> None:
    solution = solved.solution("perspective")
    assert solution
    difference = to_final(solution)
    assert difference.shape == (len(solution.rows), 6) and not difference[-1].any() and np.abs(difference[0]).max() > 0
    first, last = (solution.rows[k].x[:3] for k in (0, -1))
    assert np.allclose(difference[0, :3], first - last)
    html = elements_html(solved, lambda row, hint: f'data-row="{row}"')
    assert html.count("<svg") == 6 and html.count('data-row="0"') == 6


def test_the_heat_map_is_the_correlation_of_the_covariance(solved: State) -> None:
    solution = solved.solution("perspective")
    assert solution and solution.orientation
    matrix = correlation(solution)
    sigma = solution.orientation.sigma
    assert matrix is not None and np.allclose(matrix * np.outer(sigma, sigma), solution.orientation.covariance[:6, :6])
    drawn = np.array([float(r) for r in re.findall(r'data-r="([^"]+)"', correlation_html(solved))])
    assert len(drawn) == 72 and np.allclose(drawn[:36].reshape(6, 6), matrix, atol=1e-4)
    running = replace(solution, orientation=None)
    assert correlation(running) is None


def test_residual_vectors_are_drawn_to_the_scale_they_name(solved: State) -> None:
    html, seen = residuals_html(solved), sight(solved, "perspective")
    assert seen is not None and html.count("data-residual") == 2 * len(seen.names)
    times = float(re.search(r"× ([\d.e+]+) to fit", html)[1])  # type: ignore[index]
    mine = html[html.index("perspective:") - 200 :]
    drawn = np.array([[float(v) for v in pair] for pair in re.findall(r"perspective: .*?l(-?[\d.]+) (-?[\d.]+)", mine)])
    assert np.allclose(drawn, times * seen.residuals, atol=0.06)


def test_the_legend_names_every_colour_and_exaggeration(solved: State) -> None:
    for dark in (False, True):
        html = legend_html(update(solved, Show("dark", dark)))
        assert all(css(colour) in html for colour in theme.legend(dark).values())
        assert f"ground × {vector_scale(solved):g}" in html and f"ellipsoids × {max(solved.view.ellipsoid, 1):g}" in html


def test_looking_through_an_image_and_back(solved: State) -> None:
    now = update(solved, Fly("through", "right"))
    assert now.image == looked_through(now) == "right" and "Esc" in now.message and through(now) == Fly("back", "")
    assert not looked_through(update(now, Fly("back", ""))) and through(solved) == Fly("through", "left")
    assert not looked_through(update(now, Fly("image", "left"))) and not looked_through(update(solved, Fly("through", "x")))
    assert update(now, Opacity(7.0)).room(Looking).opacity == 1.0
    assert update(now, Opacity(float("nan"))) is now and update(now, Opacity("1")) is now  # type: ignore[arg-type]


def test_every_pixel_of_the_overlay_lies_on_its_ray(solved: State) -> None:
    state = update(solved, Fly("through", "left"))
    [laid] = overlay(state).values()
    exterior = state.exterior("perspective")
    assert isinstance(laid, Overlay) and exterior is not None and not overlay(solved)
    pixels = project(CAMERA, exterior, laid.vertices)
    assert np.allclose(pixels, laid.places * [CAMERA.width, CAMERA.height] - 0.5, atol=1e-6)
    for aspect in (0.5, 1.0, 2.5):
        seen = view_through(state, "left", aspect)
        assert seen is not None
        position, at, up, fov = seen
        axis = (at - position) / np.linalg.norm(at - position)
        rays = laid.vertices - position
        high = np.abs(rays @ up / (rays @ axis)).max() / np.tan(fov / 2)
        wide = np.abs(rays @ np.cross(axis, up) / (rays @ axis)).max() / np.tan(fov / 2) / aspect
        assert max(high, wide) == pytest.approx(1 / 1.04, abs=1e-3)


def test_the_overlay_is_valid_gltf(solved: State) -> None:
    import io

    import trimesh

    [laid] = overlay(update(solved, Fly("through", "left"))).values()
    data = textured_glb(laid)  # type: ignore[arg-type]
    size = struct.unpack("<I", data[8:12])[0]
    head = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    assert size == len(data) and head["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][3] == 0.6
    back = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh")
    assert np.allclose(back.vertices, laid.vertices, atol=1e-3)  # type: ignore[union-attr]
