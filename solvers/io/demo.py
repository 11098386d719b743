"""The demo project that comes with Collinea, and a copy of it that a person may change."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from ..errors import BadProject


def demo_assets() -> Path:
    """The folder of the demo project: assets/demo of a checkout, share/collinea/demo of an installed wheel. Raises BadProject."""
    checkout = Path(__file__).resolve().parents[2] / "assets" / "demo"
    if (checkout / "project.toml").is_file():
        return checkout
    try:
        files = distribution("collinea").files or []
    except PackageNotFoundError:
        files = []
    for file in files:
        if file.parts[-4:] == ("share", "collinea", "demo", "project.toml"):
            return Path(str(file.locate())).resolve().parent
    raise BadProject(f"{checkout}: the demo project is not there; make one with: collinea simulate uav_cluster -o FOLDER, then: "
                     "collinea view FOLDER")


def demo_copy() -> Path:
    """A writable copy of the demo project, made once per version of it in the user's data folder (or the temporary one)."""
    assets = demo_assets()
    name = f"demo-{_digest(assets)}"
    for base in (_user_data(), Path(tempfile.gettempdir()) / f"collinea-{getattr(os, 'getuid', lambda: 0)()}"):
        try:
            base.mkdir(parents=True, exist_ok=True, mode=0o700)
            return _copied(assets, base / name)
        except OSError as error:
            failed = error
    raise BadProject(f"the demo project cannot be copied to {base} ({failed.strerror}); free some space there or set TMPDIR")


def _copied(assets: Path, target: Path) -> Path:
    """`target`, made in one step if it is not there."""
    if (target / "project.toml").is_file():
        return target
    part = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        shutil.copytree(assets, part, dirs_exist_ok=True, ignore=shutil.ignore_patterns("runs", "README*"),
                        copy_function=shutil.copyfile)
        if not target.exists():
            os.replace(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return target


def _digest(assets: Path) -> str:
    """Eight signs that change when the demo project does."""
    total = hashlib.sha256()
    for file in sorted(p for p in assets.rglob("*") if p.is_file() and "runs" not in p.relative_to(assets).parts):
        total.update(f"{file.relative_to(assets)} {file.stat().st_size}\n".encode())
        if file.suffix in (".toml", ".csv", ".json"):
            total.update(file.read_bytes())
    return total.hexdigest()[:8]


def _user_data() -> Path:
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "Collinea"
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "collinea"
