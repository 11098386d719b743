"""Mosaics of real photos beside other tools: time, CPU, peak memory, photos used, check ties and seams.

    python benchmarks/mosaic.py [FOLDER] [--peers PYTHON]      FOLDER: photos, default ../shared/data/uav_brighton8

--peers: a Python that has opencv and `stitching` (they replace each other's wheels, so not this one). gdalwarp and hugin run
where they are installed. One run; compare CPU, which other work on the machine disturbs least. Composition: its CPU inside the
whole command, overviews, seam check and all. Its bare parts: every photo decoded and remapped once (cv2, bilinear, maps not
counted), the finished mosaic written once by GDAL with the same bands and compression, no overviews. Single orthophotos: each
photo by gdalwarp from 35 ground control points that the registration gives it, bilinear, lossless, then all joined by gdalwarp;
and the same with single orthophotos of our own.
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
pto_var --opt='y,p,r,TrX,TrY,TrZ,!y0,!p0,!r0,!TrX0,!TrY0,!TrZ0' -o f.pto e.pto; autooptimiser -n -o g.pto f.pto
pano_modify --projection=0 --fov=AUTO --canvas=AUTO --crop=AUTO -o h.pto g.pto; nona -m TIFF_m -o n h.pto; enblend -o $out n*.tif
echo USED $(ls n*.tif | wc -l)"""
COMPOSE = """
import pickle, sys
from pathlib import Path
from solvers.workflows_compose import ComposeRequest, compose_photos
registration, photos = pickle.load(open(sys.argv[1], "rb"))
compose_photos(registration, photos, Path(sys.argv[2]), ComposeRequest(workers=2))
"""
LOSSLESS = ["-co", "COMPRESS=DEFLATE", "-co", "ZLEVEL=1", "-co", "PREDICTOR=2", "-co", "TILED=YES"]


def run(command: list[str]) -> dict[str, Any]:
    """Wall and CPU seconds, peak memory [MB] of the largest process, and what a command printed."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    peak, stop = [0], threading.Event()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def family(pid: int) -> list[int]:
        below = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [pid, *(p for child in below for p in family(int(child)))]

    def watch() -> None:
        while not stop.wait(0.05):
            try:
                for pid in family(process.pid):
                    status = Path(f"/proc/{pid}/status").read_text()
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
        show("  composition, its own process", part, len(made.registration.names))
        least = bare(made.registration, [made.site.photos[n] for n in made.registration.names], scratch / "part.tif", scratch)
        inside = said.get("cpu_seconds") or float("nan")
        print(f"{'  composition inside the command':34s} {'':8} {inside:8.1f}", flush=True)
        print(f"{'  bare decode, remap, write':34s} {'':8} {least:8.1f}   {inside / least:.2f} times", flush=True)
        peer = given.peers or sys.executable
        for name, code in (("cv2.Stitcher, SCANS", CV2), *((("stitching, affine, SIFT", STITCHING),) if given.peers else ())):
            done = run([peer, "-c", code, str(scratch / "peer.png"), *names])
            show(name, done, used_by(done))
        if shutil.which("gdalwarp"):
            for name, way in (("gdalwarp: orthophotos, join", _gdal_alone), ("our orthophotos, gdalwarp joins", _warped)):
                done = way(made, scratch)
                show(name, done, len(made.registration.names))
                print(f"{'':34s} {'':8} {done['cpu'] / inside:8.1f} times composition", flush=True)
        if shutil.which("autooptimiser"):
            done = run(["bash", "-c", HUGIN, "hugin", folder, str(scratch / "hugin.tif"), *names])
            show("hugin + enblend", done, used_by(done))


def _gdal_alone(made: Any, scratch: Path) -> dict[str, Any]:
    """One orthophoto a photo by gdalwarp from ground control points, then joined by gdalwarp: CPU of both."""
    import numpy as np

    r, singles, spent, peak = made.registration, [], 0.0, 0
    gsd = str(json.loads((scratch / "ours.json").read_text())["gsd"])
    for k, name in enumerate(r.names):
        i, single = r.interiors[k], scratch / f"gdal_{k}"
        at = np.stack(np.meshgrid(np.linspace(0, i.width - 1, 7), np.linspace(0, i.height - 1, 5)), -1).reshape(-1, 2)
        ground = r.on_plane(k, at) + r.frame.origin[:2]
        points = [w for (c, w_), (x, y) in zip(at, ground, strict=True)
                  for w in ("-gcp", str(c + 0.5), str(w_ + 0.5), f"{x:.4f}", f"{y:.4f}")]
        steps = (["gdal_translate", "-q", "-of", "VRT", "-a_srs", r.crs, *points, str(made.site.photos[name]), f"{single}.vrt"],
                 ["gdalwarp", "-q", "-order", "3", "-r", "bilinear", "-tr", gsd, gsd, "-tap", "-dstalpha", *LOSSLESS,
                  f"{single}.vrt", f"{single}.tif"])
        for step in steps:
            done = run(step)
            spent, peak = spent + done["cpu"], max(peak, done["peak"])
        singles.append(f"{single}.tif")
    done = run(["gdalwarp", "-q", "-r", "bilinear", *LOSSLESS, *singles, str(scratch / "joined.tif")])
    return {**done, "cpu": done["cpu"] + spent, "wall": float("nan"), "peak": max(peak, done["peak"])}


def _warped(made: Any, scratch: Path) -> dict[str, Any]:
    """One orthophoto a photo, joined by gdalwarp: CPU of both."""
    from dataclasses import replace

    from solvers.workflows_compose import compose_photos

    r, start, singles = made.registration, time.process_time(), []
    from solvers.workflows_compose import ComposeRequest

    for k, name in enumerate(r.names):
        one = replace(r, names=(name,), interiors=(r.interiors[k],), exteriors=r.exteriors[k:k + 1],
                      homographies=None if r.homographies is None else r.homographies[k:k + 1],
                      bends=None if r.bends is None else r.bends[k:k + 1])
        singles.append(scratch / f"{name}.tif")
        compose_photos(one, made.site.photos, singles[-1], ComposeRequest(blend="none"))
    spent = time.process_time() - start
    done = run(["gdalwarp", "-q", "-r", "bilinear", *LOSSLESS, *map(str, singles), str(scratch / "warped.tif")])
    return {**done, "cpu": done["cpu"] + spent, "wall": done["wall"] + spent}


if __name__ == "__main__":
    main()
