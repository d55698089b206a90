"""True tracks and depth of a case of data/gt, as files for `animimic animate --tracks --depth`: what perfect cues would give.

Tracks: random surface points, seen in their query frame by the depth test, followed exactly; they start in frame 0 and, fewer, in
later frames, for what turns into view. Depth: the case's own, brought to the video's size. Both are truth: for measuring only.
"""
import json
import numpy as np

POINTS, LATER_POINTS, LATER_EVERY = 600, 200, 12
SEED = 1
VISIBLE_GAP = 0.005  # a point is seen if it lies no deeper than this behind the depth map [rest diagonal]


def depth_maps(case):
    d = np.load(case / "depth.npz")
    q = np.cumsum(d["delta"], axis=2, dtype=np.uint16)
    z = d["z_near"] + (q.astype(np.float64) - 1) / (d["levels"] - 1) * (d["z_far"] - d["z_near"])
    return np.where(q > 0, z, np.nan)


def enlarged(half):
    """Pixel (2i, 2j) of the video holds sample (i, j); those between are means of their neighbours."""
    n, h, w = half.shape
    full = np.full((n, 2 * h, 2 * w), np.nan)
    full[:, ::2, ::2] = half
    full[:, ::2, 1:-1:2] = 0.5 * (half[:, :, :-1] + half[:, :, 1:])
    full[:, 1:-1:2, :] = 0.5 * (full[:, 0:-2:2, :] + full[:, 2::2, :])
    return full


def true_tracks(case, depth, rng):
    gt, camera = np.load(case / "gt.npz"), json.loads((case / "camera.json").read_text())
    vertices = gt["verts_unique"].astype(np.float64)[:, gt["vert_to_unique"]]
    faces = gt["faces"]
    diagonal = np.linalg.norm(np.ptp(vertices[0], axis=0))
    a, b, c = (vertices[0][faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    count = 20 * POINTS
    face = rng.choice(len(faces), count, p=area / area.sum())
    u = np.sqrt(rng.random(count))
    v = rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], 1)
    view = np.array(camera["views"]["main"]["world_to_camera_opencv"])
    points = np.einsum("nk,fnka->fna", weights, vertices[:, faces[face]]) @ view[:3, :3].T + view[:3, 3]
    z = points[..., 2]
    pixels = points[..., :2] / z[..., None] * [camera["fx"], camera["fy"]] + [camera["cx"], camera["cy"]]
    column, row = (np.clip((pixels[..., k] / 2).astype(int), 0, depth.shape[2 - k] - 1) for k in (0, 1))
    inside = (pixels >= 0).all(-1) & (pixels < [camera["width"], camera["height"]]).all(-1)
    front = depth[np.arange(len(z))[:, None], row, column]
    seen = inside & (np.abs(z - front) < VISIBLE_GAP * diagonal)
    chosen, query = [], []
    for frame in range(0, len(z) - 1, LATER_EVERY):
        visible = np.flatnonzero(seen[frame])
        pick = rng.permutation(visible)[: POINTS if frame == 0 else LATER_POINTS]
        chosen.append(pick)
        query.append(np.full(len(pick), frame))
    chosen, query = np.concatenate(chosen), np.concatenate(query)
    return pixels[:, chosen].astype(np.float32), seen[:, chosen].astype(np.float32), query


def write(case, folder):
    """Writes tracks.npz and depth.npz; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    depth = depth_maps(case)
    tracks, visibility, queries = true_tracks(case, depth, np.random.default_rng(SEED))
    np.savez(folder / "tracks.npz", tracks=tracks, visibility=visibility, queries=queries.astype(np.int64))
    np.savez(folder / "depth.npz", depth=np.nan_to_num(enlarged(depth)).astype(np.float32))
    return folder / "tracks.npz", folder / "depth.npz"
