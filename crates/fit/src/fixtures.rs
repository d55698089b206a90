//! A small video made by code, for tests.

use crate::stage1::sight::{Sight, Studio};
use crate::stage1::solve::Stage;
use crate::stage1::subject::Subject;
use crate::stage1::{Input, Settings, first_light, stage};
use animimic_render::Light;
use animimic_rig::FramePose;
use animimic_rig::fixtures::creature;
use animimic_scene::{Asset, Camera, DepthKind, DepthMap, Image, Look, Mask, Part, Tracks};
use glam::DVec3;

/// Frames of the video.
pub const FRAMES: usize = 4;
const SIZE: usize = 128;

/// A coloured, rigged creature.
pub fn asset() -> Asset {
    let (rig, mut mesh) = creature();
    mesh.parts =
        vec![Part { vertices: 0..mesh.positions.len(), triangles: 0..mesh.triangles.len(), ..Part::default() }];
    mesh.colors = mesh.positions.iter().map(|p| [0.3 + 0.2 * p.x as f32, 0.4, 0.6 - 0.1 * p.z as f32]).collect();
    Asset { mesh, rig, looks: vec![Look { double_sided: true, ..Look::default() }], ..Asset::default() }
}

/// A camera that sees it from the side, `size` pixels wide and high.
pub fn camera(size: u32) -> Camera {
    Camera::orbit(DVec3::new(1.0, 0.6, 0.9), 6.5, 0.6, 0.2, 0.7, size, size)
}

/// A motion from rest in which every joint turns, ever further.
pub fn truth(subject: &Subject, frames: usize) -> Vec<FramePose> {
    let tree = &subject.tree.kinematics;
    let step =
        |t: usize| -> Vec<f64> { (0..tree.dimension).map(|i| 0.03 * t as f64 * (1.7 * i as f64).sin()).collect() };
    (0..frames).map(|t| tree.retract(&tree.rest(), &step(t))).collect()
}

/// Calls `work` with a small video of the creature in motion, with exact masks, tracks and depth, and its true poses.
pub fn with_video(work: impl FnOnce(&Input, &Subject, &[FramePose])) {
    with_video_of(|subject| truth(subject, FRAMES), work);
}

/// The same for any motion.
fn with_video_of(motion: impl FnOnce(&Subject) -> Vec<FramePose>, work: impl FnOnce(&Input, &Subject, &[FramePose])) {
    let asset = asset();
    let subject = Subject::new(&asset).expect("can be drawn");
    let camera = camera(SIZE as u32);
    let light = Light::ambient(1.0);
    let studio = Studio { camera: &camera, light: &light };
    let background = Image::filled(SIZE, SIZE, [240; 3]);
    let truth = motion(&subject);
    let sights: Vec<Sight> = truth.iter().map(|p| Sight::draw(&subject, &studio, &background, p)).collect();
    let frames: Vec<Image> = sights.iter().map(|s| s.image.clone()).collect();
    let masks: Vec<Mask> = sights.iter().map(|s| s.raster.mask()).collect();
    let depth: Vec<DepthMap> = sights
        .iter()
        .map(|s| DepthMap {
            width: SIZE,
            height: SIZE,
            values: (0..SIZE * SIZE).map(|p| s.raster.depth(p).map_or(f32::NAN, |z| z as f32)).collect(),
        })
        .collect();
    let points: Vec<_> = (0..SIZE * SIZE)
        .step_by(7)
        .filter(|&p| sights[0].raster.covered(p))
        .map(|p| sights[0].anchor(&subject, p))
        .collect();
    let tracks = Tracks {
        pixels: sights
            .iter()
            .map(|s| points.iter().map(|a| camera.project(a.position(&s.posed)).to_array().map(|v| v as f32)).collect())
            .collect(),
        confidence: vec![vec![0.8; points.len()]; truth.len()],
        query_frame: vec![0; points.len()],
    };
    let flow = |a: &Image, _: &Image| vec![[0.0; 2]; a.width * a.height];
    let input = Input {
        asset: &asset,
        camera: &camera,
        frames: &frames,
        masks: &masks,
        backgrounds: std::slice::from_ref(&background),
        flow: &flow,
        tracks: Some(&tracks),
        depth: &depth,
        depth_kind: DepthKind::Metric,
    };
    work(&input, &subject, &truth);
}

/// Calls `work` with all that stage 1 makes of that video at the start, and the true poses.
pub fn with_stage(work: impl FnOnce(&Stage, &[FramePose])) {
    with_video(|input, subject, truth| {
        let light = first_light(input, subject).expect("the object is seen");
        work(&stage(input, subject, &light, Settings::default()), truth);
    });
}

/// The same for any motion, without tracks and depth.
pub fn with_stage_of(motion: impl FnOnce(&Subject) -> Vec<FramePose>, work: impl FnOnce(&Stage, &[FramePose])) {
    with_video_of(motion, |input, subject, truth| {
        let input = Input { tracks: None, depth: &[], ..*input };
        let light = first_light(&input, subject).expect("the object is seen");
        work(&stage(&input, subject, &light, Settings::default()), truth);
    });
}
