"""Mosaics of real photos beside other tools: time, CPU, peak memory, photos used, check ties and seams.

    python benchmarks/mosaic.py [FOLDER] [--peers PYTHON]      FOLDER: photos, default ../shared/data/uav_brighton8

--peers: a Python that has opencv and `stitching` (they replace each other's wheels, so not this one). gdalwarp and hugin run
where they are installed. One run; compare CPU, which other work on the machine disturbs least. The bare parts of a composition:
every photo decoded and remapped once, the finished mosaic written once by GDAL, no overviews.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

CV2 = """
import sys, cv2
images = [cv2.imread(f) for f in sys.argv[2:]]
stitcher = cv2.Stitcher_create(cv2.Stitcher_SCANS)
status, picture = stitcher.stitch(images)
print("USED", len(stitcher.component()) if status == 0 else f"none (status {status})")
if status == 0: cv2.imwrite(sys.argv[1], picture)
"""
STITCHING = """
import sys, cv2
from stitching import AffineStitcher
stitcher = AffineStitcher(detector="sift", confidence_threshold=0.3)
cv2.imwrite(sys.argv[1], stitcher.stitch(sys.argv[2:]))
print("USED", len(stitcher.images.names))
"""
HUGIN = """set -e; cd "$1"; out=$2; shift 2; pto_gen -o a.pto -p 0 "$@"; cpfind --multirow -o b.pto a.pto; cpclean -o c.pto b.pto
pto_var --opt='r,TrX,TrY,TrZ,!r0,!TrX0,!TrY0,!TrZ0' -o d.pto c.pto; autooptimiser -n -o e.pto d.pto
pano_modify --projection=0 --fov=AUTO --canvas=AUTO --crop=AUTO -o h.pto e.pto; nona -m TIFF_m -o n h.pto; enblend -o $out n*.tif
echo USED $(ls n*.tif | wc -l)"""
COMPOSE = """
import json, pickle, sys, time
from pathlib import Path
from solvers.workflows_compose import ComposeRequest, compose_photos
registration, photos = pickle.load(open(sys.argv[1], "rb"))
start = time.process_time()
done = compose_photos(registration, photos, Path(sys.argv[2]), ComposeRequest(workers=2))
print("JSON" + json.dumps({**done, "cpu": time.process_time() - start}))
"""


def run(command: list[str]) -> dict[str, Any]:
    """Wall and CPU seconds, peak memory [MB] of the largest process, and what a command printed."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    peak, stop = [0], threading.Event()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def watch() -> None:
        while not stop.wait(0.05):
            try:
                status = Path(f"/proc/{process.pid}/status").read_text()
                peak[0] = max(peak[0], int(status.split("VmHWM:")[1].split()[0]) // 1024)
            except (OSError, IndexError):
                continue

    thread = threading.Thread(target=watch)
    thread.start()
    said, _ = process.communicate()
    stop.set()
    thread.join()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"wall": time.perf_counter() - start, "cpu": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
            "peak": peak[0], "said": said, "code": process.returncode}


def bare(registration: Any, files: list[Path], mosaic: Path, scratch: Path) -> float:
    """CPU seconds of the parts: decode and remap of every photo once (maps not counted), and GDAL writing the mosaic."""
    import cv2
    import numpy as np
    import rasterio

    cv2.setNumThreads(1)
    spent, clock = 0.0, time.process_time
    with rasterio.open(mosaic) as data:
        pixels, profile, gsd = data.read(), {**data.profile, "zlevel": 1, "predictor": 2}, data.transform.a
    for k, file in enumerate(files):
        start = clock()
        image = cv2.imread(str(file))
        spent += clock() - start
        assert image is not None
        corners = registration.footprint(k)
        (x0, _), (x1, y1) = corners.min(0), corners.max(0)
        for top in range(0, int((y1 - corners[:, 1].min()) / gsd), 1024):
            for left in range(0, int((x1 - x0) / gsd), 1024):
                col, row = np.meshgrid(left + np.arange(1024.0), top + np.arange(1024.0))
                at = registration.to_pixels(k, np.stack([x0 + gsd * col, y1 - gsd * row], -1)).astype(np.float32)
                if not ((at > 0) & (at < image.shape[1::-1])).all(-1).any():
                    continue
                u, v = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
                start = clock()
                cv2.remap(image, u, v, cv2.INTER_LINEAR)
                spent += clock() - start
    start = clock()
    with rasterio.open(scratch / "bare.tif", "w", **profile) as data:
        data.write(pixels)
    return spent + clock() - start


def show(name: str, done: dict[str, Any], used: object = "", check: object = "", seam: object = "") -> None:
    state = "" if done["code"] == 0 else f"   ended with {done['code']}: {done['said'].strip().splitlines()[-1][:60]}"
    print(f"{name:34s} {done['wall']:8.1f} {done['cpu']:8.1f} {done['peak']:8.0f}  {used!s:>6} {check!s:>10} {seam!s:>8}{state}",
          flush=True)


def used_by(done: dict[str, Any]) -> str:
    return next((line[5:] for line in done["said"].splitlines() if line.startswith("USED ")), "0")


def main() -> None:
    import pickle

    from solvers.workflows_compose import ComposeRequest
    from solvers.workflows_mosaic import MosaicRequest, registered

    reading = argparse.ArgumentParser()
    reading.add_argument("folder", nargs="?", default=os.environ.get("COLLINEA_DATA", "../shared/data") + "/uav_brighton8")
    reading.add_argument("--peers", help="a Python that has opencv and stitching")
    given = reading.parse_args()
    files = sorted(p for p in Path(given.folder).iterdir() if p.suffix.lower() in (".jpg", ".tif", ".png"))
    names = [str(f.resolve()) for f in files]
    print(f"{'':34s} {'wall s':>8} {'CPU s':>8} {'peak MB':>8}  {'photos':>6} {'check px':>10} {'seam px':>8}")
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        whole = run([sys.executable, "-m", "solvers.cli", "mosaic", given.folder, "-o", str(scratch / "ours.tif"), "--quiet",
                     "--json", str(scratch / "ours.json"), "--allow-partial"])
        said = json.loads((scratch / "ours.json").read_text()) if whole["code"] == 0 else {}
        held = said.get("check_ties") or {}
        show("collinea mosaic", whole, sum(i["used"] for i in said.get("images", [])), f"{held.get('rms_px', float('nan')):.2f}",
             f"{said.get('seam_rms') or float('nan'):.2f}")
        made = registered(Path(given.folder), MosaicRequest(compose=ComposeRequest(workers=1)))
        kept = scratch / "registration"
        kept.write_bytes(pickle.dumps((made.registration, made.site.photos)))
        part = run([sys.executable, "-c", COMPOSE, str(kept), str(scratch / "part.tif")])
        show("  of it: composition alone", part, len(made.registration.names))
        least = bare(made.registration, [made.site.photos[n] for n in made.registration.names], scratch / "part.tif", scratch)
        inside = json.loads(part["said"].split("JSON")[1])
        print(f"{'  bare decode, remap, write':34s} {'':8} {least:8.1f}   composition in the same way {inside['cpu']:.1f}: "
              f"{inside['cpu'] / least:.2f} times", flush=True)
        peer = given.peers or sys.executable
        for name, code in (("cv2.Stitcher, SCANS", CV2), *((("stitching, affine, SIFT", STITCHING),) if given.peers else ())):
            done = run([peer, "-c", code, str(scratch / "peer.png"), *names])
            show(name, done, used_by(done))
        if shutil.which("gdalwarp"):
            show("gdalwarp of single orthophotos", _warped(made, scratch), len(files))
        if shutil.which("hugin_executor"):
            done = run(["bash", "-c", HUGIN, "hugin", folder, str(scratch / "hugin.tif"), *names])
            show("hugin + enblend", done, used_by(done))


def _warped(made: Any, scratch: Path) -> dict[str, Any]:
    """One orthophoto a photo, joined by gdalwarp: CPU of both."""
    from dataclasses import replace

    from solvers.workflows_compose import compose_photos

    r, start, singles = made.registration, time.process_time(), []
    from solvers.workflows_compose import ComposeRequest

    for k, name in enumerate(r.names):
        one = replace(r, names=(name,), interiors=(r.interiors[k],), exteriors=r.exteriors[k:k + 1],
                      homographies=None if r.homographies is None else r.homographies[k:k + 1])
        singles.append(scratch / f"{name}.tif")
        compose_photos(one, made.site.photos, singles[-1], ComposeRequest(blend="none"))
    spent = time.process_time() - start
    done = run(["gdalwarp", "-q", "-r", "cubic", *map(str, singles), str(scratch / "warped.tif")])
    return {**done, "cpu": done["cpu"] + spent, "wall": done["wall"] + spent}


if __name__ == "__main__":
    main()
