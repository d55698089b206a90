//! Rigs models and says how good the rigs are: `rigs [--sheet FILE.png] [--detail N] MODEL…`.
//!
//! A model beside whose file a `static.glb` with an artist's rig lies is compared with that rig (RigNet's measures). The sheet shows every
//! model from the front, the side and above, with the rig in colour and the artist's in grey.
// An example ends at the first thing that is wrong.
#![allow(clippy::unwrap_used)]

use animimic::metrics::skeleton_distance::{Bones, distances};
use animimic::pictures::Studio;
use animimic::scene::{Asset, Camera, Image, io};
use animimic_render::{Light, overlay};
use animimic_rig::riggers::{self, RigOptions};
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::time::Instant;

const SIDE_PX: u32 = 360;
const WHITE: [u8; 3] = [244, 245, 246];

fn main() {
    let mut models: Vec<PathBuf> = Vec::new();
    let (mut sheet, mut detail) = (None, 3);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--sheet" => sheet = words.next(),
            "--detail" => detail = words.next().unwrap().parse().unwrap(),
            _ => models.push(word.into()),
        }
    }
    let options = RigOptions { detail, ..RigOptions::default() };
    let mut rows = Vec::new();
    let mut all: Vec<[f64; 3]> = Vec::new();
    println!(
        "{:28} {:>8} {:>6} {:>7} {:>7} {:>7} {:>7} {:>8}",
        "model", "faces", "joints", "s", "J2J", "J2B", "B2B", "crossing"
    );
    for path in &models {
        let mut asset = io::read(path).unwrap();
        let start = Instant::now();
        let rig = riggers::RIGGERS[0].rig(&asset, &options).unwrap();
        let secs = start.elapsed().as_secs_f64();
        riggers::attach(&mut asset, rig);
        let crossing = crossing(&asset);
        let artist = artist(path);
        let (lo, hi) = asset.mesh.bounds();
        let own = Bones::new(&asset.rig);
        let measures = artist.as_ref().map(|a| distances(&own, &Bones::new(&a.rig), (hi - lo).max_element()));
        let [a, b, c] =
            measures.map_or([String::new(), String::new(), String::new()], |m| m.map(|v| format!("{v:.2}")));
        all.extend(measures);
        println!(
            "{:28} {:8} {:6} {secs:7.2} {a:>7} {b:>7} {c:>7} {crossing:8.4}",
            label(path),
            asset.mesh.triangles.len(),
            asset.rig.skeleton.joints.len()
        );
        if std::env::var_os("NAMES").is_some() {
            let names: Vec<&str> = asset.rig.skeleton.joints.iter().map(|j| j.name.as_str()).collect();
            println!("  {}", names.join(" "));
        }
        if sheet.is_some() {
            rows.push(row(&asset, artist.as_ref(), &label(path)));
        }
    }
    let median = |k: usize| {
        let mut v: Vec<f64> = all.iter().map(|m| m[k]).collect();
        v.sort_by(f64::total_cmp);
        if v.is_empty() { f64::NAN } else { 0.5 * (v[(v.len() - 1) / 2] + v[v.len() / 2]) }
    };
    println!("medians: J2J {:.2}, J2B {:.2}, B2B {:.2}", median(0), median(1), median(2));
    if let Some(file) = sheet {
        animimic_video::write_png(Path::new(&file), &stacked(&rows, 2)).unwrap();
    }
}

/// Share of vertices that joints of both sides move, at least one of them not the first of its limb: weight across a gap.
fn crossing(asset: &Asset) -> f64 {
    let name = |slot: u32| asset.rig.skeleton.joints[asset.rig.skin.slots[slot as usize].joint].name.as_str();
    let of = |slot: u32, side: &str| name(slot).split('_').any(|w| w == side);
    let crossed = asset.rig.skin.influences.iter().filter(|list| {
        let strong = || list.iter().filter(|i| i.weight > 0.02).map(|i| i.slot);
        strong().any(|a| {
            of(a, "L") && strong().any(|b| of(b, "R") && !(name(a).ends_with("_01") && name(b).ends_with("_01")))
        })
    });
    crossed.count() as f64 / asset.rig.skin.influences.len() as f64
}

fn label(path: &Path) -> String {
    let name = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name(path);
    if stem.starts_with("static") || stem == "mesh" {
        path.parent()
            .map(|p| if stem == "mesh" { p.parent().map(name).unwrap_or_default() } else { name(p) })
            .unwrap_or_default()
    } else {
        stem
    }
}

/// The rig that an artist made for the same model, if it is there.
fn artist(path: &Path) -> Option<Asset> {
    let file = path.with_file_name("static.glb");
    (path.file_name()? == "static_norig.glb" && file.is_file()).then(|| io::read(file).unwrap())
}

fn row(asset: &Asset, artist: Option<&Asset>, name: &str) -> Image {
    let mut out = Image::filled(3 * SIDE_PX as usize, SIDE_PX as usize, WHITE);
    let (lo, hi) = asset.mesh.bounds();
    let center = 0.5 * (lo + hi);
    let studio = Studio::with_light(asset, Light::default()).unwrap();
    for (k, (azimuth, elevation)) in [(0.0, 0.0), (90.0f64, 0.0), (0.0, 89.0f64)].into_iter().enumerate() {
        let size = (hi - lo).max_element();
        let camera =
            Camera::orbit(center, 6.0 * size, azimuth.to_radians(), elevation.to_radians(), 0.19, SIDE_PX, SIDE_PX);
        let (mut picture, _) = studio.draw(&camera, &asset.mesh.positions, WHITE);
        let faint = Image::filled(picture.width, picture.height, WHITE);
        picture.rgb.iter_mut().zip(&faint.rgb).for_each(|(p, f)| *p = [0, 1, 2].map(|c| p[c] / 3 + f[c] / 3 * 2));
        artist.iter().for_each(|a| skeleton(&mut picture, &camera, &Bones::new(&a.rig), [120, 120, 120], [90, 90, 90]));
        skeleton(&mut picture, &camera, &Bones::new(&asset.rig), [20, 60, 220], [210, 30, 30]);
        overlay::paste(&mut out, &picture, k * SIDE_PX as usize, 0);
    }
    overlay::text(&mut out, 4, 4, name, 1, [0; 3]);
    out
}

fn skeleton(picture: &mut Image, camera: &Camera, bones: &Bones, line: [u8; 3], dot: [u8; 3]) {
    let at = |p: DVec3| camera.project(p);
    for [a, b] in &bones.bones {
        overlay::line(picture, at(*a), at(*b), 1.5, line, 1.0);
    }
    for p in &bones.joints {
        overlay::disc(picture, at(*p), 2.5, dot, 1.0);
    }
}

fn stacked(rows: &[Image], columns: usize) -> Image {
    let (w, h) = (rows[0].width, rows[0].height);
    let mut out = Image::filled(w * columns, h * rows.len().div_ceil(columns), WHITE);
    for (k, row) in rows.iter().enumerate() {
        overlay::paste(&mut out, row, k % columns * w, k / columns * h);
    }
    out
}
