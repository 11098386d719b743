"""The documentation site: every page is in its navigation, every example is numbered and opens with what it shows."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md"))


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"[\w/.-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    assert set(PAGES) <= listed, f"add to nav in mkdocs.yml: {sorted(set(PAGES) - listed)}"
    assert listed - set(PAGES) <= {"index.md", "changelog.md", "contributing.md"}


@pytest.mark.parametrize("page", [*PAGES, "../README.md"])
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", (DOCS / page).read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text):
        assert (DOCS / page).parent.joinpath(target).exists(), f"{page} links to {target}"


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_every_example_is_a_tutorial(path):
    assert re.match(r"\d\d_\w+\.py", path.name)
    assert "You will see" in (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "")
