use super::*;
use crate::stage1::Input;
use crate::stage1::sight::{Sight, Studio};
use crate::stage1::subject::Subject;
use animimic_math::gradcheck::SplitMix64;
use animimic_render::Light;
use animimic_rig::fixtures::creature;
use animimic_scene::{Asset, Camera, DepthKind, DepthMap, Image, Look, Mask, Part, Tracks};
use glam::DVec3;

const FRAMES: usize = 4;
const SIZE: usize = 128;

fn asset() -> Asset {
    let (rig, mut mesh) = creature();
    mesh.parts =
        vec![Part { vertices: 0..mesh.positions.len(), triangles: 0..mesh.triangles.len(), ..Part::default() }];
    mesh.colors = mesh.positions.iter().map(|p| [0.3 + 0.2 * p.x as f32, 0.4, 0.6 - 0.1 * p.z as f32]).collect();
    Asset { mesh, rig, looks: vec![Look { double_sided: true, ..Look::default() }], ..Asset::default() }
}

/// Calls `work` with the loss of a small video of the creature in motion, with exact masks, tracks and depth, and its true poses.
fn with_loss(work: impl FnOnce(&Loss, &[FramePose])) {
    let asset = asset();
    let subject = Subject::new(&asset).expect("can be drawn");
    let kinematics = free(&subject.tree.kinematics);
    let camera = Camera::orbit(DVec3::new(1.0, 0.6, 0.9), 6.5, 0.6, 0.2, 0.7, SIZE as u32, SIZE as u32);
    let light = Light::ambient(1.0);
    let studio = Studio { camera: &camera, light: &light };
    let background = Image::filled(SIZE, SIZE, [240; 3]);
    let truth: Vec<FramePose> = (0..FRAMES)
        .map(|t| {
            let tree = &subject.tree.kinematics;
            let step = (0..tree.dimension).map(|i| 0.03 * t as f64 * (1.7 * i as f64).sin()).collect::<Vec<_>>();
            tree.retract(&tree.rest(), &step)
        })
        .collect();
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
        .step_by(17)
        .filter(|&p| sights[0].raster.covered(p))
        .map(|p| sights[0].anchor(&subject, p))
        .collect();
    let tracks = Tracks {
        pixels: sights
            .iter()
            .map(|s| points.iter().map(|a| camera.project(a.position(&s.posed)).to_array().map(|v| v as f32)).collect())
            .collect(),
        confidence: vec![vec![0.8; points.len()]; FRAMES],
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
    work(&Loss::new(&input, &subject, &kinematics, &light), &truth);
}

#[test]
fn the_total_loss_has_the_right_gradient_and_is_least_near_the_truth() {
    with_loss(|loss, truth| {
        let kinematics = loss.kinematics();
        let mut rng = SplitMix64(2);
        let poses: Vec<FramePose> = truth
            .iter()
            .map(|p| {
                let step: Vec<f64> = (0..kinematics.dimension).map(|_| 0.05 * rng.normal()).collect();
                kinematics.retract(p, &step)
            })
            .collect();
        let (parts, gradients) = loss.with_gradient(&poses);
        assert!(loss.score(truth).total() < 0.5 * parts.total(), "{:?} {parts:?}", loss.score(truth));
        let direction: Vec<Vec<f64>> =
            gradients.iter().map(|g| g.iter().map(|v| v.signum() * (0.5 + rng.uniform())).collect()).collect();
        let along: f64 = gradients.iter().flatten().zip(direction.iter().flatten()).map(|(g, d)| g * d).sum();
        // The rendered parts jump from pixel to pixel: they are checked closely by themselves, and a few per cent are left here.
        let at = |h: f64| {
            let moved: Vec<FramePose> = poses
                .iter()
                .zip(&direction)
                .map(|(p, d)| kinematics.retract(p, &d.iter().map(|v| h * v).collect::<Vec<_>>()))
                .collect();
            loss.score(&moved).total()
        };
        let h = 2e-3;
        let numeric = (at(h) - at(-h)) / (2.0 * h);
        println!("{along:.4} {numeric:.4}: relative error {:.1e}", (along - numeric).abs() / numeric.abs());
        assert!((along - numeric).abs() < 3e-2 * numeric.abs());
    });
}

#[test]
fn the_recipe_goes_down_and_gives_the_same_bytes_for_any_number_of_threads() {
    with_loss(|loss, _| {
        let schedule = Schedule { alone: 10, together: 60 };
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| run(loss, FRAMES, &schedule, &mut |_, _| ControlFlow::Continue(()))).expect("not stopped")
        };
        let (one, three) = (with(1), with(3));
        let rest = loss.score(&vec![loss.kinematics().rest(); FRAMES]).total();
        let end = loss.score(&one.poses).total();
        println!("rest {rest:.4}, after the first phase {:.4}, at the end {end:.4}", one.losses[0]);
        assert_eq!(one.poses, three.poses);
        assert!(end < 0.9 * one.losses[0] && one.losses[0] < rest);
        assert!(run(loss, FRAMES, &schedule, &mut |_, _| ControlFlow::Break(())).is_err());
    });
}
