#!/usr/bin/env python3
"""The same job in Python with OpenCV, beside `cannula process`, in one run on one machine.

    compare.py SESSION --cannula PATH [--repeat N]

Two peers: what a competent user writes (OpenCV's corners, on-off difference, centroid of the
stripe, linear joint planes), and the same with corners fitted by a blurred-edge model. Each is
timed with its images already in memory and with reading, one thread; `cannula` on one thread and
on all. Times are the processor's (a busy machine slows all clocks on the wall), the least of N runs
in turn; `cannula`'s reading is told from its working by its own stage clocks. Printed as JSON:
seconds, ratios, and errors against truth.json.
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


def read_all(folder, session):
    names = [c["image"] for c in session["camera"]]
    for pose in session["light"]:
        names += [pose["off"]] + [f["image"] for f in pose["on"]]
    names += [session["scan"]["ambient"]] + [f["image"] for f in session["scan"]["frames"]]
    return {n: cv2.imread(os.path.join(folder, n), cv2.IMREAD_GRAYSCALE) for n in names}


def opencv_corners(image, size):
    found, corners = cv2.findChessboardCorners(image, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    square = np.linalg.norm(corners[1] - corners[0])
    half = int(np.clip(square / 3, 2, 5))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    return cv2.cornerSubPix(image, corners, (half, half), (-1, -1), stop)


def fitted_corners(image, size):
    """I = c + A·erf(d1/s)·erf(d2/s), d1 and d2 the distances from two lines, by Gauss-Newton, all
    corners of an image at once."""
    start = opencv_corners(image, size)
    if start is None:
        return None
    columns, rows = size
    grid = start.reshape(rows, columns, 2).astype(float)
    along, down = np.gradient(grid, axis=1).reshape(-1, 2), np.gradient(grid, axis=0).reshape(-1, 2)
    n = columns * rows
    half = int(np.clip(0.4 * min(np.linalg.norm(along, axis=1).min(), np.linalg.norm(down, axis=1).min()), 3, 9))
    g = np.arange(-half, half + 1)
    base = np.rint(start.reshape(-1, 2)).astype(int)
    v = np.clip(base[:, 1, None, None] + g[None, :, None], 0, image.shape[0] - 1)
    u = np.clip(base[:, 0, None, None] + g[None, None, :], 0, image.shape[1] - 1)
    z = image[v, u].astype(float).reshape(n, -1)
    du, dv = np.meshgrid(g, g)
    du, dv = du.ravel()[None], dv.ravel()[None]
    p = np.zeros((n, 7))  # x, y, direction of either line, mean, contrast, log of blur
    p[:, :2] = start.reshape(-1, 2) - base
    p[:, 2], p[:, 3] = np.arctan2(along[:, 1], along[:, 0]), np.arctan2(down[:, 1], down[:, 0])
    p[:, 4], p[:, 6] = z.mean(1), np.log(0.8)

    def erf(x):  # Abramowitz and Stegun 7.1.26
        t = 1 / (1 + 0.3275911 * np.abs(x))
        y = 1 - t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))) * np.exp(-x * x)
        return np.sign(x) * y

    def model(p):
        x, y = du - p[:, 0, None], dv - p[:, 1, None]
        s = np.exp(p[:, 6, None]) * np.sqrt(2)
        sides = []
        for k in (2, 3):
            sin, cos = np.sin(p[:, k, None]), np.cos(p[:, k, None])
            d = (-x * sin + y * cos) / s
            sides.append((erf(d), 2 / np.sqrt(np.pi) * np.exp(-d * d), d, sin / s, cos / s, (-x * cos - y * sin) / s))
        return sides

    for step in range(12):
        (e1, g1, d1, s1, c1, t1), (e2, g2, d2, s2, c2, t2) = model(p)
        q = e1 * e2
        if step == 0:
            p[:, 5] = ((z - p[:, 4, None]) * q).sum(1) / (q * q).sum(1)
        a = p[:, 5, None]
        j = np.stack([
            a * (g1 * s1 * e2 + e1 * g2 * s2), -a * (g1 * c1 * e2 + e1 * g2 * c2),
            a * g1 * t1 * e2, a * e1 * g2 * t2, np.ones_like(q), q,
            -a * (g1 * d1 * e2 + e1 * g2 * d2)], axis=2)
        r = z - p[:, 4, None] - a * q
        h = np.einsum("nki,nkj->nij", j, j) + 1e-6 * np.eye(7)
        move = np.linalg.solve(h, np.einsum("nki,nk->ni", j, r)[..., None])[..., 0]
        p += np.clip(move, -0.5 if step < 4 else -5, 0.5 if step < 4 else 5)
        if np.abs(move[:, :2]).max() < 1e-4:
            break
    found = (base + p[:, :2]).astype(np.float32)
    wild = np.linalg.norm(p[:, :2] - (start.reshape(-1, 2) - base), axis=1) > 1
    found[wild] = start.reshape(-1, 2)[wild]
    return found.reshape(-1, 1, 2)


def centroids(difference, threshold=12.0, half=8):
    """One centre a column: the centroid over ±half pixels around the peak."""
    blurred = cv2.GaussianBlur(difference, (1, 5), 0, sigmaY=1.0)
    peak = blurred.argmax(0)
    columns = np.arange(difference.shape[1])
    good = (blurred[peak, columns] > threshold) & (peak >= half) & (peak < difference.shape[0] - half)
    columns, peak = columns[good], peak[good]
    window = np.clip(difference[peak[:, None] + np.arange(-half, half + 1)[None], columns[:, None]], 0, None)
    centre = peak + (window * np.arange(-half, half + 1)).sum(1) / np.maximum(window.sum(1), 1e-9)
    return np.stack([columns, centre], 1).astype(np.float64)


def rays(points, k, d):
    xy = cv2.undistortPoints(points.reshape(-1, 1, 2), k, d, None, None).reshape(-1, 2)
    return np.c_[xy, np.ones(len(xy))]


def work(session, images, corners_of):
    size = (session["board"]["columns"], session["board"]["rows"])
    square = session["board"]["square_mm"]
    board = np.zeros((size[0] * size[1], 3), np.float32)
    board[:, :2] = np.mgrid[: size[0], : size[1]].T.reshape(-1, 2) * square
    shape = (session["image"]["width"], session["image"]["height"])
    views = [corners_of(images[c["image"]], size) for c in session["camera"]]
    poses = [corners_of(images[p["off"]], size) for p in session["light"]]
    all_views = [v for v in views + poses if v is not None]
    _, k, d, _, _ = cv2.calibrateCamera([board] * len(all_views), all_views, shape, None, None)
    rows = []
    for pose, corners in zip(session["light"], poses):
        if corners is None:
            continue
        _, r, t = cv2.solvePnP(board, corners, k, d)
        normal = cv2.Rodrigues(r)[0][:, 2]
        distance = normal @ t.ravel()
        mask = cv2.fillConvexPoly(np.zeros(shape[::-1], np.uint8), cv2.convexHull(corners.astype(np.int32)), 1)
        off = images[pose["off"]].astype(np.float32)
        for frame in pose["on"]:
            difference = (images[frame["image"]].astype(np.float32) - off) * mask
            points = centroids(difference)
            if len(points) < 20:
                continue
            ray = rays(points, k, d)
            p = ray * (distance / (ray @ normal))[:, None]
            rows.append(np.c_[p, np.full(len(p), frame["slide_mm"]), np.ones(len(p))])
    m = np.vstack(rows)
    for _ in range(3):  # linear joint planes, outliers dropped
        mean = m.mean(0)
        mean[4] = 0
        scale = np.array([100, 100, 400, 50, 1.0])
        _, _, vt = np.linalg.svd((m - np.r_[0, 0, 0, 0, 0]) / scale, full_matrices=False)
        light = vt[-1] / scale
        light /= np.linalg.norm(light[:3])
        light *= np.sign(light[2])
        off_plane = np.abs(m @ light)
        m = m[off_plane < max(3 * 1.4826 * np.median(off_plane), 1e-6)]
    n, a, b = light[:3], light[3], light[4]
    ambient = images[session["scan"]["ambient"]].astype(np.float32)
    cloud, pixels = [], []
    for frame in session["scan"]["frames"]:
        points = centroids(images[frame["image"]].astype(np.float32) - ambient, 25.0)
        if len(points) == 0:
            continue
        ray = rays(points, k, d)
        cloud.append(ray * (-(a * frame["slide_mm"] + b) / (ray @ n))[:, None])
        pixels.append(points)
    cloud, pixels = np.vstack(cloud), np.vstack(pixels)

    def on_surface(pixel):
        near = np.argsort(np.linalg.norm(pixels - pixel, axis=1))[:40]
        c = cloud[near].mean(0)
        _, _, vt = np.linalg.svd(cloud[near] - c, full_matrices=False)
        ray = rays(np.array([pixel], float), k, d)[0]
        return ray * (vt[2] @ c) / (vt[2] @ ray)

    entry = on_surface(session["entry"]["pixel"])
    region = cloud[np.linalg.norm(cloud - entry, axis=1) <= session["entry"]["radius_mm"]]
    c = region.mean(0)
    normal = np.linalg.svd(region - c, full_matrices=False)[2][2]
    normal *= np.sign(normal[2])
    vein = np.array([on_surface(v) for v in session["entry"]["vein"]])
    line = np.linalg.svd(vein - vein.mean(0), full_matrices=False)[2][0]
    line *= np.sign(line @ (vein[-1] - vein[0]))
    line -= normal * (normal @ line)
    line /= np.linalg.norm(line)
    return {"fx": k[0, 0], "normal": normal, "entry": entry, "vein": line}


def angle(a, b):
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b))))


def errors(truth, fx, normal, entry, vein):
    axis = lambda n, v: np.cos(np.pi / 6) * np.asarray(v) + 0.5 * np.asarray(n)
    return {
        "focal_percent": 100 * abs(fx / truth["camera"]["fx"] - 1),
        "normal_deg": angle(normal, truth["plane"]["normal"]),
        "entry_mm": float(np.linalg.norm(np.subtract(entry, truth["entry"]["point_mm"]))),
        "axis_deg": angle(axis(normal, vein), axis(truth["plane"]["normal"], truth["vein"]["direction"])),
    }


def cannula(binary, folder, threads):
    with tempfile.TemporaryDirectory() as out:
        command = [binary, "process", folder, "--out", out, "--json", "--quiet"]
        if threads:
            command += ["--threads", str(threads)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        result = json.loads(done.stdout)
        calibration = json.load(open(os.path.join(out, "calibration.json")))
    return result, calibration, spent


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("session")
    parser.add_argument("--cannula", required=True)
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    session = json.load(open(os.path.join(args.session, "session.json")))
    path = os.path.join(args.session, "truth.json")
    truth = json.load(open(path)) if os.path.exists(path) else None
    best, last = {}, {}
    peers = {"competent": opencv_corners, "model_fitted": fitted_corners}

    def least(name, seconds):
        best[name] = min(seconds, best.get(name, float("inf")))

    # Peers and ours in turn, so that a busy machine is busy for both.
    for _ in range(args.repeat):
        wall, start = time.perf_counter(), time.process_time()
        images = read_all(args.session, session)
        least("opencv_reading", time.process_time() - start)
        wall_reading = time.perf_counter() - wall
        for name, corners in peers.items():
            wall, start = time.perf_counter(), time.process_time()
            last[name] = work(session, images, corners)
            least(name, time.process_time() - start)
            if name == "competent":
                least("competent_wall_with_reading", time.perf_counter() - wall + wall_reading)
        del images
        result, calibration, spent = cannula(args.cannula, args.session, 1)
        seconds = result["seconds"]
        least("cannula_working", spent * (1 - seconds["read"] / seconds["wall"]))
        least("cannula_with_reading", spent)
        for stage in seconds:
            least(f"cannula_stage_{stage}", spent * seconds[stage] / seconds["wall"])
        wall = time.perf_counter()
        cannula(args.cannula, args.session, 0)
        least("cannula_all_cores_wall", time.perf_counter() - wall)
    report = {"seconds": best, "ratios": {
        "working_to_model_fitted": best["cannula_working"] / best["model_fitted"],
        "working_to_competent": best["cannula_working"] / best["competent"],
        "with_reading_to_competent": best["cannula_with_reading"] / (best["competent"] + best["opencv_reading"]),
        "all_cores_wall_to_competent_wall": best["cannula_all_cores_wall"] / best["competent_wall_with_reading"],
    }}
    if truth:
        report["errors"] = {name: errors(truth, **last[name]) for name in peers}
        report["errors"]["cannula"] = errors(
            truth, calibration["camera"]["fx"], result["plane"]["normal"], result["entry"]["point_mm"], result["vein"]["direction"])
    json.dump(report, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
