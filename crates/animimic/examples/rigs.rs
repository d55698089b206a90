//! Rigs models and says how good the rigs are: `rigs [--sheet FILE.png] [--detail N] MODEL…`.
//!
//! A model beside whose file a `static.glb` with an artist's rig lies is compared with that rig (RigNet's measures). The sheet shows every
//! model with skeleton and weights from the front and the side, and with all joints turned.
// An example ends at the first thing that is wrong.
#![allow(clippy::unwrap_used)]

use animimic::metrics::skeleton_distance::{Bones, distances};
use animimic::rigging::Sheet;
use animimic::scene::{Asset, Image, io};
use animimic_render::overlay;
use animimic_rig::riggers::{self, RigOptions};
use glam::{DAffine3, DQuat};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// How far joints are turned for the bend test.
const LIMB_BEND_RAD: f64 = 0.45;
const TRUNK_BEND_RAD: f64 = 0.12;
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
            rows.push(row(&asset, &label(path)));
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

/// The model's name: that of its folder where the file's says nothing.
fn label(path: &Path) -> String {
    let name =
        |p: Option<&Path>| p.and_then(Path::file_stem).map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name(Some(path));
    if stem.starts_with("static") { name(path.parent()) } else { stem }
}

/// The rig that an artist made for the same model, if it is there.
fn artist(path: &Path) -> Option<Asset> {
    let file = path.with_file_name("static.glb");
    (path.file_name()? == "static_norig.glb" && file.is_file()).then(|| io::read(file).unwrap())
}

/// Front and side at rest, and with all joints but the root turned: what bends badly shows.
fn row(asset: &Asset, name: &str) -> Image {
    let sheet = Sheet::new(asset).unwrap();
    let skeleton = &asset.rig.skeleton;
    let mut locals = skeleton.rest_locals();
    let rest = skeleton.world_from_joint(&locals);
    for (j, local) in locals.iter_mut().enumerate().skip(1) {
        let name = &skeleton.joints[j].name;
        let limb = ["leg", "arm", "wing", "ear", "fin"].iter().any(|w| name.starts_with(w));
        local.rotation = DQuat::from_rotation_x(if limb { LIMB_BEND_RAD } else { TRUNK_BEND_RAD }) * local.rotation;
    }
    let bent = skeleton.world_from_joint(&locals);
    let places = |world: &[DAffine3]| world.iter().map(|w| w.translation).collect::<Vec<_>>();
    let turned = 35.0f64.to_radians();
    let views = [
        sheet.view(0.0, 0.0, &asset.mesh.positions, &places(&rest)),
        sheet.view(0.5 * std::f64::consts::PI, 0.0, &asset.mesh.positions, &places(&rest)),
        sheet.view(turned, 0.3, &asset.rig.skinned(&bent), &places(&bent)),
    ];
    let (w, h) = (views[0].width, views[0].height);
    let mut out = Image::filled(3 * w, h, WHITE);
    views.iter().enumerate().for_each(|(k, view)| overlay::paste(&mut out, view, k * w, 0));
    overlay::text(&mut out, 4, 4, name, 2, [0; 3]);
    out
}

fn stacked(rows: &[Image], columns: usize) -> Image {
    let (w, h) = (rows[0].width, rows[0].height);
    let mut out = Image::filled(w * columns, h * rows.len().div_ceil(columns), WHITE);
    for (k, row) in rows.iter().enumerate() {
        overlay::paste(&mut out, row, k % columns * w, k / columns * h);
    }
    out
}
