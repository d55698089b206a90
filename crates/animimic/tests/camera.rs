//! The camera found from the first frame, against known cameras.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::camera::find;
use animimic::scene::{Asset, Camera, Video, io};
use animimic_fit::camera::CameraFit;
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

fn found_camera(asset: &Asset, video: &Video) -> CameraFit {
    let masks = cues::masks(video, &cues::MaskOptions::default());
    find(asset, &video.frames[0], &masks.masks[0], &masks.background).unwrap()
}

/// Mean and largest distance between the projections of all vertices [px].
fn reprojection_error(asset: &Asset, found: &Camera, truth: &Camera) -> (f64, f64) {
    let truth = truth.resized(found.width, found.height);
    let errors = asset.mesh.positions.iter().map(|p| found.project(*p).distance(truth.project(*p)));
    let (sum, worst) = errors.fold((0.0, 0.0f64), |(sum, worst), e| (sum + e, worst.max(e)));
    (sum / asset.mesh.positions.len() as f64, worst)
}

#[test]
fn the_examples_camera_is_found_from_its_first_frame() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/creature"));
    let asset = io::read(folder.join("creature.glb")).unwrap();
    let truth = io::camera_json::read(folder.join("camera.json")).unwrap();
    let options = animimic_video::ReadOptions { frames: Some(0..2), ..Default::default() };
    let video = animimic_video::read(&folder.join("creature.mp4"), &options).unwrap();
    let found = found_camera(&asset, &video);
    let off = angle_deg(&found.camera, &truth.main);
    println!("IoU {:.4}, view axis off by {off:.2} degrees", found.iou);
    assert!(found.iou > 0.97 && off < 2.0);
}

#[test]
fn known_cameras_are_found_to_the_pixel() {
    let Some(data) = shared() else {
        println!("skipped: no test data beside the repository");
        return;
    };
    let mut cases: Vec<PathBuf> = std::fs::read_dir(data.join("gt")).unwrap().map(|e| e.unwrap().path()).collect();
    cases.sort();
    let mut good = 0;
    for case in &cases {
        let asset = io::read(case.join("static.glb")).unwrap();
        let truth = io::camera_json::read(case.join("camera.json")).unwrap();
        let options = animimic_video::ReadOptions { frames: Some(0..8), ..Default::default() };
        let video = animimic_video::read(&case.join("video.mp4"), &options).unwrap();
        let found = found_camera(&asset, &video);
        let (mean, worst) = reprojection_error(&asset, &found.camera, &truth.main);
        let name = case.file_name().unwrap().to_string_lossy();
        println!(
            "{name:18} IoU {:.4}, vertices off by {mean:.2} px, at most {worst:.2} px, unlikeness {:.3}, runner-up {:?}",
            found.iou, found.unlikeness, found.runner_up
        );
        assert!(mean < 1.0 && worst < 2.0, "{name}");
        good += usize::from(found.iou >= 0.97);
    }
    // One case's mask of frame 0 is worse than that by itself.
    assert!(good + 1 >= cases.len(), "{good} of {} with IoU 0.97", cases.len());
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
        let found = found_camera(&asset, &video);
        let size = (video.frames[0].width as u32, video.frames[0].height as u32);
        let front = animimic::camera::preset("puppeteer:front", asset.mesh.bounds(), size.0, size.1).unwrap();
        let off = angle_deg(&found.camera, &front);
        println!("{name}: IoU {:.4}, view axis off the preset by {off:.2} degrees", found.iou);
        assert!(found.iou > 0.95 && off < 3.0);
    }
}
