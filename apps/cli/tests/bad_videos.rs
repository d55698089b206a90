//! What is thrown at the program in place of a video, line by line, within a second of processor time and a gibibyte.
//!
//! | thrown | test |
//! |---|---|
//! | one frame, empty, no moov atom, truncated | `every_kind_of_bad_video…` |
//! | corrupt payload | `a_corrupt_payload…`; mended below 5 %: `video/tests/bad_input.rs`, `small_damage…` |
//! | variable frame rate, rotation, odd width, 4:4:4, 10-bit, HEVC, VP9 alpha, 4K60 | `video/tests/kinds.rs`, `files.rs`; without ffmpeg: `a_codec_that_is_not_read…` |
//! | mismatched size, black frames, cut in the middle, still image only | `videos_that_do_not_fit…`; cut: `video/tests/bad_input.rs`, `a_cut_ends…` |
#![allow(clippy::unwrap_used)]

mod support;

use std::path::Path;
use std::process::Command;
use support::{Bench, example, limited, text};

/// A GIF of 1×1 pixels with so many frames.
fn gif(frames: usize) -> Vec<u8> {
    let mut bytes = b"GIF89a\x01\0\x01\0\x80\0\0\x40\x40\x40\xff\xff\xff".to_vec();
    for _ in 0..frames {
        bytes.extend(b"\x2c\0\0\0\0\x01\0\x01\0\0\x02\x02\x44\x01\0");
    }
    bytes.push(0x3b);
    bytes
}

/// Where a box of this kind starts in an MP4 file (its size field).
fn box_at(mp4: &[u8], kind: &[u8; 4]) -> usize {
    mp4.windows(4).position(|w| w == kind).unwrap() - 4
}

/// The file with other bytes at a place.
fn patched(mp4: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut out = mp4.to_vec();
    out[at..at + bytes.len()].copy_from_slice(bytes);
    out
}

/// Draws one frame of the example, so high.
fn frame(to: &str, height: &str) {
    let model = example("creature.glb");
    let out = limited(&["render", &model, "-o", to, "--views", "input", "--height", height, "-q"], None);
    assert!(out.status.success(), "{}", text(&out.stderr));
}

/// Both verbs that read a video refuse it.
fn refused(bench: &Bench, name: &str, words: &[&str]) {
    let (model, camera, video) = (example("creature.glb"), example("camera.json"), bench.path(name));
    let words = [&[name], words].concat();
    bench.refuses(&["animate", &model, &video, "--camera", &camera, "-o", &bench.out("folder"), "-q"], &words);
    bench.refuses(&["cues", &video, "-o", &bench.out("cues"), "-q"], &words);
}

#[test]
fn every_kind_of_bad_video_is_told_in_one_sentence_and_nothing_is_written() {
    let bench = Bench::new();
    let sound = std::fs::read(example("creature.mp4")).unwrap();
    let at = |kind| box_at(&sound, kind);
    let samples = at(b"stsz");
    let files: Vec<(&str, Vec<u8>, &str)> = vec![
        ("empty.mp4", vec![], "empty"),
        ("words.mp4", b"certainly no video".to_vec(), "not a video"),
        ("zeros.mp4", vec![0; 4096], "not a video"),
        ("noise.mp4", (0..8192u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect(), "not a video"),
        ("picture.mp4", b"\x89PNG\r\n\x1a\n and then no more".to_vec(), "still picture"),
        ("half.mp4", sound[..sound.len() / 2].to_vec(), ""),
        ("header.mp4", sound[..24].to_vec(), "moov"),
        ("no_samples.mp4", patched(&sound, samples + 16, &[0; 4]), ""),
        ("endless_samples.mp4", patched(&sound, samples + 16, &[0xff; 4]), ""),
        ("box_beyond_the_end.mp4", patched(&sound, at(b"moov"), &[0x7f, 0xff, 0xff, 0xff]), ""),
        ("box_of_no_size.mp4", patched(&sound, at(b"trak"), &[0, 0, 0, 1]), ""),
        ("no_time_scale.mp4", patched(&sound, at(b"mdhd") + 20, &[0; 4]), ""),
        ("other_codec.mp4", patched(&sound, at(b"avc1") + 4, b"xyz1"), ""),
        ("empty.gif", vec![], "empty"),
        ("header.gif", b"GIF89a".to_vec(), "broken animation"),
        ("cut.gif", gif(4)[..30].to_vec(), ""),
        ("one.gif", gif(1), "one frame"),
        ("words.gif", b"certainly no animation".to_vec(), "not a video"),
    ];
    for (name, bytes, words) in &files {
        bench.put(name, bytes);
        refused(&bench, name, &[words]);
    }
    for name in ["empty_folder", "folder_of_words", "folder_of_broken_pictures", "folder_of_one", "folder_of_two_sizes"]
    {
        std::fs::create_dir(bench.path(name)).unwrap();
    }
    bench.put("folder_of_words/readme.txt", b"no pictures");
    for k in 0..3 {
        bench.put(&format!("folder_of_broken_pictures/{k}.png"), b"\x89PNG\r\n\x1a\nbroken");
    }
    frame(&bench.path("folder_of_one/0.png"), "128");
    frame(&bench.path("folder_of_two_sizes/0.png"), "128");
    frame(&bench.path("folder_of_two_sizes/1.png"), "96");
    refused(&bench, "empty_folder", &["no PNG"]);
    refused(&bench, "folder_of_words", &["no PNG"]);
    refused(&bench, "folder_of_broken_pictures", &[]);
    refused(&bench, "folder_of_one", &["one frame"]);
    refused(&bench, "folder_of_two_sizes", &[]);
}

#[test]
fn a_corrupt_payload_is_told_with_the_number_of_frames_that_are_left() {
    let bench = Bench::new();
    let sound = std::fs::read(example("creature.mp4")).unwrap();
    let payload = box_at(&sound, b"mdat") + 8;
    let mut broken = sound.clone();
    let from = payload + (sound.len() - payload) / 3;
    broken[from..from + (sound.len() - payload) / 3].fill(0xff);
    bench.put("corrupt.mp4", &broken);
    refused(&bench, "corrupt.mp4", &["only 18 of 49 frames could be decoded"]);
}

#[test]
fn a_codec_that_is_not_read_is_answered_with_the_command_that_converts_it() {
    let bench = Bench::new();
    let model = example("creature.glb");
    let video = bench.put("strange.webm", &[0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0]);
    // Without a path there is no ffmpeg.
    let run = |arguments: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_animimic")).args(arguments).env("PATH", "").output().unwrap();
        let error = text(&out.stderr);
        println!("{error}");
        assert_eq!((out.status.code(), error.trim_end().lines().count()), (Some(1), 1));
        assert!(error.contains("strange.webm") && error.contains("ffmpeg -i ") && error.contains("converted.mp4"));
    };
    run(&["animate", &model, &video, "-o", &bench.out("folder"), "-q"]);
    run(&["cues", &video, "-o", &bench.out("cues"), "-q"]);
    assert!(bench.results().is_empty());
}

#[test]
fn videos_that_do_not_fit_or_show_nothing_are_named() {
    let bench = Bench::new();
    let (model, camera) = (example("creature.glb"), example("camera.json"));
    // Another shape than the camera's pictures.
    let wide = bench.path("wide.mp4");
    let made =
        limited(&["render", &model, "-o", &wide, "--views", "input,+45", "--height", "64", "--fps", "4", "-q"], None);
    assert!(made.status.success(), "{}", text(&made.stderr));
    let job = ["animate", &model, &wide, "--camera", &camera, "-o", &bench.out("folder"), "-q"];
    bench.refuses(&job, &["camera.json", "another shape", "crop or pad the video"]);
    // A camera that looks past the model.
    let mut away: serde_json::Value = serde_json::from_slice(&std::fs::read(&camera).unwrap()).unwrap();
    let view = &mut away["views"]["main"]["world_to_camera_opencv"];
    view[0][3] = (view[0][3].as_f64().unwrap() + 1.5).into();
    bench.put("away.json", &serde_json::to_vec(&away).unwrap());
    let video = example("creature.mp4");
    let job = [
        "animate",
        &model,
        &video,
        "--camera",
        &bench.path("away.json"),
        "--frames",
        "0..2",
        "-o",
        &bench.out("folder"),
        "-q",
    ];
    bench.refuses(&job, &["creature.mp4", "away.json", "overlaps the object", "--camera auto"]);
    // Nothing but black; a still picture that is called a video.
    let black: Vec<u8> = gif(6).iter().map(|&b| if b == 0x40 { 0 } else { b }).collect();
    bench.put("black.gif", &black);
    refused(&bench, "black.gif", &["every frame is black"]);
    frame(&bench.path("still.png"), "64");
    std::fs::rename(bench.path("still.png"), bench.path("still.mp4")).unwrap();
    refused(&bench, "still.mp4", &["still picture"]);
    // Equal frames are read, with a word about it.
    std::fs::create_dir(bench.path("equal")).unwrap();
    for k in 0..3 {
        frame(&bench.path(&format!("equal/{k}.png")), "64");
    }
    let cues = bench.out("cues");
    bench.does(&["cues", &bench.path("equal"), "-o", &cues], &["nothing moves"]);
    assert!(Path::new(&cues).join("masks.npz").is_file());
}
