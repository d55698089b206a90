"""NAME.npz of the roundtrip example -> NAME.json for the JavaScript judges. python expected.py FOLDER"""
import json
import sys
from pathlib import Path

import numpy as np

for path in sorted(Path(sys.argv[1]).glob("*.npz")):
    z = np.load(path)
    clips, k = [], 0
    while f"clip_{k}_times" in z.files:
        vertices = [v.ravel().tolist() for v in z[f"clip_{k}_vertices"]]
        clips.append({"times": z[f"clip_{k}_times"].tolist(), "vertices": vertices})
        k += 1
    path.with_suffix(".json").write_text(json.dumps({"diagonal": float(z["diagonal"]), "tolerance": float(z["tolerance"]) if "tolerance" in z.files else 1e-4, "clips": clips}))
