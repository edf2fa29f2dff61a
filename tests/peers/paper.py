"""The paper's way in Python with OpenCV, step for step: Algorithm 1 and Section 2.2 for the light
planes, Section 3.2 for the hand, Eq. 12-19 for the plane. Where the paper leaves a value open it is
the one that `cannula --method paper` takes, so that both can be compared stage by stage.

Eq. 7's and Eq. 11's first term is met by moving each point to its pixel's ray; their logarithm has
no lower bound there, so that the other terms move a point no further (measured: 0.005 mm).
"""
import cv2
import numpy as np

from opencv import camera, rays


def _deletable():
    """Zhang and Suen's two tests over the 256 neighbourhoods (north first, clockwise)."""
    codes = np.arange(256)
    p = (codes[:, None] >> np.arange(8)) & 1
    count = p.sum(1)
    rises = ((p == 0) & (np.roll(p, -1, 1) == 1)).sum(1)
    n, e, s, w = p[:, 0], p[:, 2], p[:, 4], p[:, 6]
    both = (count >= 2) & (count <= 6) & (rises == 1)
    return both & (n * e * s == 0) & (e * s * w == 0), both & (n * e * w == 0) & (n * s * w == 0)


DELETABLE = _deletable()


def thin(binary):
    """The skeleton's (x, y), by Zhang and Suen (1984)."""
    padded = np.pad(binary > 0, 1)
    stride = padded.shape[1]
    on = padded.ravel()
    active = np.flatnonzero(on)
    around = np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1])
    weight = 1 << np.arange(8)
    changed = True
    while changed:
        changed = False
        for table in DELETABLE:
            code = on[active[:, None] + around] @ weight
            gone = table[code]
            on[active[gone]] = False
            active = active[~gone]
            changed |= bool(gone.any())
    return np.stack([active % stride - 1, active // stride - 1], 1).astype(float)


def principal(points):
    centre = points.mean(0)
    return centre, np.linalg.svd(points - centre, full_matrices=False)[2][0]


def in_square(difference, level=30, ratio=0.25, slice_off=0.1):
    """Steps 3 and 4 in one grid square: its stripe's centre and skeleton, or None."""
    if difference.size == 0 or difference.max() <= level:
        return None
    _, binary = cv2.threshold(difference, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    largest = max(contours, key=cv2.contourArea)
    _, (w, h), _ = cv2.minAreaRect(largest)
    if (min(w, h) + 1) / (max(w, h) + 1) > ratio:
        return None
    alone = cv2.drawContours(np.zeros_like(binary), [largest], -1, 255, -1)
    skeleton = thin(alone)
    if len(skeleton) < 4:
        return None
    centre, direction = principal(skeleton)
    skeleton = skeleton[np.argsort(skeleton @ direction)]
    cut = int(np.ceil(slice_off * len(skeleton)))
    return centre, skeleton[cut:len(skeleton) - cut]


def board_line(on, off, corners, size):
    """Steps 2 to 5 of Section 2.2.1: the centre line's pixels, or None."""
    columns, rows = size
    grid = corners.reshape(rows, columns, 2)
    side = (np.linalg.norm(np.diff(grid, axis=0), axis=2).mean() + np.linalg.norm(np.diff(grid, axis=1), axis=2).mean()) / 2
    target = np.mgrid[:columns, :rows].T.reshape(-1, 2) * side
    h, _ = cv2.findHomography(corners.reshape(-1, 2), target)
    shape = (int((columns - 1) * side) + 1, int((rows - 1) * side) + 1)
    on, off = cv2.warpPerspective(on, h, shape), cv2.warpPerspective(off, h, shape)
    difference = cv2.subtract(on, off)
    squares = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            x, y = int(np.ceil(column * side)), int(np.ceil(row * side))
            found = in_square(difference[y:int((row + 1) * side), x:int((column + 1) * side)])
            if found is not None:
                squares.append((found[0] + (x, y), found[1] + (x, y)))
    if len(squares) >= 3:
        squares = by_slope(squares)
    if len(squares) < 2:
        return None
    points = np.vstack([s[1] for s in squares])
    centre, direction = principal(points)
    line = centre + ((points - centre) @ direction)[:, None] * direction
    return cv2.perspectiveTransform(line.reshape(-1, 1, 2), np.linalg.inv(h)).reshape(-1, 2)


def by_slope(squares, tolerance=np.radians(2)):
    centres = np.array([s[0] for s in squares])
    _, main = principal(centres)
    d = centres[None] - centres[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.arctan((main[0] * d[..., 1] - main[1] * d[..., 0]) / (d @ main))
    others = ~np.eye(len(centres), dtype=bool)
    median = np.median(slope[np.triu(others)])
    agree = ((np.abs(slope - median) <= tolerance) & others).sum(1)
    return [s for s, a in zip(squares, agree) if 2 * a >= len(centres) - 1]


def to_ray(points, pixels, k, d):
    """Each point moved to the nearest place on its pixel's ray (the first term of Eq. 7)."""
    ray = unit(rays(pixels, k, d))
    return ray * (points * ray).sum(1)[:, None]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def light_planes(session, images, corners, board, k, d):
    """Algorithm 1 for each slide position, the common normal, Eq. 9: (normal, a, b)."""
    size = (session["board"]["columns"], session["board"]["rows"])
    by_position = {}
    for pose, cp in zip(session["light"], corners):
        if cp is None:
            continue
        _, r, t = cv2.solvePnP(board, cp, k, d)
        r = cv2.Rodrigues(r)[0]
        h, _ = cv2.findHomography(cp.reshape(-1, 2), board[:, :2].astype(float))
        for frame in pose["on"]:
            line = board_line(images[frame["image"]], images[pose["off"]], cp, size)
            if line is None:
                continue
            on_board = cv2.perspectiveTransform(line.reshape(-1, 1, 2), h).reshape(-1, 2)
            points = np.c_[on_board, np.zeros(len(on_board))] @ r.T + t.ravel()
            by_position.setdefault(frame["slide_mm"], []).append(to_ray(points, line, k, d))
    sets = {x: np.vstack(p) for x, p in sorted(by_position.items())}
    scatter = sum((p - p.mean(0)).T @ (p - p.mean(0)) for p in sets.values())
    normal = np.linalg.svd(scatter)[2][2]
    normal *= np.sign(normal[2])
    a, b = np.polyfit(list(sets), [-normal @ p.mean(0) for p in sets.values()], 1)
    return normal, a, b


def hand_region(ambient):
    _, binary = cv2.threshold(ambient, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, stats, _ = cv2.connectedComponentsWithStats(binary, connectivity=8)
    x, y, w, h, _ = max(stats[1:], key=lambda s: s[4])
    return x, y, w, h


def hand_line(image, region, gamma=1.6, closing=7, largest=0.1):
    """Steps 2 to 4 of Section 3.2: the stripe's skeleton, in the image's pixels."""
    x, y, w, h = region
    table = np.rint(255 * (np.arange(256) / 255) ** gamma).astype(np.uint8)
    cut = cv2.LUT(image[y:y + h, x:x + w], table)
    _, binary = cv2.threshold(cut, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    if (binary > 0).mean() > largest:  # no stripe in it
        return np.zeros((0, 2))
    closed = cv2.morphologyEx(binary, cv2.MORPH_CLOSE, np.ones((closing, closing), np.uint8))
    return thin(closed) + (x, y)


def meet(normal, d, ray):
    return ray * (-d / (ray @ normal))[..., None]


def work(session, images, corners_of):
    """The whole job; a dictionary of what each stage gave."""
    board, poses, k, d = camera(session, images, corners_of)
    light = light_planes(session, images, poses, board, k, d)
    region = hand_region(images[session["scan"]["ambient"]])
    cloud, pixels, frames = [], [], []
    for i, frame in enumerate(session["scan"]["frames"]):
        points = hand_line(images[frame["image"]], region)
        if len(points):
            cloud.append(meet(light[0], light[1] * frame["slide_mm"] + light[2], rays(points, k, d)))
            pixels.append(points)
            frames.append(np.full(len(points), i))
    cloud, pixels, frames = np.vstack(cloud), np.vstack(pixels), np.concatenate(frames)
    return {"k": k, "d": d, "light": light, "pixels": pixels, "frames": frames,
            **needle(cloud, pixels, session["entry"], k, d)}


def needle(cloud, pixels, entry, k, d):
    """Section 2.4: the region around the entry, Eq. 15, entry and vein on that plane."""
    near = cloud[np.argsort(np.linalg.norm(pixels - entry["pixel"], axis=1))[:9]]
    centre = rays([entry["pixel"]], k, d)[0] * np.median(near[:, 2])
    region = cloud[np.linalg.norm(cloud - centre, axis=1) <= entry["radius_mm"]]
    a, b, c = np.linalg.lstsq(np.c_[region[:, :2], np.ones(len(region))], region[:, 2], rcond=None)[0]
    length = np.sqrt(a * a + b * b + 1)
    normal, d0 = np.array([-a, -b, 1]) / length, -c / length
    point = meet(normal, d0, rays([entry["pixel"]], k, d))[0]
    vein = meet(normal, d0, rays(entry["vein"], k, d))
    line = principal(vein)[1]
    line *= np.sign(line @ (vein[-1] - vein[0]))
    return {"normal": normal, "entry": point, "vein": line}
