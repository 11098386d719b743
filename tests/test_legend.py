"""One legend: viewer, recording, report, studies, figures of the documentation and 3D files take their colours from one place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from solvers import legend
from solvers.io.exchange import solid
from solvers.studies import page
from viewer_app import theme

ROOT = Path(__file__).parent.parent
DRAWING = [*(ROOT / "solvers").rglob("*.py"), *(ROOT / "docs").glob("*.py")]


def grey(colour: str) -> bool:
    return len(set(re.findall("..", colour[1:]))) == 1


def test_a_light_ground_shows_the_legend_itself() -> None:
    assert theme.legend(dark=False) == legend.PAPER
    assert theme.legend(dark=True) == {**legend.PAPER, "truth": theme.FOREGROUND_DARK}
    assert len(set(legend.INKS.values())) == len(legend.PAPER)


def test_studies_and_3d_files_speak_it() -> None:
    assert set(page.COLOURS.values()) == set(legend.INKS.values())
    assert {k: c for k, c in solid.COLOURS.items() if k in legend.PAPER} == {k: legend.PAPER[k] for k in ("control", "check")}


def test_nothing_that_draws_has_colours_of_its_own() -> None:
    """Greys and the pale paper of a marked row aside."""
    paper = {"#fff3e6", "#fff8f2"}
    found = {(path.relative_to(ROOT).as_posix(), colour) for path in DRAWING
             for colour in re.findall(r"#[0-9a-f]{6}\b", path.read_text(encoding="utf-8").lower())}
    assert not [(path, colour) for path, colour in sorted(found) if not grey(colour) and colour not in paper]


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "studies").glob("*.svg")), ids=lambda p: p.stem)
def test_figures_of_the_studies_wear_today_s_colours(path: Path) -> None:
    used = set(re.findall(r"#[0-9a-f]{6}\b", path.read_text(encoding="utf-8")))
    colours = {c for c in used if not grey(c)}
    assert colours <= set(legend.INKS.values()) and (colours or path.stem == "none"), sorted(colours - set(legend.INKS.values()))
