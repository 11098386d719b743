"""Tests on data made by others: the folder COLLINEA_DATA, or ../shared/data beside the repository; skipped only without it."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("COLLINEA_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.real)
            if not DATA.is_dir():
                item.add_marker(pytest.mark.skip(reason=f"there is no real data in {DATA}; set COLLINEA_DATA"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real data."""
    return DATA
