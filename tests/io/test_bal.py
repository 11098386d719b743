"""Problems of bundle adjustment in the large: read as their formula says, adjusted from their own start."""

import bz2
from pathlib import Path

import numpy as np
import pytest

from solvers import BadTable
from solvers.cli import main
from solvers.geometry import exp
from solvers.io import read_bal
from solvers.orientation.bundle import BundleRequest, prepare_bundle


def formula(camera: np.ndarray, point: np.ndarray) -> np.ndarray:
    p = exp(camera[:3]) @ point + camera[3:6]
    q = -p[:2] / p[2]
    r2 = q @ q
    return camera[6] * (1 + camera[7] * r2 + camera[8] * r2**2) * q


def write(path: Path, noise: float = 0.3, off: float = 0.01) -> float:
    """A small problem; gives back half the sum of squares at its start."""
    rng = np.random.default_rng(8)
    lens = (-0.05, 0.01)
    cameras = np.array([[*rng.normal(0, 0.1, 3), -1.5 + 0.6 * i, 0.2 * (i % 2), -6.0, 500 + 5 * i, *lens] for i in range(6)])
    points = rng.uniform([-2, -2, -1], [2, 2, 1], (40, 3))
    seen = [(i, j) for j in range(40) for i in range(6) if (i + j) % 5]
    xy = np.array([formula(cameras[i], points[j]) for i, j in seen]) + noise * rng.normal(size=(len(seen), 2))
    start, crude = cameras + off * rng.normal(size=cameras.shape) * [1, 1, 1, 1, 1, 1, 100, 0.1, 0.1], points + off
    lines = [f"6 40 {len(seen)}", *(f"{i} {j} {x!r} {y!r}" for (i, j), (x, y) in zip(seen, xy.tolist(), strict=True))]
    lines += [repr(v) for v in [*start.ravel().tolist(), *crude.ravel().tolist()]]
    path.write_text("\n".join(lines) + "\n")
    return 0.5 * float(sum(((formula(start[i], crude[j]) - p) ** 2).sum() for (i, j), p in zip(seen, xy, strict=True)))


def test_the_start_costs_what_the_formula_says(tmp_path: Path) -> None:
    cost = write(tmp_path / "p.txt")
    (tmp_path / "p.txt.bz2").write_bytes(bz2.compress((tmp_path / "p.txt").read_bytes()))
    for name in ("p.txt", "p.txt.bz2"):
        request = BundleRequest(datum="free", free=("c", "k1", "k2"), start="given")
        start = prepare_bundle(read_bal(tmp_path / name), request)
        assert start.problem.cost(start.x0) == pytest.approx(cost, rel=1e-12)


def test_it_is_adjusted_to_its_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "p.txt")
    assert main(["adjust", "--bal", str(tmp_path / "p.txt"), "--json", str(tmp_path / "r.json")]) == 0
    out = capsys.readouterr().out
    assert ("6 images, 40 points" in out and "stop: cost" in out) or "stop: step" in out
    assert read_json(tmp_path / "r.json")["sigma0"] == pytest.approx(0.3, rel=0.12)


def read_json(path: Path) -> dict:
    import json

    return json.loads(path.read_text())


@pytest.mark.parametrize(("text", "said"), [
    ("1 2 x", "not a number"), ("2.5 1 1", "does not begin"), ("1 1 1 0 0 1.0 2.0", "take 19 numbers, there are 7"),
    ("1 1 1 0 5 1.0 2.0 0 0 0 0 0 0 500 0 0 1 1 1", "that there is not"),
    ("1 1 1 0 0 1.0 2.0 0 0 0 0 0 0 -5 0 0 1 1 1", "focal length not positive")])
def test_refusals(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "p.txt").write_text(text)
    with pytest.raises(BadTable, match=said):
        read_bal(tmp_path / "p.txt")
    with pytest.raises(BadTable, match="no such file"):
        read_bal(tmp_path / "q.txt")
