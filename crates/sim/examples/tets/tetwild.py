"""pytetwild on the models of a folder, for the table of the example beside: python tetwild.py DIR > RIVAL.jsonl

Needs pytetwild, pyvista, trimesh, numpy. Its default settings, one thread; CPU seconds; quality 3 r/R as the example measures it."""
import json
import os
import subprocess
import sys
import tempfile
import time

LIMIT_S = 150


def quality(v, t):
    import numpy as np

    x = v[t]
    a, b, c = (x[:, k] - x[:, 0] for k in (1, 2, 3))
    six = np.abs(np.einsum("ij,ij->i", np.cross(a, b), c))
    n = lambda m: np.linalg.norm(m, axis=1)
    area = 0.5 * (n(np.cross(a, b)) + n(np.cross(b, c)) + n(np.cross(c, a)) + n(np.cross(b - a, c - a)))
    s = lambda m: (m * m).sum(1)[:, None]
    outer = n(s(a) * np.cross(b, c) + s(b) * np.cross(c, a) + s(c) * np.cross(a, b)) / (2 * six)
    return 3 * (0.5 * six / area) / outer


def one(path):
    import numpy as np
    import pytetwild
    import trimesh

    mesh = trimesh.load(path, force="mesh", process=True)
    start = time.process_time()
    v, t = pytetwild.tetrahedralize(mesh.vertices, mesh.faces.astype(np.int32), num_threads=1)
    seconds = time.process_time() - start
    q = quality(v, t)
    return {"cpu_s": round(seconds, 2), "tets": len(t), "worst": round(float(q.min()), 4), "mean": round(float(q.mean()), 4)}


if sys.argv[1] == "--one":
    print(json.dumps(one(sys.argv[2])))
else:
    # It leaves files where it runs.
    scratch = tempfile.TemporaryDirectory()
    for folder, _, names in sorted(os.walk(sys.argv[1])):
        for name in sorted(names):
            if not name.lower().endswith((".obj", ".off", ".stl")):
                continue
            path = os.path.join(folder, name)
            line = {"model": os.path.relpath(path, sys.argv[1])}
            try:
                out = subprocess.run([sys.executable, os.path.abspath(__file__), "--one", os.path.abspath(path)], capture_output=True, text=True, timeout=LIMIT_S, cwd=scratch.name)
                last = out.stdout.strip().splitlines()[-1:] or ["{}"]
                line.update(json.loads(last[0]) if last[0].startswith("{\"") else {"failed": f"exit {out.returncode}"})
            except subprocess.TimeoutExpired:
                line["failed"] = f"not done in {LIMIT_S} s (wall)"
            print(json.dumps(line), flush=True)
