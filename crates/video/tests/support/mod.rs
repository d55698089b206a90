//! Small moving pictures made by code, and the places of outside data.
#![allow(dead_code, missing_docs)]

use animimic_scene::{Image, Mask, io};
use std::path::{Path, PathBuf};

/// A textured disc that moves over a plain background.
pub fn disc_frame(width: usize, height: usize, t: usize) -> Image {
    let mut image = Image::filled(width, height, [217; 3]);
    let (cx, cy) = (width as f32 * 0.4 + 2.0 * t as f32, height as f32 * 0.5 + t as f32);
    let radius = 0.25 * height as f32;
    for y in 0..height {
        for x in 0..width {
            let (dx, dy) = (x as f32 + 0.5 - cx, y as f32 + 0.5 - cy);
            if dx.hypot(dy) < radius {
                let wave = 40.0 * (0.35 * dx).sin() * (0.3 * dy).cos();
                image.rgb[y * width + x] = [150.0 + wave, 90.0 + wave, 60.0 - wave].map(|v: f32| v as u8);
            }
        }
    }
    image
}

pub fn disc(width: usize, height: usize, frames: usize) -> Vec<Image> {
    (0..frames).map(|t| disc_frame(width, height, t)).collect()
}

/// The folder of shared test data; `None` (with the reason printed) where it is absent.
pub fn shared(what: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(what);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

pub fn have_ffmpeg() -> bool {
    let have = std::process::Command::new("ffmpeg").arg("-version").output().is_ok_and(|o| o.status.success());
    if !have {
        println!("skipped: no ffmpeg on PATH");
    }
    have
}

/// Runs ffmpeg; panics with its message when it fails.
pub fn ffmpeg(arguments: &[&str]) -> Vec<u8> {
    let run = std::process::Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y"])
        .args(arguments)
        .output()
        .expect("starts");
    assert!(run.status.success(), "ffmpeg {arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
    run.stdout
}

pub fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(b).map(|(&x, &y)| (f64::from(x) - f64::from(y)).powi(2)).sum();
    10.0 * (255.0f64.powi(2) * a.len() as f64 / sum.max(1e-9)).log10()
}

pub fn bytes_of(image: &Image) -> Vec<u8> {
    image.rgb.iter().flatten().copied().collect()
}

/// The cases of known motion; only that of the environment's CASE, if given.
pub fn cases() -> Vec<PathBuf> {
    let Some(folder) = shared("data/gt") else { return Vec::new() };
    let only = std::env::var("CASE").ok();
    let mut list: Vec<PathBuf> = std::fs::read_dir(folder).expect("listed").flatten().map(|e| e.path()).collect();
    list.retain(|p| p.join("gt.npz").exists() && only.as_ref().is_none_or(|o| p.ends_with(o)));
    list.sort();
    list
}

pub fn name(path: &Path) -> String {
    path.file_name().expect("named").to_string_lossy().into_owned()
}

/// Bit-packed masks [frame].
pub fn unpack(array: &io::npz::Array, width: usize) -> Vec<Mask> {
    let bits = array.to_u8().expect("bytes");
    let (n, h, stride) = (array.shape[0], array.shape[1], array.shape[2]);
    let bit = |t: usize, x: usize, y: usize| bits[(t * h + y) * stride + x / 8] >> (7 - x % 8) & 1;
    (0..n)
        .map(|t| {
            let coverage = (0..width * h).map(|i| 255 * bit(t, i % width, i / width)).collect();
            Mask { width, height: h, coverage }
        })
        .collect()
}

/// CPU time of this thread so far [ms]; 0 where the system does not tell.
pub fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) / 1e6
}

/// CPU time of all threads so far [ms], in steps of 10; 0 where the system does not tell.
pub fn process_cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Fields 14 and 15 of the line; the second, the program's name, may hold blanks.
    let fields: Vec<f64> =
        text.rsplit(')').next().unwrap_or("").split_whitespace().map(|f| f.parse().unwrap_or(0.0)).collect();
    10.0 * fields.get(11..13).map_or(0.0, |f| f[0] + f[1])
}
