//! The kinds of videos that people have: each comes out right, or with the exact command that converts it.
//!
//! Variable frame rate, odd width, VP9 with alpha, 4K at 60 here; rotation, 4:4:4, 10 bits, HEVC in `files.rs`. Needs ffmpeg to make them.
mod support;

use animimic_video::{ReadOptions, VideoError, read, write_gif, write_mp4};
use std::path::Path;
use support::*;

fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

#[test]
fn a_variable_frame_rate_is_resampled_by_its_stamps() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let (plain, made) = (folder.path().join("plain.mp4"), folder.path().join("made.mp4"));
    write_mp4(&plain, &mut disc(128, 96, 40).into_iter(), 24.0).expect("writes");
    // From frame 20 on, every frame stays three times as long.
    let stamps = "setpts=(if(lt(N\\,20)\\,N\\,20+3*(N-20)))/24/TB";
    ffmpeg(&["-i", text(&plain), "-vf", stamps, "-fps_mode", "vfr", "-c:v", "libx264", text(&made)]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    println!("{} frames at {}", video.frames.len(), video.fps);
    // A player shows 20 frames, then each of the others for three ticks; the last has no successor and stays one typical tick.
    let shown: Vec<usize> = (0..video.frames.len()).map(|k| if k < 20 { k } else { 20 + (k - 20) / 3 }).collect();
    let seconds = video.frames.len() as f64 / video.fps;
    assert!((seconds - (20.0 + 58.0) / 24.0).abs() < 0.13, "{seconds} s");
    for (k, &t) in shown.iter().enumerate().filter(|(_, t)| **t < 40) {
        let here = psnr(&bytes_of(&video.frames[k]), &bytes_of(&disc_frame(128, 96, t)));
        assert!(here > 30.0, "frame {k} should show {t}: {here:.1} dB");
    }
}

#[test]
fn an_odd_width_loses_one_column_at_most_and_nothing_moves() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let gif = folder.path().join("odd.gif");
    write_gif(&gif, &mut disc(97, 65, 8).into_iter(), 20.0).expect("writes");
    let video = read(&gif, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames[0].width, video.frames[0].height), (97, 65));
    if !have_ffmpeg() {
        return;
    }
    let made = folder.path().join("odd.webm");
    ffmpeg(&["-i", text(&gif), "-c:v", "libvpx-vp9", "-crf", "10", text(&made)]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames[0].width, video.frames[0].height), (96, 64));
    let whole = disc_frame(97, 65, 4);
    let cut: Vec<u8> = (0..64 * 96).flat_map(|i| whole.at(i % 96, i / 96)).collect();
    let quality = psnr(&bytes_of(&video.frames[4]), &cut);
    println!("{quality:.1} dB");
    assert!(quality > 28.0);
}

#[test]
fn the_alpha_of_a_vp9_video_becomes_its_masks() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let frames = folder.path().join("frames");
    std::fs::create_dir(&frames).expect("created");
    for (t, frame) in disc(96, 64, 10).iter().enumerate() {
        let rgba: Vec<u8> = frame.rgb.iter().flat_map(|&[r, g, b]| [r, g, b, if r == 217 { 0 } else { 255 }]).collect();
        let file = frames.join(format!("{t:02}.png"));
        image::save_buffer(file, &rgba, 96, 64, image::ExtendedColorType::Rgba8).expect("saved");
    }
    let made = folder.path().join("alpha.webm");
    let pattern = frames.join("%02d.png");
    ffmpeg(&[
        "-framerate",
        "24",
        "-i",
        text(&pattern),
        "-c:v",
        "libvpx-vp9",
        "-crf",
        "10",
        "-pix_fmt",
        "yuva420p",
        text(&made),
    ]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    println!("{:?}", video.warnings);
    assert_eq!((video.frames.len(), video.alpha.len()), (10, 10));
    for (t, mask) in video.alpha.iter().enumerate() {
        let object = disc_frame(96, 64, t).rgb.iter().map(|p| if p[0] == 217 { 0 } else { 255 }).collect();
        let iou = mask.iou(&animimic_scene::Mask { width: 96, height: 64, coverage: object });
        assert!(iou > 0.97, "frame {t}: IoU {iou:.3}");
    }
}

#[test]
fn four_k_at_60_is_halved_in_rate_and_shrunk_while_it_is_read() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let made = folder.path().join("large.mp4");
    let source = ["-f", "lavfi", "-i", "testsrc2=s=3840x2160:r=60", "-frames:v", "16"];
    ffmpeg(&[&source[..], &["-c:v", "libx264", "-preset", "ultrafast", text(&made)]].concat());
    let options = ReadOptions { working_height: Some(216), ..ReadOptions::default() };
    let video = read(&made, &options).expect("reads");
    assert_eq!((video.fps, video.frames.len(), video.native_size), (30.0, 8, (3840, 2160)));
    assert_eq!((video.frames[0].width, video.frames[0].height), (384, 216));
    let raw = ffmpeg(&[
        "-i",
        text(&made),
        "-vf",
        "select=eq(n\\,6),scale=384:216:flags=area",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "pipe:1",
    ]);
    let quality = psnr(&bytes_of(&video.frames[3]), &raw);
    println!("{quality:.1} dB");
    assert!(quality > 28.0);
}

#[test]
fn without_ffmpeg_the_message_holds_a_command_that_converts_the_file() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let made = folder.path().join("a name with blanks.webm");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc2=s=64x48:r=24", "-frames:v", "6", "-c:v", "libvpx-vp9", text(&made)]);
    let error = animimic_video::source::ffmpeg::unsupported(&made, "VP9 is not read directly".into());
    let VideoError::Unsupported { command, .. } = &error else { panic!("{error}") };
    assert!(error.to_string().contains(command.as_str()));
    // The command, run as a person would, makes what is read directly.
    let mut shell = std::process::Command::new("sh");
    let run = shell.args(["-c", command]).current_dir(folder.path()).output().expect("a shell");
    assert!(run.status.success(), "{command}: {}", String::from_utf8_lossy(&run.stderr));
    let video = read(&folder.path().join("converted.mp4"), &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames.len(), video.warnings.len()), (6, 0), "{:?}", video.warnings);
}
