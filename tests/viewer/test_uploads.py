"""Files that a browser hands over: names that lead nowhere else, content that is what the name says, nothing overwritten."""

from __future__ import annotations

from pathlib import Path

import pytest

from solvers import BadProject
from viewer_app.uploads import base_name, inside, keep_map

TIFF = b"II*\x00" + bytes(20)


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("map.tif", "map.tif"),
        ("../../etc/passwd", "passwd"),
        (r"C:\maps\a b.tif", "a_b.tif"),
        ("/root/.ssh/id", "id"),
        ("..", ""),
        (".hidden.tif", "hidden.tif"),
        ("a\x00b\n.tif", "a_b_.tif"),
        ("x" * 500 + ".tif", "x" * 76 + ".tif"),
    ],
)
def test_only_a_plain_name_is_left(said: str, kept: str) -> None:
    assert base_name(said) == kept


@pytest.mark.parametrize("head", [b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+"])
def test_a_map_is_kept_inside_the_project(tmp_path: Path, head: bytes) -> None:
    assert keep_map(tmp_path, "../../map.tif", head + b"rest") == "maps/map.tif"
    assert (tmp_path / "maps" / "map.tif").read_bytes() == head + b"rest"
    assert [p.name for p in tmp_path.iterdir()] == ["maps"]


def test_another_of_the_same_name_does_not_replace_it(tmp_path: Path) -> None:
    first, second = keep_map(tmp_path, "map.tif", TIFF), keep_map(tmp_path, "map.tif", TIFF + b"x")
    assert (first, second) == ("maps/map.tif", "maps/map-2.tif") and keep_map(tmp_path, "map.tif", TIFF) == first


@pytest.mark.parametrize(("name", "content"), [("map.tif", b"<svg onload=x>"), ("map.sh", TIFF), ("..", TIFF), ("a.tif", b"")])
def test_anything_else_is_a_sentence(tmp_path: Path, name: str, content: bytes) -> None:
    with pytest.raises(BadProject, match="is no TIFF; hand over"):
        keep_map(tmp_path, name, content)
    assert not list(tmp_path.iterdir())


def test_a_name_means_a_file_inside_the_project_or_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "out").symlink_to(tmp_path)
    (folder / "here").symlink_to(folder)
    assert inside(folder, "mosaic.tif") == inside(folder, "here/x/../mosaic.tif") == folder.resolve() / "mosaic.tif"
    for said in ("../x.tif", "/etc/passwd", "a/../../x.tif", "out/x.tif", "..", "a\0b.tif", "\ud800.tif", "x" * 1999, "\0"):
        assert inside(folder, said) is None, said
