//! Seeded mutations of videos, frames and cues: no panic, no hang, less than a gibibyte. Goes on where `scene/tests/fuzz.rs` ends.
mod support;

#[path = "../../scene/tests/common/mutate.rs"]
mod mutate;
#[path = "../../scene/tests/common/repack.rs"]
mod repack;

use animimic_scene::{DepthKind, DepthMap, Mask, Tracks};
use animimic_video::cues::{read_depth, read_masks, read_tracks, write_depth, write_masks, write_tracks};
use animimic_video::{ReadOptions, VideoError, read, write_gif, write_mp4};
use mutate::{Random, hammer, hammer_with, in_a_small_child, mutated};
use std::path::Path;
use support::*;

/// Whether it was read; what was refused is told on one line.
fn told<T>(result: Result<T, VideoError>) -> bool {
    match result {
        Ok(_) => true,
        Err(e) => {
            assert!(e.to_string().lines().count() <= 1, "{e}");
            false
        }
    }
}

fn made(path: &Path, write: impl FnOnce(&Path) -> Result<(), VideoError>) -> Vec<u8> {
    write(path).expect("writes");
    std::fs::read(path).expect("there")
}

/// A video in a file of that name.
fn watched(path: &Path, bytes: &[u8]) -> bool {
    std::fs::write(path, bytes).expect("written");
    let result = read(path, &ReadOptions::default());
    if let Ok(video) = &result {
        assert!(video.frames.len() >= 2 && video.fps > 0.0 && video.fps.is_finite());
        assert!(video.frames.iter().all(|f| f.rgb.len() == f.width * f.height));
    }
    told(result)
}

#[test]
fn mutated_videos_never_panic_or_hang() {
    if !in_a_small_child("mutated_videos_never_panic_or_hang", 60) {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("input");
    let mp4 = made(&path, |p| write_mp4(p, &mut disc(48, 32, 4).into_iter(), 24.0));
    // The tables lie in front; the pictures themselves take longer.
    let tables = mp4.windows(4).position(|w| w == b"mdat").expect("frames") - 4;
    let front = |mp4: &Vec<u8>, random: &mut Random| {
        let mut head = mutated(&mp4[..tables], random);
        head.extend_from_slice(&mp4[tables..]);
        head
    };
    // The same length, so that the tables stay true and the decoder is reached.
    let payload = |mp4: &Vec<u8>, random: &mut Random| {
        let mut tail = mutated(&mp4[tables + 8..], random);
        tail.resize(mp4.len() - tables - 8, 0);
        [&mp4[..tables + 8], &tail].concat()
    };
    hammer_with("mp4 by its tables", std::slice::from_ref(&mp4), 2000, front, |b| watched(&path, &b));
    hammer_with("mp4 by its pictures", &[mp4], 1000, payload, |b| watched(&path, &b));
    let gif = made(&path, |p| write_gif(p, &mut disc(24, 16, 3).into_iter(), 20.0));
    hammer("gif", &[gif], 1000, |b| watched(&path, &b));
}

#[test]
fn mutated_cues_and_frames_never_panic_or_hang() {
    if !in_a_small_child("mutated_cues_and_frames_never_panic_or_hang", 60) {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("cue.npz");
    let mask = Mask { width: 21, height: 9, coverage: (0..189).map(|i| if i % 5 < 2 { 255 } else { 0 }).collect() };
    let masks = made(&file, |p| write_masks(p, &vec![mask; 3]));
    let tracks = Tracks {
        pixels: vec![vec![[1.5, 2.5], [3.25, 4.0]]; 3],
        confidence: vec![vec![0.5, 1.0]; 3],
        query_frame: vec![0, 2],
    };
    let tracks = made(&file, |p| write_tracks(p, &tracks));
    let map = DepthMap { width: 4, height: 3, values: (0..12).map(|i| 1.0 + i as f32).collect() };
    let depth = made(&file, |p| write_depth(p, &[map.clone(), map.clone()], DepthKind::Metric));
    let put = |b: Vec<u8>| std::fs::write(&file, b).expect("written");
    let inside = |b: &Vec<u8>, r: &mut Random| repack::repacked(b, r);
    hammer_with("masks.npz", &[masks], 1000, inside, |b| {
        put(b);
        told(read_masks(&file))
    });
    hammer_with("tracks.npz", &[tracks], 1000, inside, |b| {
        put(b);
        told(read_tracks(&file, Some(3)))
    });
    hammer_with("depth.npz", &[depth], 1000, inside, |b| {
        put(b);
        told(read_depth(&file, None))
    });
    let frames = folder.path().join("frames");
    write_depth(&frames, &[map], DepthKind::Metric).expect("writes");
    let png = std::fs::read(frames.join("00000.png")).expect("there");
    hammer("frames and depth as PNG", &[png], 500, |b| {
        std::fs::write(frames.join("00000.png"), &b).expect("written");
        std::fs::write(frames.join("00001.png"), b).expect("written");
        told(read(&frames, &ReadOptions::default()));
        told(read_masks(&frames)) && told(read_depth(&frames, Some(DepthKind::Inverse)))
    });
    let floats = folder.path().join("floats");
    std::fs::create_dir(&floats).expect("made");
    let data = |name: &str| std::fs::read(format!("{}/tests/data/{name}", env!("CARGO_MANIFEST_DIR"))).expect("there");
    let exr = ["openexr_half_zip.exr", "openexr_float_rle.exr", "openexr_parts.exr"].map(data);
    hammer("depth as EXR", &exr, 3000, |b| {
        std::fs::write(floats.join("0.exr"), b).expect("written");
        told(read_depth(&floats, None))
    });
}
