//! Reading and writing real files, against ffmpeg where it is present.
mod support;

use animimic_video::{ReadOptions, read, write_gif, write_mp4, write_png};
use std::path::{Path, PathBuf};
use support::*;

fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

#[test]
fn what_we_write_we_read_back_with_its_rate_size_and_looks() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("disc.mp4");
    for (w, h, fps) in [(96, 64, 24.0), (97, 65, 30.0), (64, 96, 16.0)] {
        let frames = disc(w, h, 30);
        write_mp4(&path, &mut frames.iter().cloned(), fps).expect("writes");
        let first = std::fs::read(&path).expect("there");
        write_mp4(&path, &mut frames.iter().cloned(), fps).expect("writes");
        assert_eq!(first, std::fs::read(&path).expect("there"), "same frames, same bytes");
        let video = read(&path, &ReadOptions::default()).expect("reads");
        assert_eq!((video.frames.len(), video.fps), (30, fps), "{:?}", video.warnings);
        assert_eq!(video.frames[0].width, w.next_multiple_of(2));
        let even = w % 2 == 0;
        for t in [0, 13, 29] {
            let quality = if even { psnr(&bytes_of(&frames[t]), &bytes_of(&video.frames[t])) } else { 99.0 };
            println!("{w}×{h} frame {t}: {quality:.1} dB");
            assert!(quality > 34.0);
        }
    }
}

#[test]
fn ffmpeg_decodes_what_we_write_to_the_same_pictures() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("disc.mp4");
    write_mp4(&path, &mut disc(160, 120, 50).into_iter(), 24.0).expect("writes");
    let raw = ffmpeg(&["-i", text(&path), "-f", "rawvideo", "-pix_fmt", "yuv420p", "pipe:1"]);
    assert_eq!(raw.len(), 50 * 160 * 120 * 3 / 2, "ffmpeg sees every frame");
    let ours = yuv_by_us(&path);
    assert_eq!(ours.len(), raw.len());
    assert!(ours == raw, "bit-exact");
    let probe = std::process::Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-select_streams",
            "v",
            "-show_entries",
            "stream=color_space,color_range,nb_frames,avg_frame_rate",
            "-of",
            "csv=p=0",
        ])
        .arg(&path)
        .output()
        .expect("ffprobe runs");
    let said = String::from_utf8_lossy(&probe.stdout).trim().to_string();
    println!("{said}");
    assert_eq!(said, "tv,bt709,24/1,50");
}

/// All displayed frames as raw 4:2:0, decoded by us in display order.
fn yuv_by_us(path: &Path) -> Vec<u8> {
    animimic_video::source::mp4::raw_frames(path)
        .expect("decodes")
        .into_iter()
        .flat_map(|f| [f.y, f.u, f.v].concat())
        .collect()
}

#[test]
fn every_video_at_hand_decodes_bit_exactly_as_ffmpeg_decodes_it() {
    let Some(data) = shared("data") else { return };
    if !have_ffmpeg() {
        return;
    }
    let mut videos: Vec<PathBuf> = Vec::new();
    for folder in ["gt", "real"] {
        for case in std::fs::read_dir(data.join(folder)).expect("listed").flatten() {
            for name in ["video.mp4", "input.mp4", "novel_p45.mp4", "novel_m45.mp4"] {
                let path = case.path().join(name);
                if path.exists() {
                    videos.push(path);
                }
            }
        }
    }
    videos.sort();
    assert!(videos.len() > 20);
    for path in &videos {
        let theirs =
            ffmpeg(&["-i", text(path), "-f", "rawvideo", "-fps_mode", "passthrough", "-pix_fmt", "yuv420p", "pipe:1"]);
        assert!(yuv_by_us(path) == theirs, "{} differs", path.display());
    }
    println!("{} videos bit-exact", videos.len());
}

#[test]
fn colors_agree_with_ffmpeg_for_a_tagged_and_an_untagged_stream() {
    let Some(data) = shared("data") else { return };
    if !have_ffmpeg() {
        return;
    }
    for name in ["gt/fox_walk/video.mp4", "real/fish/input.mp4"] {
        let path = data.join(name);
        let video = read(&path, &ReadOptions { frames: Some(0..3), ..ReadOptions::default() }).expect("reads");
        let raw = ffmpeg(&[
            "-i",
            text(&path),
            "-frames:v",
            "3",
            "-sws_flags",
            "bicubic+accurate_rnd+full_chroma_int+full_chroma_inp",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "pipe:1",
        ]);
        let ours: Vec<u8> = video.frames.iter().flat_map(bytes_of).collect();
        let quality = psnr(&ours, &raw);
        println!("{name}: {quality:.1} dB");
        assert!(quality > 45.0);
    }
}

#[test]
fn our_encoder_keeps_36_db_on_a_textured_render() {
    let Some(data) = shared("data/gt/fox_walk") else { return };
    let source = read(&data.join("video.mp4"), &ReadOptions::default()).expect("reads");
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("fox.mp4");
    write_mp4(&path, &mut source.frames.iter().cloned(), source.fps).expect("writes");
    let back = read(&path, &ReadOptions::default()).expect("reads");
    let worst =
        source.frames.iter().zip(&back.frames).map(|(a, b)| psnr(&bytes_of(a), &bytes_of(b))).fold(99.0, f64::min);
    println!(
        "worst frame {worst:.1} dB, {} bytes for {} frames",
        std::fs::metadata(&path).expect("there").len(),
        back.frames.len()
    );
    assert!(worst >= 36.0);
}

#[test]
fn the_crocodile_keeps_its_121_frames_in_spite_of_uneven_stamps() {
    let Some(data) = shared("data/real/crocodile/input.mp4") else { return };
    let video = read(&data, &ReadOptions { working_height: Some(256), ..ReadOptions::default() }).expect("reads");
    println!("{} frames at {:.3} fps, {:?}", video.frames.len(), video.fps, video.warnings);
    assert_eq!(video.source_frames, (0..121).collect::<Vec<_>>());
    assert!((video.fps - 24.12).abs() < 0.2);
    assert_eq!((video.frames[0].width, video.frames[0].height, video.native_size), (256, 256, (960, 960)));
}

#[test]
fn folders_gifs_and_alpha_are_read() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let frames = disc(60, 40, 12);
    let gif = folder.path().join("disc.gif");
    write_gif(&gif, &mut frames.iter().cloned(), 20.0).expect("writes");
    let video = read(&gif, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames.len(), video.fps.round()), (12, 20.0));
    assert!(video.alpha.is_empty());
    let pictures = folder.path().join("frames");
    std::fs::create_dir(&pictures).expect("created");
    for (t, frame) in frames.iter().enumerate() {
        let rgba: Vec<u8> = frame.rgb.iter().flat_map(|&[r, g, b]| [r, g, b, if r == 217 { 0 } else { 255 }]).collect();
        image::save_buffer(pictures.join(format!("f{t}.png")), &rgba, 60, 40, image::ExtendedColorType::Rgba8)
            .expect("saved");
    }
    let video = read(&pictures, &ReadOptions::default()).expect("reads");
    assert_eq!(video.frames, frames, "natural order, exact pixels");
    assert_eq!(video.alpha.len(), 12);
    assert_eq!(video.alpha[3].at(20, 20), 255);
    write_png(&pictures.join("f5.png"), &disc_frame(60, 44, 5)).expect("writes");
    let error = read(&pictures, &ReadOptions::default()).expect_err("12 frames, one lost: 8 %");
    println!("{error}");
}

trait At {
    fn at(&self, x: usize, y: usize) -> u8;
}

impl At for animimic_scene::Mask {
    fn at(&self, x: usize, y: usize) -> u8 {
        self.coverage[y * self.width + x]
    }
}

#[test]
fn streams_as_services_write_them_keep_order_rotation_trim_and_rate() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let plain = folder.path().join("plain.mp4");
    let made = folder.path().join("made.mp4");
    write_mp4(&plain, &mut disc(128, 96, 60).into_iter(), 30.0).expect("writes");
    let base = ["-i", text(&plain)];
    let make = |options: &[&str]| ffmpeg(&[&base[..], options, &[text(&made)]].concat());
    // B-frames with pyramid, fragmented.
    make(&["-c:v", "libx264", "-bf", "3", "-b_strategy", "0", "-movflags", "frag_keyframe+empty_moov"]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames.len(), video.fps), (60, 30.0));
    for t in [1, 20, 59] {
        assert!(psnr(&bytes_of(&video.frames[t]), &bytes_of(&disc_frame(128, 96, t))) > 30.0, "frame {t} in its place");
    }
    // 60 fps is halved.
    make(&["-c:v", "libx264", "-r", "60"]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames.len(), video.fps), (60, 30.0));
    // An edit list that starts inside a group of pictures.
    let long = folder.path().join("long.mp4");
    ffmpeg(&["-i", text(&plain), "-c:v", "libx264", "-g", "60", text(&long)]);
    ffmpeg(&["-ss", "0.5", "-i", text(&long), "-c", "copy", text(&made)]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    println!("after the cut: {} frames", video.frames.len());
    assert!(psnr(&bytes_of(&video.frames[0]), &bytes_of(&disc_frame(128, 96, 15))) > 30.0);
    // Rotation in the track header.
    let mut bytes = std::fs::read(&plain).expect("there");
    let matrix = bytes.windows(4).position(|w| w == b"tkhd").expect("a track header") + 4 + 36 + 4;
    let quarter_turn = [0i32, 1 << 16, 0, -(1 << 16), 0, 0];
    bytes[matrix..matrix + 24].copy_from_slice(&quarter_turn.map(i32::to_be_bytes).concat());
    std::fs::write(&made, bytes).expect("written");
    let video = read(&made, &ReadOptions::default()).expect("reads");
    assert_eq!((video.frames[0].width, video.frames[0].height), (96, 128));
    let raw = ffmpeg(&["-i", text(&made), "-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:1"]);
    let quality = psnr(&bytes_of(&video.frames[0]), &raw);
    println!("rotated: {quality:.1} dB");
    assert!(quality > 30.0);
    // Full range.
    make(&["-vf", "scale=out_range=pc", "-c:v", "libx264", "-color_range", "pc"]);
    let video = read(&made, &ReadOptions::default()).expect("reads");
    assert!(video.frames[0].at(2, 2)[0].abs_diff(217) <= 2, "{:?}", video.frames[0].at(2, 2));
}

#[test]
fn what_the_embedded_decoder_lacks_goes_through_ffmpeg() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let plain = folder.path().join("plain.mp4");
    write_mp4(&plain, &mut disc(128, 96, 20).into_iter(), 24.0).expect("writes");
    for (name, options) in [
        ("hevc.mp4", &["-c:v", "libx265", "-x265-params", "log-level=none"][..]),
        ("vp9.webm", &["-c:v", "libvpx-vp9"][..]),
        ("high444.mp4", &["-c:v", "libx264", "-pix_fmt", "yuv444p"][..]),
        ("tenbit.mp4", &["-c:v", "libx264", "-pix_fmt", "yuv420p10le"][..]),
        ("interlaced.mp4", &["-c:v", "libx264", "-flags", "+ildct+ilme"][..]),
    ] {
        let made = folder.path().join(name);
        ffmpeg(&[&["-i", text(&plain)][..], options, &[text(&made)]].concat());
        let video = read(&made, &ReadOptions::default()).unwrap_or_else(|e| panic!("{name}: {e}"));
        println!("{name}: {:?}", video.warnings);
        assert_eq!(video.frames.len(), 20);
        assert!(psnr(&bytes_of(&video.frames[9]), &bytes_of(&disc_frame(128, 96, 9))) > 28.0, "{name}");
    }
}
