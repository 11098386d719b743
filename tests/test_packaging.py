"""What is packed: both names start, one version, no test data in the wheel, every import is declared."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import solvers
from solvers.cli import main

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
NAMES = {"cv2": "opencv-python-headless", "PIL": "pillow", "rerun": "rerun-sdk", "rerun_cli": "rerun-sdk",
         "rerun_bindings": "rerun-sdk",
         "tomli_w": "tomli-w"}
CARRIED = {"msgspec": "viser", "websockets": "viser", "zstandard": "viser", "imageio": "viser", "pyarrow": "rerun-sdk",
           "affine": "rasterio", "llvmlite": "numba", "starlette": "viser"}
"""Imported by us, brought and pinned by one of our dependencies."""


def declared() -> set[str]:
    groups = [PROJECT["project"]["dependencies"], PROJECT["project"]["optional-dependencies"]["cluster"]]
    return {line.split(">=")[0].split("[")[0].strip().lower() for group in groups for line in group}


def test_the_version_stands_in_one_place(capsys):
    assert "version" not in PROJECT["project"] and "version" in PROJECT["project"]["dynamic"]
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.split()[-1] == solvers.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{solvers.__version__}]" in changes or "## [Unreleased]" in changes


def test_the_viewer_starts_as_a_module_too():
    done = subprocess.run([sys.executable, "-m", "viewer_app", "--help"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and "demo project" in done.stdout
    refused = subprocess.run([sys.executable, "-m", "viewer_app", "nowhere"], capture_output=True, text=True, cwd=ROOT)
    assert refused.returncode == 1 and "nowhere" in refused.stderr and "Traceback" not in refused.stderr


def test_the_wheel_holds_the_product_alone():
    tool = PROJECT["tool"]["setuptools"]
    assert tool["packages"]["find"]["include"] == ["solvers*", "viewer_app*"]
    files = [f for patterns in tool["data-files"].values() for pattern in patterns for f in ROOT.glob(pattern)]
    assert files and all(f.is_relative_to(ROOT / "assets" / "demo") for f in files)
    assert sum(f.stat().st_size for f in files) < 8_000_000


@pytest.mark.parametrize("folder", ["solvers", "viewer_app"])
def test_every_import_is_declared(folder):
    known = declared() | {"solvers", "viewer_app"} | set(sys.stdlib_module_names)
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else \
                [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            for name in (n.split(".")[0] for n in names):
                package = CARRIED.get(name, NAMES.get(name, name)).lower().replace("_", "-")
                where = f"{path.relative_to(ROOT)} imports {name}, which pyproject.toml does not declare"
                assert name in known or package in known, where
