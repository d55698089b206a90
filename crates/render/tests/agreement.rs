//! Our pictures against three.js's and Puppeteer's, on the shared models. Skips where they are absent.

use animimic_render::{Background, Light, Surface, rasterize_surface, render_image, shade, solve_light};
use animimic_scene::io::{camera_json, npz};
use animimic_scene::{Camera, Image, Mask, io};
use glam::DVec3;
use std::path::{Path, PathBuf};

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

fn cases(folder: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(Path::new(SHARED).join(folder)) else {
        println!("skipped: {SHARED}/{folder} is not there");
        return Vec::new();
    };
    let mut cases: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.is_dir()).collect();
    cases.sort();
    cases
}

fn png(path: &Path) -> (Image, Vec<u8>) {
    let picture = image::open(path).expect("the shared data are complete");
    let alpha =
        if picture.color().has_alpha() { picture.to_rgba8().pixels().map(|p| p.0[3]).collect() } else { Vec::new() };
    let rgb = picture.to_rgb8();
    let image =
        Image { width: rgb.width() as usize, height: rgb.height() as usize, rgb: rgb.pixels().map(|p| p.0).collect() };
    (image, alpha)
}

/// Masks of one view, first frame.
fn first_mask(path: &Path, view: &str) -> Mask {
    let archive = npz::read(path).expect("the shared data are complete");
    let bits = archive.need(view).expect("the shared data are complete");
    let (h, bytes) = (bits.shape[1], bits.shape[2]);
    let values = bits.to_u8().expect("the shared data are complete");
    let coverage = (0..h * bytes * 8).map(|p| if values[p / 8] >> (7 - p % 8) & 1 == 1 { 255 } else { 0 }).collect();
    Mask { width: bytes * 8, height: h, coverage }
}

/// Depth of the first frame at every second pixel; 0 is background.
fn first_depth(path: &Path) -> Vec<f64> {
    let archive = npz::read(path).expect("the shared data are complete");
    let scalar = |name: &str| archive.need(name).expect("the shared data are complete").to_f64()[0];
    let (near, far, levels) = (scalar("z_near"), scalar("z_far"), scalar("levels"));
    let delta = archive.need("delta").expect("the shared data are complete");
    let width = delta.shape[2];
    let values = delta.to_f64();
    let mut depth = Vec::new();
    for row in values[..delta.shape[1] * width].chunks(width) {
        let mut sum = 0u16;
        depth.extend(row.iter().map(|&d| {
            sum = sum.wrapping_add(d as u16);
            if sum == 0 { 0.0 } else { near + (f64::from(sum) - 1.0) / (levels - 1.0) * (far - near) }
        }));
    }
    depth
}

/// PSNR over the bounding box of the mask.
fn psnr(a: &Image, b: &Image, mask: &Mask) -> f64 {
    let inside: Vec<(usize, usize)> = (0..mask.coverage.len())
        .map(|p| (p % mask.width, p / mask.width))
        .filter(|&(x, y)| mask.inside(x, y))
        .collect();
    let range = |k: fn(&(usize, usize)) -> usize| {
        let v = inside.iter().map(k);
        v.clone().min().expect("the shared data are complete")..=v.max().expect("the shared data are complete")
    };
    let (mut sum, mut n) = (0.0, 0.0);
    for y in range(|p| p.1) {
        for x in range(|p| p.0) {
            for c in 0..3 {
                sum += (f64::from(a.at(x, y)[c]) - f64::from(b.at(x, y)[c])).powi(2);
                n += 1.0;
            }
        }
    }
    10.0 * (255.0 * 255.0 / (sum / n)).log10()
}

fn save(name: &str, image: &Image) {
    if let Ok(folder) = std::env::var("ANIMIMIC_TEST_PICTURES") {
        let bytes: Vec<u8> = image.rgb.iter().flatten().copied().collect();
        let (w, h) = (image.width as u32, image.height as u32);
        image::save_buffer(Path::new(&folder).join(name), &bytes, w, h, image::ColorType::Rgb8)
            .expect("the shared data are complete");
    }
}

#[test]
fn colour_silhouette_and_depth_agree_with_three_js() {
    let mut failures = Vec::new();
    for case in cases("gt") {
        let name = case.file_name().expect("the shared data are complete").to_string_lossy().into_owned();
        let asset = io::read(case.join("static.glb")).expect("the shared data are complete");
        let camera = camera_json::read(case.join("camera.json")).expect("the shared data are complete").main;
        let (reference, _) = png(&case.join("frame0.png"));
        let mask = first_mask(&case.join("masks.npz"), "main");
        let surface = Surface::new(&asset.mesh, &asset.looks).expect("the shared data are complete");
        let positions = &asset.mesh.positions;
        let raster = rasterize_surface(&camera, &surface, positions, true);
        let light = solve_light(&camera, &surface, positions, &raster, &reference, Some(&mask))
            .expect("the shared data are complete");
        let (image, coverage) = render_image(&camera, &surface, positions, &light, Background::Color([217; 3]), 4);
        save(&format!("{name}.png"), &image);
        let iou = coverage.iou(&mask);
        let db = psnr(&image, &reference, &mask);
        let dz = median_depth_error(&first_depth(&case.join("depth.npz")), &raster, &mask) / asset.mesh.diagonal();
        println!("{name}: PSNR {db:.2} dB, IoU {iou:.4}, median |dz| {dz:.1e} of the diagonal");
        if db < 30.0 || iou < 0.99 || dz > 1e-3 {
            failures.push(name);
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

/// Median |Δz| over pixels more than 2 px inside both silhouettes.
fn median_depth_error(truth: &[f64], raster: &animimic_render::Raster, mask: &Mask) -> f64 {
    let (w, h) = (raster.width, raster.height);
    let mut errors = Vec::new();
    for y in (4..h - 4).step_by(2) {
        for x in (4..w - 4).step_by(2) {
            let inside = |x: usize, y: usize| raster.covered(y * w + x) && mask.inside(x, y);
            let deep = (y - 3..=y + 3).all(|y| (x - 3..=x + 3).all(|x| inside(x, y)));
            let z = truth[y / 2 * (w / 2) + x / 2];
            if deep && z > 0.0 {
                errors.push((raster.depth(y * w + x).expect("the shared data are complete") - z).abs());
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn silhouettes_of_the_preset_camera_agree_with_puppeteers_first_frames() {
    let mut failures = Vec::new();
    for case in cases("real") {
        let asset = io::read(case.join("objs/mesh.obj")).expect("the shared data are complete");
        let (lo, hi) = asset.mesh.bounds();
        let scale = 1.0 / (hi - lo).max_element();
        let positions: Vec<DVec3> = asset.mesh.positions.iter().map(|&p| (p - 0.5 * (lo + hi)) * scale).collect();
        let surface = Surface::new(&asset.mesh, &asset.looks).expect("the shared data are complete");
        for (view, azimuth) in [("front", 0.0), ("right", 90.0), ("back", 180.0), ("left", 270.0)] {
            let path = case.join("first_frames").join(format!("render_{view}.png"));
            if !path.exists() {
                println!("skipped: {} is not there", path.display());
                continue;
            }
            let (reference, alpha) = png(&path);
            let size = reference.width as u32;
            let camera = Camera::orbit(DVec3::ZERO, 2.0, f64::to_radians(azimuth), 0.0, 0.691_111_2, size, size);
            let raster = rasterize_surface(&camera, &surface, &positions, true);
            let far_from_white = |p: &[u8; 3]| if p.iter().all(|&c| c > 250) { 0 } else { 255 };
            let coverage =
                if alpha.is_empty() { reference.rgb.iter().map(far_from_white).collect() } else { alpha.clone() };
            let mask = Mask { width: reference.width, height: reference.height, coverage };
            let rgb = shade(&camera, &surface, &positions, &raster, &Light::default(), [1.0; 3], true);
            let bytes = rgb.iter().map(|p| p.map(|c| (255.0 * c) as u8)).collect();
            let name =
                format!("{}_{view}.png", case.file_name().expect("the shared data are complete").to_string_lossy());
            save(&name, &Image { width: mask.width, height: mask.height, rgb: bytes });
            let iou = raster.mask().iou(&mask);
            println!("{name}: IoU {iou:.4}");
            if iou < 0.995 {
                failures.push(name);
            }
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}
