#!/usr/bin/env python3
"""Runs `animimic animate` on cases with known truth and scores the GLBs with the outside judge.

    python3 tests/quality/run.py [CASE ...] [options] [-- more options for `animimic animate`]

    --bin FILE      the program (default: $ANIMIMIC, $CARGO_TARGET_DIR/release/animimic, target/release/animimic)
    --shared DIR    the folder with data/ and bench/ (default: ../shared beside the repository)
    --out DIR       where results go (default: out/quality in the repository)
    --true-masks    give the masks of the truth instead of letting the program find its own
    --true-cues     give tracks and depth of the truth too: what the fit makes of perfect cues (median MPJPE <= 0.7 %)
    --no-rig        give the mesh alone: the program makes the skeleton (judged by vertices and silhouettes; joints are not comparable)
    --soft          go on to soft tissue and score soft.glb; without it the skeleton's motion alone is made and scored
    --auto-camera   let the program find the camera instead of giving camera.json (no gates on errors then: scale is free)
    --real          also data/real (fish, crocodile), preset camera, scored against masks.npz
    --reuse         score what is in --out already, run nothing
    --json FILE     write all rows

Cases are named by folder (`fox_walk`); without names all of data/gt run. One case after the other, the program may use all threads.
Needs numpy and opencv-python-headless, for the judge. A gate that fails makes the exit code 1.
"""
import argparse, importlib.util, json, os, resource, statistics, subprocess, sys, time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.dont_write_bytecode = True

ROOT = Path(__file__).resolve().parents[2]
GATES = [  # (key, test on the median, words)
    ("mpjpe_pct", lambda x: x <= 2.0, "<= 2.0"),
    ("vertex_rms_pct", lambda x: x <= 2.0, "<= 2.0"),
    ("iou_main", lambda x: x >= 0.95, ">= 0.95"),
    ("iou_novel_p45", lambda x: x >= 0.92, ">= 0.92"),
    ("iou_novel_m45", lambda x: x >= 0.92, ">= 0.92"),
    ("completeness", lambda x: 0.9 <= x <= 1.1, "0.9-1.1"),
    ("jitter", lambda x: x <= 1.5, "<= 1.5"),
]
TRUE_CUES_GATES = [("mpjpe_pct", lambda x: x <= 0.7, "<= 0.7")]
COLUMNS = [("mpjpe_pct", "mpjpe%", 7, 2), ("vertex_rms_pct", "rms%", 6, 2), ("vertex_rms_plane_pct", "plane", 6, 2),
           ("vertex_rms_depth_pct", "depth", 6, 2), ("static_rms_pct", "still", 6, 2), ("iou_main", "iou", 6, 3),
           ("iou_novel_p45", "+45", 6, 3), ("iou_novel_m45", "-45", 6, 3), ("completeness", "compl", 6, 2),
           ("jitter", "jitt", 6, 2), ("s_per_frame", "s/frm", 6, 2), ("cpu_s", "cpu s", 6, 0), ("peak_mib", "MiB", 6, 0)]


def load_judge(shared):
    spec = importlib.util.spec_from_file_location("judge", shared / "bench" / "judge" / "judge.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def find_program(given):
    target = os.environ.get("CARGO_TARGET_DIR", str(ROOT / "target"))
    for path in [given, os.environ.get("ANIMIMIC"), f"{target}/release/animimic"]:
        if path and Path(path).is_file():
            return str(Path(path).resolve())
    sys.exit(f"run.py: no program at {target}/release/animimic; build it with `cargo build --release -p animimic-cli` or name it with --bin")


def run(command, log):
    """Runs a command; returns exit code, wall seconds, CPU seconds and peak memory of the child."""
    log.parent.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    with open(log, "w") as f:
        child = subprocess.Popen(command, stdout=f, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    return child.returncode, time.monotonic() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def last_line(log):
    lines = [l for l in log.read_text(errors="replace").replace("\r", "\n").splitlines() if l.strip()]
    return lines[-1] if lines else "(no output)"


def timed_row(name, command, out, frames, reuse):
    row, log = {"case": name}, out / "log.txt"
    timing = out / "timing.json"
    if not reuse:
        code, wall, cpu, peak = run(command, log)
        row |= {"exit": code, "s_per_frame": wall / frames, "wall_s": wall, "cpu_s": cpu, "peak_mib": peak}
        timing.write_text(json.dumps(row))
        if code != 0:
            row["error"] = last_line(log)
    elif timing.exists():
        row |= json.loads(timing.read_text())
    return row


def truth_case(judge, program, case, out, args):
    import true_cues
    camera = json.loads((case / "camera.json").read_text())
    given = "auto" if args.auto_camera else str(case / "camera.json")
    command = [program, "animate", str(case / ("static_norig.glb" if args.no_rig else "static.glb")), str(case / "video.mp4"), "-o", str(out), "--camera", given]
    if args.true_masks:
        command += ["--mask", str(case / "masks.npz")]
    if args.true_cues:
        tracks, depth = true_cues.write(case, out / "cues")
        command += ["--tracks", str(tracks), "--depth", str(depth)]
    command += ["--stage", "soft" if args.soft else "pose"]
    row = timed_row(case.name, command + args.more, out, camera["frames"], args.reuse)
    if "error" not in row:
        try:
            row |= judge.judge(out / ("soft.glb" if args.soft else "animated.glb"), case)
        except (AssertionError, KeyError, ValueError, OSError) as e:
            row["error"] = str(e)
    return row


def video_times(path):
    """Presentation times of the frames [s], from 0, by OpenCV."""
    import cv2
    video, times = cv2.VideoCapture(str(path)), []
    while video.grab():
        times.append(video.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    return [t - times[0] for t in times]


def real_case(judge, program, case, out, args):
    """Mask IoU of the posed mesh, seen by the camera that the program says it used, against masks.npz at native size."""
    import numpy as np
    masks = np.load(case / "masks.npz")
    times = video_times(case / "input.mp4")
    command = [program, "animate", str(case), str(case / "input.mp4"), "-o", str(out), "--camera", args.real_camera]
    command += ["--stage", "soft" if args.soft else "pose"]
    row = timed_row(f"real/{case.name}", command + args.more, out, len(times), args.reuse)
    if "error" in row:
        return row
    try:
        w, h = int(masks["width"]), int(masks["height"])
        file = json.loads((out / "camera.json").read_text())
        sx, sy = w / file["width"], h / file["height"]
        camera = {"width": w, "height": h, "fx": file["fx"] * sx, "fy": file["fy"] * sy, "cx": file["cx"] * sx, "cy": file["cy"] * sy}
        view = np.array(file["views"]["main"]["world_to_camera_opencv"])
        glb = judge.Glb(out / ("soft.glb" if args.soft else "animated.glb"))
        faces, start = [], 0
        for node in glb.nodes:
            if "mesh" in node:
                for pr in glb.j["meshes"][node["mesh"]]["primitives"]:
                    n = glb.j["accessors"][pr["attributes"]["POSITION"]]["count"]
                    index = glb.acc(pr["indices"])[:, 0].astype(int) if "indices" in pr else np.arange(n)
                    faces.append(index.reshape(-1, 3) + start)
                    start += n
        faces = np.concatenate(faces)
        ious = []
        for k, frame in enumerate(masks["frames"]):
            v, _, _ = glb.vertices(glb.j["animations"][0], times[int(frame)])
            a = np.unpackbits(masks["masks"][k], axis=1)[:, :w].astype(bool)
            b = judge.silhouette(v, faces, view, camera, ss=4)
            ious.append((a & b).sum() / max(1, (a | b).sum()))
        row["iou_main"], row["iou_main_min"] = float(np.mean(ious)), float(np.min(ious))
    except (AssertionError, KeyError, ValueError, OSError) as e:
        row["error"] = str(e)
    return row


def line(row):
    cells = [f"{row[k]:{w}.{d}f}" if isinstance(row.get(k), float) else " " * (w - 1) + "-" for k, _, w, d in COLUMNS]
    return f"{row['case']:18}" + " ".join(cells) + (f"  {row['error']}" if "error" in row else "")


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("cases", nargs="*")
    ap.add_argument("--bin")
    ap.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    ap.add_argument("--out", type=Path, default=ROOT / "out" / "quality")
    ap.add_argument("--true-masks", action="store_true")
    ap.add_argument("--true-cues", action="store_true")
    ap.add_argument("--no-rig", action="store_true")
    ap.add_argument("--soft", action="store_true")
    ap.add_argument("--auto-camera", action="store_true")
    ap.add_argument("--real", action="store_true")
    ap.add_argument("--real-camera", default="preset:puppeteer:front")
    ap.add_argument("--reuse", action="store_true")
    ap.add_argument("--json", type=Path)
    argv = sys.argv[1:]
    cut = argv.index("--") if "--" in argv else len(argv)
    args = ap.parse_args(argv[:cut])
    args.more = argv[cut + 1:]
    if not (args.shared / "data" / "gt").is_dir():
        print(f"skipped: no test data at {args.shared / 'data' / 'gt'}")
        return 0
    judge, program = load_judge(args.shared), find_program(args.bin)
    gt = sorted(d for d in (args.shared / "data" / "gt").iterdir() if d.is_dir())
    real = sorted(d for d in (args.shared / "data" / "real").iterdir() if d.is_dir())
    jobs = [(truth_case, d) for d in gt if not args.cases or d.name in args.cases]
    jobs += [(real_case, d) for d in real if args.real or d.name in args.cases]
    print(f"{'case':18}" + " ".join(f"{title:>{w}}" for _, title, w, _ in COLUMNS), flush=True)
    rows = []
    for work, case in jobs:
        rows.append(work(judge, program, case, args.out / case.name, args))
        print(line(rows[-1]), flush=True)
    scored = [r for r in rows if "vertex_rms_pct" in r]
    if scored:
        keys = {k for k, *_ in COLUMNS}
        print(line({"case": "median"} | {k: statistics.median(r[k] for r in scored if k in r) for k in keys if any(k in r for r in scored)}))
    return verdict(rows, scored, args)


def verdict(rows, scored, args):
    failed = 0

    def say(good, words):
        nonlocal failed
        failed += not good
        print(("ok    " if good else "FAILS ") + words)

    for key, test, words in TRUE_CUES_GATES if args.true_cues else GATES:
        values = [r[key] for r in scored if key in r]
        if values and not args.auto_camera:
            median = statistics.median(values)
            say(test(median), f"median {key} {median:.3f} ({words})")
    worse = [r["case"] for r in scored if r["vertex_rms_pct"] >= r["static_rms_pct"]]
    if scored:
        say(not worse, f"every case better than the still model{': not ' + ', '.join(worse) if worse else ''}")
        worst = max(scored, key=lambda r: r["vertex_rms_pct"])
        print(f"      worst case {worst['case']}: vertex rms {worst['vertex_rms_pct']:.2f} %")
    for r in rows:
        if r["case"].startswith("real/") and "iou_main" in r:
            say(r["iou_main"] >= 0.90, f"{r['case']} mask IoU {r['iou_main']:.3f} (>= 0.90), worst frame {r['iou_main_min']:.3f}")
    timed = [r for r in rows if "s_per_frame" in r and "error" not in r]
    if timed:
        slow, fat = max(timed, key=lambda r: r["s_per_frame"]), max(timed, key=lambda r: r["peak_mib"])
        say(slow["s_per_frame"] <= 2.4, f"slowest {slow['case']} {slow['s_per_frame']:.2f} s a frame (<= 2.4)")
        say(fat["peak_mib"] <= 2048, f"largest {fat['case']} {fat['peak_mib']:.0f} MiB (<= 2048)")
    broken = [r["case"] for r in rows if "error" in r]
    say(not broken, f"every case ended with a result{': not ' + ', '.join(broken) if broken else ''}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
