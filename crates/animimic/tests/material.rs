//! Stiffness from rendered videos of creatures of our own whose truth is known.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::cues::dense_flow;
use animimic::example;
use animimic::pictures::{Studio, silhouette};
use animimic::scene::{Asset, Camera, DepthKind, Image, Mask, Motion};
use animimic::sim::{Elasticity, Model};
use animimic_fit::soft::clusters::Groups;
use animimic_fit::soft::fixtures::{ARM_JOINTS, camera, shaken, three_arms};
use animimic_fit::soft::learn::{Learnt, Watched, Wish, learn, skinned};
use animimic_fit::soft::seen::energies;
use animimic_fit::soft::together::{Turns, together};
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_fit::stage1::solve::Stage;
use animimic_fit::stage1::subject::Subject;
use animimic_fit::stage1::{self, Input};
use glam::DVec3;

const SIZE: u32 = 384;
const FPS: f64 = 24.0;
const BEHIND: [u8; 3] = [225; 3];
/// Moduli of the arms and of the body [Pa].
const ARMS: [f64; 3] = [6e4, 2e5, 8e5];
const BODY: f64 = 1e6;

/// Surfaces of the truth \[frame\]\[vertex\], on half the tets that the fit has.
fn truth(asset: &Asset, motion: &Motion) -> Vec<Vec<DVec3>> {
    let settings = Settings { tets: 1500, loose: ARM_JOINTS.to_vec(), ..Settings::default() };
    let tissue = Tissue::new(asset, &settings).unwrap();
    let groups = Groups::new(&tissue, 16);
    let mut ln_youngs = vec![BODY.ln(); groups.parents.len()];
    for (joint, young) in ARM_JOINTS.iter().zip(ARMS) {
        ln_youngs[groups.of_joint[*joint] as usize] = f64::ln(young);
    }
    let one = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), BODY, 0.4, 1000.0);
    let material = Elasticity { cluster: groups.of_tets(&tissue), ln_youngs, ..one };
    let simulated = tissue.simulate(&material, &Stepping::default(), &motion.poses, FPS).unwrap();
    simulated.surfaces(&tissue, &motion.poses)
}

/// A clip with the video of its true surfaces.
struct Footage<'a> {
    motion: &'a Motion,
    frames: Vec<Image>,
    masks: Vec<Mask>,
}

impl<'a> Footage<'a> {
    fn new(asset: &Asset, camera: &Camera, motion: &'a Motion, surfaces: &[Vec<DVec3>]) -> Self {
        let studio = Studio::with_light(asset, Default::default()).unwrap();
        let frames = surfaces.iter().map(|x| studio.draw(camera, x, BEHIND).0).collect();
        let masks = surfaces.iter().map(|x| silhouette(camera, &asset.mesh, x)).collect();
        Self { motion, frames, masks }
    }
}

/// Calls `work` with stage 1's view of some clips.
fn with_stages<R>(
    asset: &Asset,
    camera: &Camera,
    clips: &[&Footage],
    work: impl FnOnce(&Subject, &mut [Stage]) -> R,
) -> R {
    let blank = Image::filled(camera.width as usize, camera.height as usize, BEHIND);
    let mut inputs = Vec::new();
    for clip in clips {
        inputs.push(Input {
            asset,
            camera,
            frames: &clip.frames,
            masks: &clip.masks,
            backgrounds: std::slice::from_ref(&blank),
            flow: &dense_flow,
            tracks: None,
            depth: &[],
            depth_kind: DepthKind::Metric,
        });
    }
    let subject = Subject::new(asset).unwrap();
    let lights: Vec<_> = inputs.iter().map(|i| stage1::first_light(i, &subject).unwrap()).collect();
    let stage = |(i, light)| stage1::stage(i, &subject, light, stage1::Settings::default());
    let mut stages: Vec<Stage> = inputs.iter().zip(&lights).map(stage).collect();
    work(&subject, &mut stages)
}

/// What is learnt from some clips together.
fn learnt(asset: &Asset, camera: &Camera, clips: &[&Footage], wish: &Wish) -> Learnt {
    with_stages(asset, camera, clips, |_, stages| {
        let mut watched = Vec::new();
        for (stage, clip) in stages.iter().zip(clips) {
            watched.push(Watched { stage, poses: &clip.motion.poses, fps: FPS });
        }
        learn(asset, &Settings::default(), wish, &watched, &mut |_| Ok(())).unwrap()
    })
}

#[test]
fn the_stiffness_of_every_arm_is_learnt_from_a_video_and_its_looseness_too() {
    let asset = three_arms();
    let motion = shaken(&asset, 25, FPS);
    let camera = camera(SIZE);
    let footage = Footage::new(&asset, &camera, &motion, &truth(&asset, &motion));
    let wish = Wish { rounds: 3, steps: 6, ..Wish::default() };
    let found = learnt(&asset, &camera, &[&footage], &wish);
    println!("loose {:?}, clusters {:?}, energies {:.0?}", found.settings.loose, found.clusters, found.energies);
    assert_eq!(found.settings.loose, ARM_JOINTS, "no joint turns and yet the arms swing");
    for (joint, young) in ARM_JOINTS.iter().zip(ARMS) {
        let group = found.groups.of_joint[*joint] as usize;
        let ratio = found.ln_youngs[group].exp() / young;
        println!("arm {joint}: {ratio:.3} of the truth, ln E ± {:.3}", found.deviations[group]);
        assert!(ratio > 1.0 / 1.5 && ratio < 1.5);
    }
}

#[test]
fn clips_of_one_creature_share_its_stiffness() {
    let example::Example { asset, camera, .. } = example::creature();
    let camera = camera.main.resized(256, 256);
    let motions = [example::trot, example::sway].map(|dance| dance(&asset.rig.skeleton, 25, FPS));
    let footage: Vec<Footage> =
        motions.iter().map(|m| Footage::new(&asset, &camera, m, &example::moved(&asset, m).unwrap())).collect();
    let tail = asset.rig.skeleton.joints.iter().position(|j| j.name == example::LOOSE).unwrap();
    let [trot, sway, both] = [vec![&footage[0]], vec![&footage[1]], footage.iter().collect()].map(|clips| {
        let found = learnt(&asset, &camera, &clips, &Wish::default());
        let group = found.groups.of_joint[tail] as usize;
        let ratio = found.ln_youngs[group].exp() / example::TAIL_YOUNG;
        let names: Vec<&str> = clips.iter().map(|c| c.motion.name.as_str()).collect();
        println!(
            "{names:?}: loose {:?}, tail {ratio:.3} of the truth, ln E ± {:.3}",
            found.settings.loose, found.deviations[group]
        );
        assert!(found.settings.loose.contains(&tail), "no joint moves it");
        (ratio, found.deviations[group])
    });
    assert!(both.0 > 1.0 / 1.5 && both.0 < 1.5, "on a cage half as fine as the truth's");
    assert!(both.1 < trot.1.min(sway.1), "normal equations add up");
}

#[test]
fn poses_solved_for_the_soft_surface_explain_the_frames_as_skinning_does_and_are_nearer_to_the_truth() {
    let asset = three_arms();
    let mut motion = shaken(&asset, 25, FPS);
    for (t, pose) in motion.poses.iter_mut().enumerate() {
        for (k, &j) in ARM_JOINTS.iter().enumerate() {
            let bend = 0.5 * (0.35 * t as f64 + k as f64).sin() - 0.5 * (k as f64).sin();
            pose.locals[j].rotation *= glam::DQuat::from_rotation_z(bend);
        }
    }
    let tissue = Tissue::new(&asset, &Settings { tets: 1500, ..Settings::default() }).unwrap();
    let soft = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), 4e4, 0.4, 1000.0);
    let simulated = tissue.simulate(&soft, &Stepping::default(), &motion.poses, FPS).unwrap();
    let real = simulated.surfaces(&tissue, &motion.poses);
    let camera = camera(256);
    let footage = Footage::new(&asset, &camera, &motion, &real);
    with_stages(&asset, &camera, &[&footage], |subject, stages| {
        let stage = &mut stages[0];
        // What stage 1 ends with: poses that explain the frames by skinning.
        let mut frames: Vec<_> = motion.poses.iter().map(|p| subject.tree.frame(&asset.rig, p)).collect();
        for _ in 0..3 {
            stage.finish(&mut frames);
        }
        let poses: Vec<_> = frames.iter().map(|f| subject.file_pose(f)).collect();
        let by_skinning: f64 = energies(stage, &skinned(&asset, &poses)).iter().sum();
        let share = vec![1.0; asset.mesh.positions.len()];
        let turns = Turns { share: &share, rounds: 3, rival: Some(f64::INFINITY) };
        let found = together(&tissue, &soft, stage, (&poses, FPS), turns, &mut || Ok(())).unwrap();
        let off = |surfaces: &[Vec<DVec3>]| {
            let pairs = surfaces.iter().flatten().zip(real.iter().flatten());
            let (sum, n) = pairs.fold((0.0, 0), |(s, n), (a, b)| (s + a.distance_squared(*b), n + 1));
            100.0 * (sum / f64::from(n)).sqrt() / asset.mesh.diagonal()
        };
        let start = off(&skinned(&asset, &poses));
        let end = off(&found.surfaces);
        println!(
            "energy: {by_skinning:.1} skinned, soft {:.1?}; off the truth: {start:.3} % skinned, {end:.3} % soft",
            found.energies
        );
        let last = found.energies.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(last < by_skinning && last < 0.5 * found.energies[0]);
        assert!(end < 0.7 * start);
        // Poses solved as often without tissue do not come down to that.
        let none = Turns { share: &vec![0.0; share.len()], ..turns };
        let again = together(&tissue, &soft, stage, (&poses, FPS), none, &mut || Ok(())).unwrap();
        let least = again.energies.iter().copied().fold(f64::INFINITY, f64::min);
        println!("energy with as much search by skinning: {:.1?}", again.energies);
        assert_eq!(again.surfaces, skinned(&asset, &again.poses));
        assert_eq!(again.energies[0], by_skinning);
        assert!(last < least && least < by_skinning);
        assert!(stage.flesh.is_none(), "the stage is as it was");
    });
}
