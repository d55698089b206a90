//! Masks against renders of known motion and against a segmentation network: on plain backgrounds and on clutter.
mod support;

use animimic_scene::{Image, Mask, Video, io};
use animimic_video::cues::{MaskCue, MaskOptions, masks, masks_with_prior};
use animimic_video::{ReadOptions, read};
use std::path::Path;
use support::*;

/// Mean and least IoU.
fn overlap<'a>(found: impl Iterator<Item = &'a Mask>, truth: &[Mask]) -> (f64, f64) {
    let ious: Vec<f64> = found.zip(truth).map(|(a, b)| a.iou(b)).collect();
    (ious.iter().sum::<f64>() / ious.len() as f64, ious.iter().copied().fold(1.0, f64::min))
}

fn true_masks(case: &Path) -> Vec<Mask> {
    unpack(io::npz::read(case.join("masks.npz")).expect("reads").need("main").expect("there"), 512)
}

/// Masks grown from the true silhouette of frame 0, with the CPU time they took [ms per frame].
fn grown(video: &Video, truth: &[Mask]) -> (MaskCue, f64) {
    let start = process_cpu_ms();
    let cue = masks_with_prior(video, &truth[0], &MaskOptions::default()).expect("fits");
    (cue, (process_cpu_ms() - start) / video.frames.len() as f64)
}

/// Pictures of where masks are too large (red) and too small (green), into the folder LOOK if the environment names one.
fn draw_errors(name: &str, video: &Video, found: &[Mask], truth: &[Mask]) {
    let Some(folder) = std::env::var_os("LOOK") else { return };
    for t in (0..truth.len()).step_by(12) {
        let mut picture = video.frames[t].clone();
        for (p, (a, b)) in picture.rgb.iter_mut().zip(found[t].coverage.iter().zip(&truth[t].coverage)) {
            match (*a >= 128, *b >= 128) {
                (true, false) => *p = [255, 0, 0],
                (false, true) => *p = [0, 255, 0],
                _ => {}
            }
        }
        let path = Path::new(&folder).join(format!("{name}_{t}.png"));
        animimic_video::write_png(&path, &picture).expect("writes");
    }
}

#[test]
fn masks_agree_with_the_renderers_coverage() {
    let mut failures = Vec::new();
    for case in cases() {
        let video = read(&case.join("video.mp4"), &ReadOptions::default()).expect("reads");
        let truth = true_masks(&case);
        let plain = overlap(masks(&video, &MaskOptions::default()).masks.iter(), &truth);
        let (cue, ms) = grown(&video, &truth);
        let (mean, worst) = overlap(cue.masks.iter(), &truth);
        println!(
            "{:18} IoU {mean:.4}, worst {worst:.4} (without silhouette {:.4}, {:.4}), confidence {:.2}, {ms:.0} CPU-ms a frame",
            name(&case),
            plain.0,
            plain.1,
            cue.confidence[0]
        );
        draw_errors(&name(&case), &video, &cue.masks, &truth);
        // White cloth that fades into the background's grey within its outermost pixels: the outline is not in them.
        let floor = if name(&case) == "cesium_man_walk" { 0.97 } else { 0.985 };
        if mean < floor || mean < plain.0 - 0.002 {
            failures.push(name(&case));
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

#[test]
fn masks_agree_with_a_segmentation_network_on_real_videos() {
    for case in ["fish", "crocodile"] {
        let Some(folder) = shared(&format!("data/real/{case}")) else { return };
        let video = read(&folder.join("input.mp4"), &ReadOptions::default()).expect("reads");
        let archive = io::npz::read(folder.join("masks.npz")).expect("reads");
        let truth = unpack(archive.need("masks").expect("there"), 960);
        let frames: Vec<usize> = archive.need("frames").expect("there").to_f64().iter().map(|&f| f as usize).collect();
        let plain = masks(&video, &MaskOptions::default());
        let (plain, plain_worst) = overlap(frames.iter().map(|&f| &plain.masks[f]), &truth);
        assert_eq!(frames[0], 0);
        let (cue, _) = grown(&video, &truth);
        let (mean, worst) = overlap(frames.iter().map(|&f| &cue.masks[f]), &truth);
        println!("{case}: IoU {mean:.4}, worst {worst:.4} (without silhouette {plain:.4}, {plain_worst:.4})");
        assert!(mean >= 0.95 && mean > plain - 0.002);
    }
}

/// A still picture full of edges and of many colours: blobs, stripes and grain.
fn clutter(x: f32, y: f32) -> [f32; 3] {
    let wave = |a: f32, b: f32, c: f32| (a * x + b * y + c + 2.0 * (0.013 * x - 0.021 * y).sin()).sin();
    let tile = if ((x / 37.0).floor() + (y / 29.0).floor()) as i32 % 2 == 0 { 30.0 } else { -30.0 };
    let grain = {
        let k = ((x.floor() as i64 * 73_856_093) ^ (y.floor() as i64 * 19_349_663)) as u32;
        (k.wrapping_mul(2_654_435_761) >> 24) as f32 / 8.0 - 16.0
    };
    [
        120.0 + tile + 50.0 * wave(0.031, 0.017, 0.0) + 20.0 * wave(0.3, 0.1, 1.0) + grain,
        110.0 - tile + 55.0 * wave(-0.019, 0.027, 2.0) + 15.0 * wave(0.11, -0.35, 0.0) + grain,
        100.0 + 45.0 * wave(0.023, 0.034, 4.0) + 25.0 * wave(0.21, 0.24, 3.0) + grain,
    ]
}

/// The object of a video in front of clutter that moves by `pan` px a frame.
fn over_clutter(video: &Video, truth: &[Mask], pan: [f32; 2]) -> Video {
    let (w, h) = (video.frames[0].width, video.frames[0].height);
    let frames = (0..video.frames.len()).map(|t| {
        let inside = |x: usize, y: usize| f32::from(u8::from(truth[t].inside(x.min(w - 1), y.min(h - 1))));
        let rgb = (0..w * h).map(|i| {
            let (x, y) = (i % w, i / w);
            let around =
                inside(x.saturating_sub(1), y) + inside(x + 1, y) + inside(x, y.saturating_sub(1)) + inside(x, y + 1);
            let alpha = 0.5 * inside(x, y) + 0.125 * around;
            let behind = clutter(x as f32 + pan[0] * t as f32, y as f32 + pan[1] * t as f32);
            let front = video.frames[t].at(x, y);
            std::array::from_fn(|c| (alpha * f32::from(front[c]) + (1.0 - alpha) * behind[c]).clamp(0.0, 255.0) as u8)
        });
        Image { width: w, height: h, rgb: rgb.collect() }
    });
    Video { frames: frames.collect(), ..video.clone() }
}

/// Frames of a case on clutter: the first second, or all of them if the environment has EVERY_FRAME (`.ci/full`).
fn frames() -> usize {
    if std::env::var_os("EVERY_FRAME").is_some() { usize::MAX } else { 24 }
}

#[test]
fn with_the_silhouette_of_frame_0_an_object_is_found_on_clutter_that_stands_or_moves() {
    let mut failures = Vec::new();
    for case in cases() {
        let video = read(&case.join("video.mp4"), &ReadOptions::default()).expect("reads");
        let truth = true_masks(&case);
        let video = Video { frames: video.frames[..frames().min(video.frames.len())].to_vec(), ..video };
        for pan in [[0.0; 2], [2.5, -0.75]] {
            let composite = over_clutter(&video, &truth, pan);
            let (cue, ms) = grown(&composite, &truth);
            let (mean, worst) = overlap(cue.masks.iter(), &truth);
            println!(
                "{:18} moving {pan:?}: IoU {mean:.4}, worst {worst:.4}, confidence {:.2}, {ms:.0} CPU-ms a frame",
                name(&case),
                cue.confidence[1]
            );
            draw_errors(&format!("{}_{}", name(&case), pan[0]), &composite, &cue.masks, &truth);
            // A panning picture's hidden parts are interpolated once more with every frame.
            let floor = if pan == [0.0; 2] { 0.95 } else { 0.94 };
            if mean < floor {
                failures.push(format!("{} {pan:?}", name(&case)));
            }
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}
