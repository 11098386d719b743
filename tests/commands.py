"""The commands as tests call them: what they print for other programs, how they refuse, the demo without its photos."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from solvers.cli import main
from solvers.io import demo_assets


def run(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    """What a command that succeeds prints with `--json -`."""
    assert main([*map(str, words), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: object, code: int = 1) -> str:
    """The sentence with which a command refuses; checks all that every refusal must be."""
    capsys.readouterr()
    assert main([*map(str, words)]) == code
    out, err = capsys.readouterr()
    assert out == "" and "Traceback" not in err
    assert err.startswith("collinea: ") and err.count("\n") == 1 and err.endswith("\n"), err
    return err


def demo_without_photos(folder: Path) -> Path:
    """A copy of the demo project in folder / "demo", without its photos and runs."""
    shutil.copytree(demo_assets(), folder / "demo", ignore=shutil.ignore_patterns("images", "runs"))
    text = (folder / "demo" / "project.toml").read_text()
    (folder / "demo" / "project.toml").write_text(re.sub(r"^file = \"images/.*\n", "", text, flags=re.M))
    return folder / "demo"
