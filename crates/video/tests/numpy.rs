//! Cue files as NumPy writes and reads them: the forms of SAM 2, CoTracker, AllTracker, TAPIR, VGGT and Depth-Anything, both ways.
//!
//! Needs Python with NumPy (the environment's PYTHON, else python3); without it the tests say so and pass.

use animimic_scene::{DepthKind, DepthMap, Mask, Tracks};
use animimic_video::cues::{read_depth, read_masks, read_tracks, write_depth, write_masks, write_tracks};
use std::path::Path;
use std::process::Command;

/// Runs a script in a folder; `None`, with the reason printed, where there is no NumPy.
fn python(folder: &Path, script: &str) -> Option<String> {
    let program = std::env::var("PYTHON").unwrap_or("python3".into());
    let run = |code: &str| Command::new(&program).args(["-c", code]).current_dir(folder).output();
    if !run("import numpy").is_ok_and(|o| o.status.success()) {
        println!("skipped: {program} has no numpy");
        return None;
    }
    let out = run(&format!("import numpy as np\n{script}")).expect("starts");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    Some(String::from_utf8_lossy(&out.stdout).trim().to_string())
}

#[test]
fn what_other_programs_save_is_read() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = |name: &str| folder.path().join(name);
    let made = python(
        folder.path(),
        "m = np.zeros((5, 1, 6, 10), bool); m[:, 0, 1:4, 2:7] = True
np.savez('sam2.npz', masks=m)
np.savez_compressed('logits.npz', masks=np.where(m, 4.5, -7.25).astype(np.float16))
np.savez('packed.npz', masks=np.packbits(m[:, 0], axis=-1), width=10)
t = np.arange(5 * 3 * 2, dtype=np.float32).reshape(5, 3, 2)
v = np.array([[1, 0, 1]] * 5, bool)
np.savez('cotracker.npz', pred_tracks=t[None], pred_visibility=v[None], queries=np.array([[[0, 1, 1], [2, 1, 1], [4, 1, 1]]], np.float32))
np.savez('alltracker.npz', trajs=t, visconf=np.stack([v * .5, v * .5 + .25], -1))
np.savez('tapir.npz', tracks=np.asfortranarray(t.transpose(1, 0, 2)), visibles=v.T)
d = (1 + np.arange(5 * 6 * 10)).reshape(5, 6, 10).astype(np.float64)
np.savez('vggt.npz', depth=d[None, ..., None].astype(np.float32), depth_conf=d)
np.savez('anything.npz', depths=d, fps=24)
np.savez('disparity.npz', disparity=1 / d)",
    );
    if made.is_none() {
        return;
    }
    for name in ["sam2.npz", "logits.npz", "packed.npz"] {
        let masks = read_masks(&path(name)).expect(name);
        assert_eq!((masks.len(), masks[4].width, masks[4].height, masks[4].area()), (5, 10, 6, 15), "{name}");
        assert!(masks[4].inside(6, 3) && !masks[4].inside(7, 3), "{name}");
    }
    for (name, sure) in [("cotracker.npz", 1.0), ("alltracker.npz", 0.375), ("tapir.npz", 1.0)] {
        let tracks = read_tracks(&path(name), Some(5)).expect(name);
        assert_eq!((tracks.pixels.len(), tracks.pixels[4][2]), (5, [28.0, 29.0]), "{name}");
        assert_eq!(tracks.confidence[3], [sure, 0.0, sure], "{name}");
    }
    assert_eq!(read_tracks(&path("cotracker.npz"), None).expect("reads").query_frame, [0, 2, 4]);
    for (name, kind, last) in [
        ("vggt.npz", DepthKind::Metric, 300.0),
        ("anything.npz", DepthKind::Metric, 300.0),
        ("disparity.npz", DepthKind::Inverse, 1.0 / 300.0),
    ] {
        let (maps, meant) = read_depth(&path(name), None).expect(name);
        assert_eq!((maps.len(), maps[0].width, meant), (5, 10, kind), "{name}");
        assert!((maps[4].values[59] - last).abs() < 1e-6 * last.max(1.0), "{name}");
    }
    assert_eq!(read_depth(&path("anything.npz"), Some(DepthKind::Inverse)).expect("reads").1, DepthKind::Inverse);
}

#[test]
fn what_is_written_numpy_reads() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = |name: &str| folder.path().join(name);
    let mask =
        |t: usize| Mask { width: 11, height: 4, coverage: (0..44).map(|i| if i % 11 < t { 255 } else { 0 }).collect() };
    write_masks(&path("masks.npz"), &(1..4).map(mask).collect::<Vec<_>>()).expect("writes");
    let tracks = Tracks {
        pixels: vec![vec![[1.5, 2.5], [3.25, 4.0]]; 3],
        confidence: vec![vec![0.5, 1.0]; 3],
        query_frame: vec![0, 2],
    };
    write_tracks(&path("tracks.npz"), &tracks).expect("writes");
    let values = (0..12).map(|i| if i == 5 { f32::NAN } else { i as f32 + 0.5 }).collect();
    let maps = [DepthMap { width: 4, height: 3, values }];
    write_depth(&path("depth.npz"), &maps, DepthKind::Inverse).expect("writes");
    let said = python(
        folder.path(),
        "m = np.load('masks.npz'); bits = np.unpackbits(m['masks'], axis=-1)[..., :int(m['width'])]
assert bits.shape == (3, 4, 11) and bits.sum(axis=(1, 2)).tolist() == [4, 8, 12], bits
t = np.load('tracks.npz')
assert t['tracks'].shape == (3, 2, 2) and t['tracks'][2, 1].tolist() == [3.25, 4.0]
assert t['visibility'].tolist() == [[.5, 1.]] * 3 and t['queries'].tolist() == [[0, 1.5, 2.5], [2, 3.25, 4]]
d = np.load('depth.npz')
assert d['depth'].shape == (1, 3, 4) and np.isnan(d['depth'][0, 1, 1]) and d['depth'][0, 2, 3] == 11.5 and d['kind'] == 1
print('read')",
    );
    assert!(said.is_none_or(|s| s == "read"));
}
