"""Compares with an independent numpy reader of GLBs (judge.py of the shared benches). python numpy_judge.py JUDGE_DIR FOLDER"""
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, sys.argv[1])
from judge import Glb  # noqa: E402

TOLERANCE = 1e-4
bad, overall, total = 0, 0.0, 0
for path in sorted(Path(sys.argv[2]).glob("*.npz")):
    z, glb = np.load(path), Glb(path.with_suffix(".glb"))
    if "tolerance" in z.files and z["tolerance"] > TOLERANCE:
        continue  # morph targets, which that reader does not play
    worst, k, total = 0.0, 0, total + 1
    while f"clip_{k}_times" in z.files:
        for time, ours in zip(z[f"clip_{k}_times"], z[f"clip_{k}_vertices"]):
            theirs = glb.vertices(glb.j["animations"][k], float(time))[0]
            if theirs.shape != ours.shape:
                worst = np.inf
                break
            worst = max(worst, float(np.linalg.norm(theirs - ours, axis=1).max() / z["diagonal"]))
        k += 1
    if worst <= TOLERANCE:
        overall = max(overall, worst)
    else:
        bad += 1
        print(f"numpy {path.stem}: {worst:.2e} of the diagonal")
print(f"numpy: {total - bad} of {total} files within {TOLERANCE}, worst of these {overall:.2e}")
sys.exit(bad > 0)
