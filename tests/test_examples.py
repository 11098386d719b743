"""Every numbered example runs and says what it promises."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


SAYS = [
    ("01_resection.py", ["sigma0", "kappa_deg", "true error", "cluster1", "stopped by"]),
    ("02_orthogonal.py", ["cluster5 perspective", "cluster5 orthogonal", "one pass", "all 33"]),
    ("03_bundle.py", ["in the block", "check point", "free network", "step"]),
    ("04_matching.py", ["by correlation", "correlation", "points matched at once", "standard errors"]),
]


@pytest.mark.parametrize("name, says", SAYS)
def test_an_example_runs_and_opens_with_what_you_will_see(name: str, says: list[str], capsys: pytest.CaptureFixture[str]):
    assert "You will see" in (EXAMPLES / name).read_text(encoding="utf-8").split('"""')[1]
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    printed = capsys.readouterr().out
    assert all(word in printed for word in says) and "nan" not in printed


def test_every_example_is_tried_here():
    assert {p.name for p in EXAMPLES.glob("*.py")} == {name for name, _ in SAYS}
