"""The house: who may import whom, what importing costs, and that every public function says what it gives."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FILES = sorted(p for folder in ("solvers", "viewer_app") for p in (ROOT / folder).rglob("*.py"))
TASK_ROOMS = ("orientation", "matching", "mosaic", "io")

TIERS = {"errors": 0, "legend": 0, "compiled": 0, "cameras": 0, "geometry": 0, "adjustment": 1, "block": 2, "simulation": 3,
         "execution": 3, "orientation": 4, "matching": 4, "mosaic": 4, "io": 4,
         "workflows": 5, "report": 5, "studies": 6, "cli": 7}
"""Imports run down: a room imports from lower tiers only (and from itself)."""

PEERS = {"cameras", "geometry", "errors", "compiled", "workflows", "report"}
"""Rooms of one tier that know each other."""

MAY_IMPORT = {
    "viser": r"viewer_app/(app|bridge|eyes|paint_viser|tabs|palette|panels/\w+)\.py",
    "rerun": r"viewer_app/(paint_rerun|rerun_\w+)\.py",
    "rasterio": r"solvers/io/\w+\.py",
    "pyproj": r"solvers/(io/\w+|geometry/frame)\.py",
    "dask": r"solvers/execution\.py",
    "distributed": r"solvers/execution\.py",
    "matplotlib": r"solvers/(report(_\w+)?|studies(/\w+)?)\.py",
    "threadpoolctl": r"solvers/adjustment/fronts\.py",
    "isal": r"solvers/io/cog\.py",
    "typst": r"solvers/report_pdf\.py",
    "jinja2": r"solvers/report_html\.py",
    "numba": r"solvers/(\w+/)*_kernels\.py",
}
HEAVY = ("numba", "viser", "rerun", "rasterio", "trimesh", "cv2", "scipy", "matplotlib", "PIL", "pyproj", "dask", "rich", "tyro",
         "jinja2", "typst")


def room(path: Path) -> str:
    """The room of a file of `solvers`: its folder, or its own name at the top; workflows_x.py belongs to workflows, and so on."""
    name = path.relative_to(ROOT / "solvers").with_suffix("").parts[0]
    return name.split("_")[0] if name.startswith(("workflows_", "report_", "cli_")) else name


def imported(path: Path, top_level_only: bool = False) -> Iterator[tuple[str, int]]:
    """Absolute dotted names that a file imports, with their line."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = tree.body if top_level_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[:len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module, node.lineno
            yield from ((f"{module}.{alias.name}", node.lineno) for alias in node.names)


def test_no_circle_of_imports():
    """Not even through an import inside a function. A package's face (__init__.py) hands names on and is not followed."""
    files = {".".join(p.relative_to(ROOT).with_suffix("").parts): p for p in FILES if p.name != "__init__.py"}
    graph = {name: {other for other, _ in imported(path) if other in files and other != name} for name, path in files.items()}
    TopologicalSorter(graph).prepare()


def test_every_room_has_a_tier():
    rooms = {room(p) for p in FILES if p.is_relative_to(ROOT / "solvers")} - {"__init__"}
    assert rooms <= set(TIERS), f"give {rooms - set(TIERS)} a tier"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_run_down(path):
    below = path.is_relative_to(ROOT / "solvers")
    if below and room(path) == "__init__":
        return
    for name, line in imported(path):
        parts = name.split(".")
        where = f"{path.relative_to(ROOT)}:{line} imports {name}"
        if below and parts[0] == "viewer_app":
            assert room(path) == "cli" and (name, line) not in set(imported(path, top_level_only=True)), where
        if below and parts[0] == "solvers" and len(parts) > 1 and parts[1] in TIERS and parts[1] != room(path):
            assert TIERS[parts[1]] < TIERS[room(path)] or {parts[1], room(path)} <= PEERS, where
            assert not (parts[1] in TASK_ROOMS and room(path) in TASK_ROOMS), where
        if parts[0] in MAY_IMPORT:
            assert re.fullmatch(MAY_IMPORT[parts[0]], path.relative_to(ROOT).as_posix()), where


def test_the_walk_sees_relative_imports():
    found = dict(imported(ROOT / "solvers" / "orientation" / "single.py"))
    assert "solvers.adjustment" in found and "solvers.orientation.control" in found and "solvers.block" in found


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout


def test_importing_solvers_is_light():
    code = ("import time; t = time.process_time(); import solvers, sys; spent = time.process_time() - t\n"
            f"print(min(spent, 9.0), *[m for m in {HEAVY!r} if m in sys.modules])")
    runs = [python(code).split() for _ in range(3)]
    assert runs[0][1:] == [], f"importing solvers loads {runs[0][1:]}"
    assert min(float(r[0]) for r in runs) < 0.3


@pytest.mark.parametrize("name", ["orientation", "adjustment", "geometry", "cameras", "block"])
def test_importing_a_room_is_light(name):
    loaded = python(f"import solvers.{name}, sys; print(*[m for m in {HEAVY!r} if m in sys.modules])").split()
    assert loaded == []


def test_help_is_quick():
    if not (ROOT / "solvers" / "cli.py").exists():
        pytest.skip("there is no command line yet")
    resource = pytest.importorskip("resource")
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, "-m", "solvers.cli", "--help"], capture_output=True, text=True, cwd=ROOT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert done.returncode == 0 and "resect" in done.stdout
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(spent) < 0.5


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_public_functions_say_what_they_give(path):
    """All of the solvers'; of the viewer, those longer than a few lines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if path.name != "__init__.py" or tree.body:
        assert ast.get_docstring(tree), f"{path.relative_to(ROOT)} has no docstring"
    public = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
              and (path.is_relative_to(ROOT / "solvers") or (node.end_lineno or 0) - node.lineno > 8)]
    missing = [f"{node.name} (line {node.lineno})" for node in public if not ast.get_docstring(node)]
    assert not missing, f"{path.relative_to(ROOT)}: no docstring: {', '.join(missing)}"


FOREIGN = re.compile(r"(?<![\w.~])/(work|root|opt|home|Users)/\w|index-url|trusted-host|https?://[\w.-]*(mirror|proxy|registry)",
                     re.I)


def test_no_word_of_one_machine():
    suffixes = {".py", ".md", ".toml", ".csv", ".json", ".txt", ".html", ".yml", ".cfg", ""}
    tracked = subprocess.run(["git", "ls-files"], capture_output=True, text=True, cwd=ROOT)
    if tracked.returncode != 0:
        pytest.skip("not a git checkout")
    for name in tracked.stdout.splitlines():
        path = ROOT / name
        if path.suffix in suffixes and path.is_file() and path != Path(__file__):
            for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
                assert not FOREIGN.search(line), f"{name}:{number}: {line.strip()[:100]}"


def test_every_formula_that_is_cited_is_on_the_page() -> None:
    headings = re.findall(r"^#+ (\d(?:\.\d)?)\.? ", (ROOT / "docs" / "formulas.md").read_text("utf-8"), re.MULTILINE)
    cited = {n for path in FILES for n in re.findall(r"docs/formulas\.md (\d(?:\.\d)?)", path.read_text("utf-8"))}
    assert cited and cited <= set(headings)
