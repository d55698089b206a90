#!/usr/bin/env python3
"""Compares `animimic evaluate` with the outside judge on GLBs whose clips are right, wrong and of another speed.

    python3 tests/quality/agree.py [--bin FILE] [--shared DIR]

Every clip of data/models is scored against every case of data/gt that was made from that model: the right clip gives errors
near 0, the others large ones. Tolerances: 1e-3 of the value (and 1e-3 absolute) on geometry, 1e-2 on iou_*.
"""
import argparse, json, subprocess, sys
from pathlib import Path
from run import ROOT, find_program, load_judge

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument("--bin")
ap.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
ap.add_argument("--clips", type=int, default=2, help="clips per case")
args = ap.parse_args()
if not (args.shared / "data" / "gt").is_dir():
    sys.exit(f"skipped: no test data at {args.shared / 'data' / 'gt'}")
judge, program = load_judge(args.shared), find_program(args.bin)
worst, failed, compared = {}, 0, 0
for case in sorted((args.shared / "data" / "gt").iterdir()):
    model = args.shared / "data" / "models" / Path(json.loads((case / "meta.json").read_text())["model"]).name
    if not model.is_file():
        print(f"{case.name}: skipped, no {model.name} among the models")
        continue
    clips = [c.get("name") for c in judge.Glb(model).j.get("animations", [])][: args.clips]
    for clip in clips:
        try:
            want = judge.judge(model, case, clip)
        except (AssertionError, KeyError, ValueError) as e:
            print(f"{case.name} {clip}: skipped, the judge says: {e}")
            continue
        run = subprocess.run([program, "evaluate", str(model), "--truth", str(case), "--json", "-q", *(["--clip", clip] if clip else [])], capture_output=True, text=True)
        if run.returncode:
            print(f"{case.name} {clip}: FAILS {run.stderr.strip()}")
            failed += 1
            continue
        got, bad = json.loads(run.stdout), []
        for key, a in want.items():
            if not isinstance(a, (int, float)) or isinstance(a, bool):
                continue
            b = got.get(key, float("nan"))
            off = abs(a - b) if key.startswith("iou") else abs(a - b) / max(1.0, abs(a))
            worst[key] = max(worst.get(key, 0.0), off)
            compared += 1
            if not off <= (1e-2 if key.startswith("iou") else 1e-3):
                bad.append(f"{key}: judge {a}, ours {b}")
        failed += len(bad)
        print(f"{case.name} {clip}: {'agrees' if not bad else 'FAILS ' + '; '.join(bad)} (vertex rms {want['vertex_rms_pct']:.3f} %)", flush=True)
print("largest difference by key: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()))
print(f"{compared} numbers compared, {failed} off")
sys.exit(1 if failed else 0)
