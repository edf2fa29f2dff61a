"""What a competent user writes in Python with OpenCV: its corners, on-off difference, centroid of the
stripe, linear joint planes; and the same with corners fitted by a blurred-edge model."""
import os

import cv2
import numpy as np


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


def board_points(session):
    columns, rows = session["board"]["columns"], session["board"]["rows"]
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2) * session["board"]["square_mm"]
    return board


def rays(pixels, k, d):
    xy = cv2.undistortPoints(np.asarray(pixels, float).reshape(-1, 1, 2), k, d).reshape(-1, 2)
    return np.c_[xy, np.ones(len(xy))]


def camera(session, images, corners_of):
    """The board's points, its corners in each light pose, camera matrix and distortion."""
    size = (session["board"]["columns"], session["board"]["rows"])
    board = board_points(session)
    shape = (session["image"]["width"], session["image"]["height"])
    views = [corners_of(images[c["image"]], size) for c in session["camera"]]
    poses = [corners_of(images[p["off"]], size) for p in session["light"]]
    seen = [v for v in views + poses if v is not None]
    _, k, d, _, _ = cv2.calibrateCamera([board] * len(seen), seen, shape, None, None)
    return board, poses, k, d


def work(session, images, corners_of):
    board, poses, k, d = camera(session, images, corners_of)
    shape = (session["image"]["width"], session["image"]["height"])
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
    cloud, pixels, numbers = [], [], []
    for number, frame in enumerate(session["scan"]["frames"]):
        points = centroids(images[frame["image"]].astype(np.float32) - ambient, 25.0)
        if len(points) == 0:
            continue
        ray = rays(points, k, d)
        cloud.append(ray * (-(a * frame["slide_mm"] + b) / (ray @ n))[:, None])
        pixels.append(points)
        numbers.append(np.full(len(points), number))
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
    return {"k": k, "d": d, "light": (n, a, b), "pixels": pixels, "frames": np.concatenate(numbers),
            "normal": normal, "entry": entry, "vein": line}
