"""What the documentation site makes from the repository itself, so that there is one truth.

The front page comes from README.md, a tutorial from each numbered example (its text, its code, what it prints), the
reference from the rooms' own lists of names.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("solvers", "solvers.geometry", "solvers.cameras", "solvers.adjustment", "solvers.orientation", "solvers.matching",
         "solvers.mosaic", "solvers.io", "solvers.simulation", "solvers.studies")


def on_config(config: Any) -> Any:
    """Fill in the parts of the navigation that the repository decides."""
    config["nav"] = [_filled(entry) for entry in config["nav"]]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    pages = {"index.md": _front(), "changelog.md": _text("CHANGELOG.md"), "contributing.md": _text("CONTRIBUTING.md"),
             **{f"tutorials/{p.stem}.md": _tutorial(p) for p in _examples()},
             **{f"api/{room}.md": _reference(room) for room in _rooms()}}
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def _filled(entry: Any) -> Any:
    lists = {"tutorials/*": [f"tutorials/{p.stem}.md" for p in _examples()], "api/*": [f"api/{room}.md" for room in _rooms()]}
    return {title: lists.get(inside, inside) if isinstance(inside, str) else inside for title, inside in entry.items()}


def _examples() -> list[Path]:
    return sorted((ROOT / "examples").glob("[0-9]*.py"))


def _rooms() -> list[str]:
    return [room for room in ROOMS if _names(room)]


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _front() -> str:
    """README.md with its links as seen from the site, without the marks that CI reads."""
    text = re.sub(r"<!--.*?-->\n?", "", _text("README.md"), flags=re.S)
    text = text.replace("](docs/", "](").replace("](examples)", f"](tutorials/{_examples()[0].stem}.md)")
    for name, page in (("CHANGELOG.md", "changelog.md"), ("CONTRIBUTING.md", "contributing.md")):
        text = text.replace(f"]({name})", f"]({page})")
    return f"---\nhide: [toc]\n---\n{text}"  # room for its pictures and commands


def _tutorial(path: Path) -> str:
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    words = ast.get_docstring(tree) or ""
    title, _, rest = words.partition("\n")
    code = "\n".join(source.splitlines()[tree.body[0].end_lineno:]).strip()
    rest = re.sub(r"^    (python .*)$", r"    $ \1", rest.strip(), flags=re.M)
    return (f"# {title.rstrip('.')}\n\n{rest}\n\n## What it prints\n\n```text\n{_printed(path)}\n```\n\n"
            f"## The code\n\n```python title=\"{path.relative_to(ROOT).as_posix()}\"\n{code}\n```\n")


def _printed(path: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "110", "MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, cwd=ROOT, env=environment, timeout=300)
    if done.returncode:
        raise SystemExit(f"{path.name} failed:\n{done.stderr}")
    return done.stdout.rstrip()


def _names(room: str) -> list[str]:
    """`__all__` of a room, read without importing it."""
    path = ROOT.joinpath(*room.split("."), "__init__.py")
    tree = ast.parse(path.read_text(encoding="utf-8")) if path.exists() else ast.parse("")
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return list(ast.literal_eval(node.value))
    return []


def _reference(room: str) -> str:
    members = "".join(f"\n        - {name}" for name in _names(room))
    return f"# {room}\n\n::: {room}\n    options:\n      members:{members}\n"
