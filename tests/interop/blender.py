"""Imports GLBs into Blender (bpy 5.0.1, CPython 3.11), plays every clip and compares the deformed vertices with our own forward kinematics.

    python blender.py FOLDER   (NAME.glb beside NAME.npz)

With merge_vertices off the importer keeps every vertex, object by object in file order.
"""
import json
import struct
import sys
from pathlib import Path

import bpy
import numpy as np

TOLERANCE = 1e-4


def mesh_nodes(path):
    """Names of the mesh nodes in node order, and their vertex counts."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    j = json.loads(data[20 : 20 + length])
    out = []
    for i, node in enumerate(j["nodes"]):
        if "mesh" in node:
            primitives = j["meshes"][node["mesh"]]["primitives"]
            out.append((i, node.get("name"), sum(j["accessors"][p["attributes"]["POSITION"]]["count"] for p in primitives)))
    return j, out


def deformed(objects):
    """World positions of all objects' evaluated vertices in glTF axes (y up)."""
    graph = bpy.context.evaluated_depsgraph_get()
    parts = []
    for o in objects:
        e = o.evaluated_get(graph)
        mesh = e.to_mesh()
        v = np.empty(len(mesh.vertices) * 3)
        mesh.vertices.foreach_get("co", v)
        m = np.array(e.matrix_world)
        w = v.reshape(-1, 3) @ m[:3, :3].T + m[:3, 3]
        parts.append(np.c_[w[:, 0], w[:, 2], -w[:, 1]])
        e.to_mesh_clear()
    return parts


def check(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    z = np.load(path.with_suffix(".npz"))
    j, nodes = mesh_nodes(path)
    # The frame rate of the keys, so that they fall on whole frames.
    bpy.context.scene.render.fps = 24
    bpy.ops.import_scene.gltf(filepath=str(path), merge_vertices=False, import_shading="NORMALS", disable_bone_shape=True, guess_original_bind_pose=True)
    imported = [o for o in bpy.data.objects if o.type == "MESH"]
    ordered = []
    for _, name, count in nodes:
        match = [o for o in imported if o not in ordered and len(o.data.vertices) == count and (name is None or o.name.split(".")[0] == name.split(".")[0] or o.name == name)]
        match = match or [o for o in imported if o not in ordered and len(o.data.vertices) == count]
        if not match:
            raise ValueError(f"no object of {count} vertices for node {name}")
        ordered.append(match[0])
    worst, k = 0.0, 0
    while f"clip_{k}_times" in z.files:
        name, start = j["animations"][k]["name"], 0.0
        for o in bpy.data.objects:
            data = o.animation_data
            if data is None:
                continue
            for track in data.nla_tracks:
                track.mute = track.name != name
                if track.name == name:
                    # The importer puts time 0 at the scene's first frame.
                    start = track.strips[0].frame_start - track.strips[0].action_frame_start
            data.action = None
        for time, ours in zip(z[f"clip_{k}_times"], z[f"clip_{k}_vertices"]):
            frame = start + time * bpy.context.scene.render.fps
            bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame - np.floor(frame)))
            theirs = np.concatenate(deformed(ordered))
            worst = max(worst, float(np.linalg.norm(theirs - ours, axis=1).max() / z["diagonal"]))
        k += 1
    return worst


bad, overall, total = 0, 0.0, 0
for glb in sorted(Path(sys.argv[1]).glob("*.glb")):
    total += 1
    try:
        worst = check(glb)
    except Exception as error:  # noqa: BLE001 (every failure counts against the file)
        print(f"blender {glb.stem}: {error}")
        worst = np.inf
    if worst <= TOLERANCE:
        overall = max(overall, worst)
    else:
        bad += 1
        print(f"blender {glb.stem}: {worst:.2e} of the diagonal", flush=True)
print(f"blender: {total - bad} of {total} files within {TOLERANCE}, worst of these {overall:.2e}")
sys.exit(bad > 0)
