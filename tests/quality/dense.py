#!/usr/bin/env python3
"""Splits every triangle of a skinned GLB into n x n, until it has at least --faces: a stand-in for a dense generated mesh.

    python3 tests/quality/dense.py IN.glb OUT.glb [--faces 400000]

Positions, normals, texture coordinates and joint weights are interpolated (the four largest weights kept), so that the dense
model moves as the coarse one does. Needs numpy. Reads plain GLBs only: one mesh with one triangle primitive, no compression.
"""
import argparse, json, math, struct
from pathlib import Path

import numpy as np

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def read(path):
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20:20 + length]), data[28 + length:]


def accessor(gltf, blob, index):
    a = gltf["accessors"][index]
    view = gltf["bufferViews"][a["bufferView"]]
    kind, width = np.dtype(TYPES[a["componentType"]]), WIDTHS[a["type"]]
    start, stride = view.get("byteOffset", 0) + a.get("byteOffset", 0), view.get("byteStride") or kind.itemsize * width
    rows = np.ndarray((a["count"], width), kind, blob, start, (stride, kind.itemsize)).copy()
    if a.get("normalized") and kind != np.float32:
        rows = rows.astype(np.float32) / np.iinfo(kind).max
    return rows


def split(n):
    """Barycentric weights of the points of a triangle split n x n, and its small triangles."""
    index, points = {}, []
    for i in range(n + 1):
        for j in range(n + 1 - i):
            index[i, j] = len(points)
            points.append(((n - i - j) / n, i / n, j / n))
    small = []
    for i in range(n):
        for j in range(n - i):
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
            if i + j < n - 1:
                small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    return np.array(points), np.array(small)


def blended_weights(joints, weights, triangles, points):
    """Joints and weights of all split points: the four largest of the blend of three corners."""
    corners_j = joints[triangles].reshape(len(triangles), -1)
    out_j, out_w = [], []
    for b in points:
        w = (weights[triangles] * b[None, :, None]).reshape(len(triangles), -1).copy()
        same = corners_j[:, :, None] == corners_j[:, None, :]
        merged = (same * w[:, None, :]).sum(2)
        first = np.argmax(same, 2) == np.arange(w.shape[1])
        merged = np.where(first, merged, 0)
        best = np.argsort(-merged, 1, kind="stable")[:, :4]
        picked = np.take_along_axis(merged, best, 1)
        out_w.append(picked / picked.sum(1, keepdims=True))
        out_j.append(np.where(picked > 0, np.take_along_axis(corners_j, best, 1), 0))
    return np.stack(out_j, 1).reshape(-1, 4), np.stack(out_w, 1).reshape(-1, 4)


def main():
    args = argparse.ArgumentParser()
    args.add_argument("input", type=Path)
    args.add_argument("output", type=Path)
    args.add_argument("--faces", type=int, default=400_000)
    args = args.parse_args()
    gltf, blob = read(args.input)
    [primitive] = gltf["meshes"][0]["primitives"]
    attributes = {k: accessor(gltf, blob, v) for k, v in primitive["attributes"].items()}
    count = len(attributes["POSITION"])
    triangles = (accessor(gltf, blob, primitive["indices"]) if "indices" in primitive else np.arange(count)).reshape(-1, 3)
    triangles = triangles.astype(np.int64)
    n = math.ceil(math.sqrt(args.faces / len(triangles)))
    points, small = split(n)
    new = {}
    for name, rows in attributes.items():
        if name not in ("JOINTS_0", "WEIGHTS_0"):
            new[name] = np.einsum("pk,tkc->tpc", points, rows[triangles]).reshape(-1, rows.shape[1]).astype(np.float32)
    j, w = blended_weights(attributes["JOINTS_0"].astype(np.int64), attributes["WEIGHTS_0"], triangles, points)
    new["JOINTS_0"], new["WEIGHTS_0"] = j.astype(np.uint16), w.astype(np.float32)
    indices = (small[None] + len(points) * np.arange(len(triangles))[:, None, None]).reshape(-1, 1).astype(np.uint32)

    blob = bytearray(blob[:gltf["buffers"][0]["byteLength"]])

    def add(rows, kind, component):
        blob.extend(b"\0" * (-len(blob) % 4))
        gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": rows.nbytes})
        blob.extend(rows.tobytes())
        gltf["accessors"].append({"bufferView": len(gltf["bufferViews"]) - 1, "componentType": component, "count": len(rows), "type": kind})
        return len(gltf["accessors"]) - 1

    kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
    for name, rows in new.items():
        primitive["attributes"][name] = add(rows, kinds[rows.shape[1]], 5123 if name == "JOINTS_0" else 5126)
    position = gltf["accessors"][primitive["attributes"]["POSITION"]]
    position["min"], position["max"] = new["POSITION"].min(0).tolist(), new["POSITION"].max(0).tolist()
    primitive["indices"] = add(indices, "SCALAR", 5125)
    blob.extend(b"\0" * (-len(blob) % 4))
    gltf["buffers"][0]["byteLength"] = len(blob)
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    args.output.write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON")
                            + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob)
    print(f"{len(indices) // 3} faces, {len(new['POSITION'])} vertices")


if __name__ == "__main__":
    main()
