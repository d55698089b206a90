//! Finds the camera of frame 0 of test cases and compares it with the true one: `camera_truth [CASE_DIR]...`
//!
//! A case is a folder with `static.glb`, `video.mp4` and `camera.json`.

use animimic::camera::find;
use animimic_scene::io;
use animimic_video::cues;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("{:16} {:>6} {:>9} {:>9} {:>8} {:>7}", "case", "IoU", "mean px", "max px", "verdict", "secs");
    for case in std::env::args().skip(1) {
        let case = Path::new(&case);
        let asset = io::read(&case.join("static.glb"))?;
        let options =
            animimic_video::ReadOptions { working_height: Some(512), frames: Some(0..8), ..Default::default() };
        let video = animimic_video::read(&case.join("video.mp4"), &options)?;
        let masks = cues::masks(&video, &cues::MaskOptions::default());
        let truth = io::camera_json::read(&case.join("camera.json"))?.main;
        let truth = truth.resized(video.frames[0].width as u32, video.frames[0].height as u32);
        let start = Instant::now();
        let name = case.file_name().unwrap_or_default().to_string_lossy();
        let found = match find(&asset, &video.frames[0], &masks.masks[0], &masks.background) {
            Ok(found) => found,
            Err(e) => {
                println!("{name:16} {e}");
                continue;
            }
        };
        let secs = start.elapsed().as_secs_f64();
        let errors: Vec<f64> =
            asset.mesh.positions.iter().map(|p| found.camera.project(*p).distance(truth.project(*p))).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let worst = errors.iter().copied().fold(0.0, f64::max);
        let runner = found.runner_up.map_or("-".to_owned(), |r| format!("{r:.3}"));
        println!(
            "{name:16} {:6.3} {mean:9.2} {worst:9.2} {:8.3} {secs:7.1}  runner-up {runner}",
            found.iou, found.unlikeness
        );
    }
    Ok(())
}
