"""Memory of a mosaic of any size: a simulated block of 500 photos, over 1 Gpixel, through the whole command.

    python benchmarks/mosaic_size.py [--strips 20] [--images 25] [--blend feather multiband ...] [--options "--seams --gain"]

The photos are one picture of 12 Mpixel under many names, decoded each for itself; their tie points are those of level ground.
Needs about 15 GB of disk where temporary files go. Prints one line for each blend: canvas, seconds, CPU seconds, peak memory.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HEIGHT, SIGMA = 400.0, 0.3


def block_of(strips: int, images: int, photo: Path, folder: Path) -> None:
    """A project of strips x images photos, overlaps 70 and 50 %, with tie points every 50 m, noise 0.3 px, GPS to 0.1 m."""
    from solvers import Exterior, Interior
    from solvers.block import Block, Image, Observations, Points, Prior
    from solvers.cameras import project
    from solvers.io import write_project

    camera, rng = Interior(4000.0, pixel_mm=1.0, width=4000, height=3000), np.random.default_rng(1)
    (folder / "images").mkdir(parents=True)
    pictures, rows = [], []
    x, y = np.meshgrid(np.arange(-150.0, 200 * strips + 200, 50), np.arange(-150.0, 90 * images + 150, 50))
    ground = np.stack([x.ravel() + 7, y.ravel() + 3, np.zeros(x.size)], -1)
    for s in range(strips):
        for k in range(images):
            centre = np.array([200.0 * s, 90.0 * (k if s % 2 == 0 else images - 1 - k), HEIGHT]) + rng.normal(0, 1, 3)
            omega, phi, kappa = (float(v) for v in rng.normal(0, 0.02, 3))
            taken, name = Exterior.from_angles(omega, phi, kappa + np.pi * (s % 2), centre), f"S{s:02d}_{k:02d}"
            os.link(photo, folder / "images" / f"{name}.jpg")
            gps = Prior(centre + rng.normal(0, 0.1, 3), None, np.full(3, 0.1))
            pictures.append(Image(name, "cam", f"images/{name}.jpg", gps))
            near = np.flatnonzero(np.abs(ground[:, :2] - centre[:2]).max(axis=1) < 300)
            seen = project(camera, taken, ground[near])
            inside = camera.inside(seen, -5.0)
            rows.append((near[inside], seen[inside] + SIGMA * rng.standard_normal(seen[inside].shape)))
    point, pixel = np.concatenate([p for p, _ in rows]), np.concatenate([q for _, q in rows])
    image = np.repeat(np.arange(len(rows)), [len(p) for p, _ in rows])
    used, point = np.unique(point, return_inverse=True)
    nothing = np.full((len(used), 3), np.nan)
    block = Block("block", "local", {"cam": camera}, tuple(pictures),
                  Points(tuple(f"T{k}" for k in used), nothing, nothing.copy(), ("tie",) * len(used)),
                  Observations(image, point, pixel.round(3), np.full(len(image), SIGMA)), image_px=SIGMA)
    write_project(block, folder)


def painted(path: Path) -> None:
    """One picture of 12 Mpixel with something to see at every scale."""
    import cv2

    rng, picture = np.random.default_rng(2), np.full((3000, 4000, 3), 128, np.float32)
    for size in (8, 32, 128, 512):
        picture += cv2.resize(rng.normal(0, 18, (3 * size // 4, size, 3)).astype(np.float32), (4000, 3000),
                              interpolation=cv2.INTER_CUBIC)
    picture += rng.normal(0, 6, picture.shape)
    cv2.imwrite(str(path), np.clip(picture, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])


def main() -> None:
    reading = argparse.ArgumentParser()
    reading.add_argument("--strips", type=int, default=20)
    reading.add_argument("--images", type=int, default=25)
    reading.add_argument("--blend", nargs="+", default=["none", "average", "feather", "multiband"])
    reading.add_argument("--options", default="", help="more options of collinea mosaic, as one word")
    given = reading.parse_args()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        painted(scratch / "photo.jpg")
        block_of(given.strips, given.images, scratch / "photo.jpg", scratch / "block")
        print(f"{'blend':12s} {'photos':>6} {'canvas px':>16} {'Gpixel':>7} {'wall s':>7} {'CPU s':>7} {'peak MB':>8}",
              flush=True)
        for blend in given.blend:
            out, before, start = scratch / "m.tif", resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            done = subprocess.run([sys.executable, "-m", "solvers.cli", "mosaic", str(scratch / "block"), "-o", str(out),
                                   "--blend", blend, *given.options.split(), "--quiet", "--json", str(scratch / "m.json")],
                                  check=False)
            wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
            if done.returncode:
                raise SystemExit(f"{blend}: ended with {done.returncode}")
            said = json.loads((scratch / "m.json").read_text())
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            used = sum(i["used"] for i in said["images"])
            parts = {k: round(v) for k, v in said["seconds"].items()}
            print(f"{blend:12s} {used:6d} {said['width']:8d} x{said['height']:6d} {said['width'] * said['height'] / 1e9:7.2f} "
                  f"{wall:7.1f} {cpu:7.1f} {said['peak_memory_mb']:8.0f}   {parts}", flush=True)
            out.unlink()


if __name__ == "__main__":
    main()
