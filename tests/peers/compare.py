#!/usr/bin/env python3
"""The same job in Python with OpenCV, beside `cannula process`, in one run on one machine.

    compare.py SESSION [SESSION ...] --cannula PATH [--corners PATH] [--repeat N] [--json]

Peers: the paper's way, step for step (paper.py); what a competent user writes, and the same with
corners fitted by a blurred-edge model (opencv.py); ours both ways. Printed as tables or as JSON:

- errors of each stage against truth.json (accuracy.py), mean over the sessions;
- corners against truth, and the time to find a board and to find none (`--corners` names the
  example `corners` of the host; by default it is sought beside the command);
- with `--repeat` above 0, seconds on the first session. Each peer is timed with its images already
  in memory and with reading, one thread; `cannula` on one thread and on all. Times are the
  processor's (a busy machine slows all clocks on the wall), the least of N runs in turn;
  `cannula`'s reading is told from its working by its own stage clocks.
"""
import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
try:
    import cv2
    import numpy as np
except ImportError:
    print("skipped")
    sys.exit(0)

import accuracy
import opencv
import paper

COMPETENT, FITTED, PAPER = "competent", "model_fitted", "paper_opencv"
PEERS = {
    PAPER: lambda session, images: paper.work(session, images, opencv.opencv_corners),
    COMPETENT: lambda session, images: opencv.work(session, images, opencv.opencv_corners),
    FITTED: lambda session, images: opencv.work(session, images, opencv.fitted_corners),
}
OURS = {"cannula": "ml", "cannula_paper": "paper"}
COLUMNS = ["cannula", FITTED, COMPETENT, "cannula_paper", PAPER]
TITLES = {"cannula": "cannula", FITTED: "fitted", COMPETENT: "competent", "cannula_paper": "ours, paper", PAPER: "cv, paper"}


def cannula(binary, folder, method="ml", threads=0):
    """Runs the command: its files as a peer's dictionary, its stage clocks, seconds of processor."""
    with tempfile.TemporaryDirectory() as out:
        command = [binary, "process", folder, "--out", out, "--json", "--quiet", "--method", method]
        if threads:
            command += ["--threads", str(threads)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command, capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            return None, done.stderr.strip(), 0
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        result = json.loads(done.stdout)
        calibration = json.load(open(os.path.join(out, "calibration.json")))
        return accuracy.from_cannula(result, calibration, out), result["seconds"], spent


def read(folder):
    return json.load(open(os.path.join(folder, "session.json")))


def errors(folder, binary):
    """Every way's stage errors on one recording; a way that refuses it is left out and says why."""
    session = read(folder)
    images = opencv.read_all(folder, session)
    found = {}
    for name, peer in PEERS.items():
        try:
            found[name] = accuracy.stages(folder, peer(session, images))
        except (cv2.error, ValueError, np.linalg.LinAlgError) as e:
            print(f"{folder}: {name}: {e}", file=sys.stderr)
    for name, method in OURS.items():
        done, why, _ = cannula(binary, folder, method)
        if done is None:
            print(f"{folder}: {name}: {why}", file=sys.stderr)
        else:
            found[name] = accuracy.stages(folder, done)
    return found


def pooled(of_sessions):
    """Mean over the recordings on which no way refused, and how many those are."""
    whole = [found for found in of_sessions if len(found) == len(COLUMNS)]
    if not whole:
        return {}, 0
    names = whole[0][COLUMNS[0]]
    return {w: {n: float(np.mean([f[w][n] for f in whole])) for n in names} for w in COLUMNS}, len(whole)


def corner_report(folder, program):
    """Corners against truth on the camera's images, and a search in vain on the scan's first frame."""
    session = read(folder)
    size = (session["board"]["columns"], session["board"]["rows"])
    truth = json.load(open(os.path.join(folder, "truth.json")))
    grey = lambda name: cv2.imread(os.path.join(folder, name), cv2.IMREAD_GRAYSCALE)
    names = [v["image"] for v in session["camera"]]
    images = {n: grey(n) for n in names}
    empty = session["scan"]["frames"][0]["image"]

    def timed(find, image):
        start = time.process_time()
        found = find(image)
        return found, time.process_time() - start

    report = {"rms_px": {}, "board_ms": {}, "no_board_ms": {}}
    for name, find in (("cornerSubPix", opencv.opencv_corners), ("fitted", opencv.fitted_corners)):
        looked = {n: timed(lambda image: find(image, size), images[n]) for n in names}
        report["rms_px"][name] = accuracy.corners(truth, lambda n: looked[n][0])
        report["board_ms"][name] = 1000 * float(np.median([s for _, s in looked.values()]))
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    none = [timed(lambda image: cv2.findChessboardCorners(image, size, flags=flags)[0], grey(empty)) for _ in range(2)]
    report["no_board_ms"]["findChessboardCorners"] = 1000 * min(s for _, s in none)
    if os.path.exists(program):
        said = subprocess.run([program, folder, *names, empty], capture_output=True, text=True, check=True)
        ours = {v["image"]: v for v in json.loads(said.stdout)}
        report["rms_px"]["ours"] = accuracy.corners(truth, lambda n: ours[n].get("model"))
        report["rms_px"]["ours, gradient"] = accuracy.corners(truth, lambda n: ours[n].get("gradient"))
        report["board_ms"]["ours"] = 1000 * float(np.median([ours[n]["seconds"] for n in names]))
        report["no_board_ms"]["ours"] = 1000 * ours[empty]["seconds"]
        report["no_board_reason"] = ours[empty].get("reason")
    return report


def times(folder, binary, repeat):
    session = read(folder)
    best = {}

    def least(name, seconds):
        best[name] = min(seconds, best.get(name, float("inf")))

    # Peers and ours in turn, so that a busy machine is busy for both.
    for _ in range(repeat):
        wall, start = time.perf_counter(), time.process_time()
        images = opencv.read_all(folder, session)
        least("opencv_reading", time.process_time() - start)
        wall_reading = time.perf_counter() - wall
        for name, peer in PEERS.items():
            wall, start = time.perf_counter(), time.process_time()
            peer(session, images)
            least(name, time.process_time() - start)
            if name == COMPETENT:
                least("competent_wall_with_reading", time.perf_counter() - wall + wall_reading)
        del images
        for name, method in OURS.items():
            _, seconds, spent = cannula(binary, folder, method, threads=1)
            least(f"{name}_working", spent * (1 - seconds["read"] / seconds["wall"]))
            least(f"{name}_with_reading", spent)
            if name == "cannula":
                for stage in seconds:
                    least(f"cannula_stage_{stage}", spent * seconds[stage] / seconds["wall"])
        wall = time.perf_counter()
        cannula(binary, folder)
        least("cannula_all_cores_wall", time.perf_counter() - wall)
    return best, {
        "working_to_model_fitted": best["cannula_working"] / best[FITTED],
        "working_to_competent": best["cannula_working"] / best[COMPETENT],
        "with_reading_to_competent": best["cannula_with_reading"] / (best[COMPETENT] + best["opencv_reading"]),
        "all_cores_wall_to_competent_wall": best["cannula_all_cores_wall"] / best["competent_wall_with_reading"],
        "paper_working_to_paper_opencv": best["cannula_paper_working"] / best[PAPER],
    }


def table(report):
    if report["errors"]:
        print(f"errors against truth, mean of {report['recordings']} recordings")
        print(" " * 20 + "".join(f"{TITLES[w]:>13}" for w in COLUMNS))
        for name in report["errors"][COLUMNS[0]]:
            print(f"{name:20}" + "".join(f"{report['errors'][w][name]:13.4f}" for w in COLUMNS))
    for what, values in report.get("corners", {}).items():
        if isinstance(values, dict):
            print(f"{what:20}" + "  ".join(f"{name} {value:.4f}" for name, value in values.items()))
        else:
            print(f"{what:20}{values}")
    for part in ("seconds", "ratios"):
        for name, value in report.get(part, {}).items():
            print(f"{part:8} {name:34}{value:8.3f}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("session", nargs="+")
    parser.add_argument("--cannula", required=True)
    parser.add_argument("--corners")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    report = {}
    first = args.session[0]
    known = [s for s in args.session if os.path.exists(os.path.join(s, "truth.json"))]
    if args.repeat:
        report["seconds"], report["ratios"] = times(first, args.cannula, args.repeat)
    report["errors"], report["recordings"] = pooled([errors(s, args.cannula) for s in known])
    if first in known:
        beside = os.path.join(os.path.dirname(os.path.abspath(args.cannula)), "examples", "corners")
        report["corners"] = corner_report(first, args.corners or beside)
    if args.json:
        json.dump(report, sys.stdout, indent=1)
        print()
    else:
        table(report)


if __name__ == "__main__":
    main()
