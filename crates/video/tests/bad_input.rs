//! Every broken video is answered by one sentence: no panic, no hang, nothing half done.
mod support;

use animimic_video::{ReadOptions, VideoError, read, write_mp4, write_png};
use std::path::Path;
use std::time::Instant;
use support::*;

/// Reads; gives the error's text, which must be a single line that names the file.
fn refusal(path: &Path) -> String {
    let start = Instant::now();
    let error = read(path, &ReadOptions::default()).expect_err("must be refused").to_string();
    println!("{error}");
    assert!(!error.contains('\n') && error.contains(&*path.file_name().expect("named").to_string_lossy()));
    assert!(start.elapsed().as_secs_f64() < 5.0, "took {:?} on a loaded machine", start.elapsed());
    error
}

fn made(folder: &Path, frames: usize) -> Vec<u8> {
    let path = folder.join("sound.mp4");
    write_mp4(&path, &mut disc(128, 96, frames).into_iter(), 24.0).expect("writes");
    std::fs::read(path).expect("there")
}

#[test]
fn things_that_are_no_videos_are_named_for_what_they_are() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("input.mp4");
    let cases: [(&[u8], &str); 6] = [
        (b"", "empty"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "Git-LFS"),
        (b"<!DOCTYPE html><html></html>", "web page"),
        (b"just some words, certainly no video", "not a video"),
        (b"\0\0\0\x18ftypisom\0\0\x02\0isomavc1", "moov"),
        (b"GIF89a", "broken animation"),
    ];
    for (bytes, word) in cases {
        std::fs::write(&file, bytes).expect("written");
        assert!(refusal(&file).contains(word));
    }
    let still = folder.path().join("still.png");
    write_png(&still, &disc_frame(64, 48, 0)).expect("writes");
    assert!(refusal(&still).contains("still picture"));
    assert!(refusal(&folder.path().join("absent.mp4")).contains("No such file"));
    let empty = folder.path().join("empty_folder");
    std::fs::create_dir(&empty).expect("created");
    assert!(refusal(&empty).contains("no PNG"));
}

#[test]
fn one_frame_black_frames_and_truncation_are_refused_with_the_reason() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("input.mp4");
    write_mp4(&file, &mut disc(128, 96, 1).into_iter(), 24.0).expect("writes");
    assert!(refusal(&file).contains("one frame"));
    let black = vec![animimic_scene::Image::filled(128, 96, [0; 3]); 10];
    write_mp4(&file, &mut black.into_iter(), 24.0).expect("writes");
    assert!(refusal(&file).contains("black"));
    let sound = made(folder.path(), 60);
    for share in [0.2, 0.5, 0.8] {
        std::fs::write(&file, &sound[..(share * sound.len() as f64) as usize]).expect("written");
        let said = refusal(&file);
        assert!(said.contains("of 60 frames") || said.contains("larger size than it"), "{said}");
    }
}

#[test]
fn small_damage_is_mended_with_a_warning_and_large_damage_is_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("input.mp4");
    let sound = made(folder.path(), 60);
    // The last frame's data is cut off: 1 of 60.
    std::fs::write(&file, &sound[..sound.len() - 3]).expect("written");
    let video = read(&file, &ReadOptions::default()).expect("one lost frame is mended");
    println!("{:?}", video.warnings);
    assert_eq!(video.frames.len(), 60);
    assert!(video.warnings.iter().any(|w| w.contains("59 of 60")));
    // NAL lengths in the middle are overwritten.
    let mut broken = sound.clone();
    let middle = broken.len() / 2;
    broken[middle..middle + 3000].fill(0xff);
    std::fs::write(&file, &broken).expect("written");
    assert!(refusal(&file).contains("of 60 frames"));
}

#[test]
fn a_cut_ends_the_video_and_a_fast_object_does_not() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("input.mp4");
    let mut frames = disc(128, 96, 20);
    let other = |t: usize| {
        let mut image = disc_frame(128, 96, t);
        image.rgb.iter_mut().for_each(|p| *p = [40, 255 - p[0], p[1] / 2]);
        image
    };
    frames.extend((0..15).map(other));
    write_mp4(&file, &mut frames.into_iter(), 24.0).expect("writes");
    let video = read(&file, &ReadOptions::default()).expect("reads");
    println!("{:?}", video.warnings);
    assert_eq!((video.frames.len(), video.source_frames.len()), (20, 20));
    assert!(video.warnings[0].contains("scene changes"));
    let jumps = (0..20).map(|t| disc_frame(128, 96, if t % 2 == 0 { 0 } else { 30 }));
    write_mp4(&file, &mut jumps.into_iter(), 24.0).expect("writes");
    assert_eq!(read(&file, &ReadOptions::default()).expect("reads").frames.len(), 20);
    let stills = std::iter::repeat_n(disc_frame(128, 96, 0), 10);
    let file = folder.path().join("still.gif");
    animimic_video::write_gif(&file, &mut stills.into_iter(), 24.0).expect("writes");
    assert!(read(&file, &ReadOptions::default()).expect("reads").warnings.iter().any(|w| w.contains("nothing moves")));
}

#[test]
fn senseless_requests_are_the_callers_fault() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("out.mp4");
    let mixed = vec![disc_frame(64, 48, 0), disc_frame(64, 50, 1)];
    for error in [
        write_mp4(&file, &mut std::iter::empty(), 24.0),
        write_mp4(&file, &mut mixed.into_iter(), 24.0),
        write_mp4(&file, &mut disc(64, 48, 3).into_iter(), f64::NAN),
    ] {
        assert!(matches!(error, Err(VideoError::Caller(_))), "{error:?}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0, "nothing was left behind");
    write_mp4(&file, &mut disc(64, 48, 5).into_iter(), 24.0).expect("writes");
    let range = ReadOptions { frames: Some(9..12), ..ReadOptions::default() };
    assert!(matches!(read(&file, &range), Err(VideoError::Caller(_))));
}
