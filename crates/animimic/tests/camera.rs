//! The camera found from the first frame, against known cameras.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::scene::{Camera, Mask, io};
use animimic_fit::camera::find_camera;
use animimic_video::cues;
use std::path::{Path, PathBuf};

fn shared() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    folder.is_dir().then(|| folder.to_owned())
}

/// Angle between the view axes of two cameras [degrees].
fn angle_deg(a: &Camera, b: &Camera) -> f64 {
    let axis = |c: &Camera| c.view_from_world.matrix3.row(2);
    axis(a).dot(axis(b)).clamp(-1.0, 1.0).acos().to_degrees()
}

fn first_mask(video: &animimic::scene::Video) -> Mask {
    cues::masks(video, &cues::MaskOptions::default()).masks.swap_remove(0)
}

#[test]
fn the_examples_camera_is_found_from_its_first_frame() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/creature"));
    let asset = io::read(folder.join("creature.glb")).unwrap();
    let truth = io::camera_json::read(folder.join("camera.json")).unwrap();
    let options = animimic_video::ReadOptions { frames: Some(0..2), ..Default::default() };
    let video = animimic_video::read(&folder.join("creature.mp4"), &options).unwrap();
    let found = find_camera(&asset, &video.frames[0], &first_mask(&video)).unwrap();
    let off = angle_deg(&found.camera, &truth.main);
    println!("IoU {:.4}, view axis off by {off:.2} degrees", found.iou);
    assert!(found.iou > 0.97 && off < 2.0);
}

#[test]
fn known_cameras_are_found_within_two_degrees_and_all_outlines_fit() {
    let Some(data) = shared() else {
        println!("skipped: no test data beside the repository");
        return;
    };
    let mut cases: Vec<PathBuf> = std::fs::read_dir(data.join("gt")).unwrap().map(|e| e.unwrap().path()).collect();
    cases.sort();
    for case in &cases {
        let asset = io::read(case.join("static.glb")).unwrap();
        let truth = io::camera_json::read(case.join("camera.json")).unwrap();
        let options = animimic_video::ReadOptions { frames: Some(0..2), ..Default::default() };
        let video = animimic_video::read(&case.join("video.mp4"), &options).unwrap();
        let found = find_camera(&asset, &video.frames[0], &first_mask(&video)).unwrap();
        let off = angle_deg(&found.camera, &truth.main);
        println!(
            "{:18} IoU {:.4}, view axis off by {off:6.2} degrees",
            case.file_name().unwrap().to_string_lossy(),
            found.iou
        );
        assert!(off < 2.0 && found.iou > 0.92);
    }
}

#[test]
fn real_videos_first_frames_are_seen_from_the_front() {
    let Some(data) = shared() else {
        println!("skipped: no test data beside the repository");
        return;
    };
    for name in ["fish", "crocodile"] {
        let folder = data.join("real").join(name);
        let asset = io::read(&folder).unwrap();
        let options =
            animimic_video::ReadOptions { frames: Some(0..2), working_height: Some(512), ..Default::default() };
        let video = animimic_video::read(&folder.join("input.mp4"), &options).unwrap();
        let found = find_camera(&asset, &video.frames[0], &first_mask(&video)).unwrap();
        let size = (video.frames[0].width as u32, video.frames[0].height as u32);
        let front = animimic::camera::preset("puppeteer:front", asset.mesh.bounds(), size.0, size.1).unwrap();
        let off = angle_deg(&found.camera, &front);
        println!("{name}: IoU {:.4}, view axis off the preset by {off:.2} degrees", found.iou);
        assert!(found.iou > 0.95 && off < 3.0);
    }
}
