//! Small moving pictures made by code, and the places of outside data.
#![allow(dead_code, missing_docs)]

use animimic_scene::Image;
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
