"""Each stage's error against truth.json, the same for every way of doing the job."""
import json
import os

import numpy as np

# Centres farther from the true stripe than this are not it (a wet spot, the table), px.
FAR_PX = 3.0


def angle(a, b):
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b))))


def from_cannula(result, calibration, folder):
    """The files of `cannula process` as a peer's dictionary; stripe centres are cloud.ply's points
    seen again by its own camera."""
    c, light = calibration["camera"], calibration["light"]
    k = np.array([[c["fx"], 0, c["u0"]], [0, c["fy"], c["v0"]], [0, 0, 1]])
    d = np.array([c["distortion"][n] for n in ("k1", "k2", "p1", "p2", "k3")])
    data = open(os.path.join(folder, "cloud.ply"), "rb").read()
    head, data = data.split(b"end_header\n", 1)
    assert b"binary_little_endian" in head
    kinds = {b"float": "<f4", b"int": "<i4"}
    fields = [line.split() for line in head.splitlines() if line.startswith(b"property")]
    cloud = np.frombuffer(data, [(name.decode(), kinds[kind]) for _, kind, name in fields])
    points = np.stack([cloud[a] for a in "xyz"], 1).astype(float)
    return {"k": k, "d": d, "light": (np.array(light["normal"]), light["a"], light["b"]),
            "pixels": seen(points, k, d), "frames": cloud["frame"], "normal": result["plane"]["normal"],
            "entry": result["entry"]["point_mm"], "vein": result["vein"]["direction"]}


def seen(points, k, d):
    """Eq. 1 and 2."""
    x, y = (points[:, :2] / points[:, 2:]).T
    k1, k2, p1, p2, k3 = np.ravel(d)[:5]
    r = x * x + y * y
    radial = 1 + r * (k1 + r * (k2 + r * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return np.stack([k[0, 0] * u + k[0, 2], k[1, 1] * v + k[1, 2]], 1)


def light_planes(truth, light):
    """Distance of true points of the light planes from those found, over the measuring volume (z 400
    to 460 mm): the mean, and the mean once the rotation of the camera's frame is taken out, mm."""
    normal, a, b = light
    t = truth["light"]
    n = np.array(t["normal"])
    points, distances = [], []
    for position in t["positions"]:
        for z in (400, 415, 430, 445, 460):
            for x in (-40, -20, 0, 20, 40):
                y = -(n[0] * x + n[2] * z + position["D"]) / n[1]
                if abs(y) < 45:
                    points.append((x, y, z))
                    distances.append(normal @ points[-1] + a * position["slide_mm"] + b)
    distances = np.array(distances)
    turning = np.cross(points, normal)
    turn = np.linalg.lstsq(turning, distances, rcond=None)[0]
    return float(np.abs(distances).mean()), float(np.abs(distances - turning @ turn).mean())


def stripe(truth, pixels, frames):
    """Root mean square distance along v from the true stripe, px, and the part that is not it."""
    off = []
    for i, frame in enumerate(truth["scan"]):
        v = np.array([np.nan if y is None else y for y in frame["v"]])
        of = pixels[frames == i]
        columns = np.arange(len(v))
        off.append(of[:, 1] - np.interp(of[:, 0], columns, v))
    off = np.concatenate(off)
    near = np.abs(off) < FAR_PX  # NaN, off the hand, is not near
    return float(np.sqrt(np.mean(off[near] ** 2))), float(100 * (1 - near.mean()))


def corners(truth, of_image):
    """2-D root mean square over the boards, px; `of_image` from an image's name to its corners or
    None. Either end of the board may come first."""
    squares = []
    boards = [(v["image"], v["corners"]) for v in truth["camera_images"]]
    for name, true in boards:
        found = of_image(name)
        if found is None:
            continue
        found, true = np.reshape(found, (-1, 2)), np.array(true)
        squares.append(min(((found - true) ** 2).sum(1), ((found[::-1] - true) ** 2).sum(1), key=np.sum))
    return float(np.sqrt(np.mean(squares))) if squares else None


def stages(folder, done):
    """All errors of one way on one recording."""
    truth = json.load(open(os.path.join(folder, "truth.json")))
    camera = truth["camera"]
    plane, turned = light_planes(truth, done["light"])
    rms, far = stripe(truth, done["pixels"], done["frames"])
    axis = lambda n, v: np.cos(np.pi / 6) * np.asarray(v) + 0.5 * np.asarray(n)
    normal = truth["plane"]["normal"]
    found = axis(done["normal"], done["vein"])
    k = done["k"]
    return {
        "focal_percent": 100 * abs(k[0, 0] / camera["fx"] - 1),
        "principal_px": float(np.hypot(k[0, 2] - camera["u0"], k[1, 2] - camera["v0"])),
        "light_mm": plane,
        "light_turned_mm": turned,
        "stripe_px": rms,
        "stripe_far_percent": far,
        "normal_deg": angle(done["normal"], normal),
        "entry_mm": float(np.linalg.norm(np.subtract(done["entry"], truth["entry"]["point_mm"]))),
        "axis_deg": angle(found, axis(normal, truth["vein"]["direction"])),
        "axis_on_plane_deg": angle(found, axis(normal, truth["vein"]["direction_by_plane"])),
    }
