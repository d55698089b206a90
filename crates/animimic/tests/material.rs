//! Stiffness from a rendered video of a creature of our own whose truth is known.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic::cues::dense_flow;
use animimic::pictures::{Studio, silhouette};
use animimic::scene::{Asset, DepthKind, Image, Mask, Motion};
use animimic::sim::{Elasticity, Model};
use animimic_fit::soft::clusters::Groups;
use animimic_fit::soft::fixtures::{ARM_JOINTS, camera, shaken, three_arms};
use animimic_fit::soft::learn::{Watched, Wish, learn};
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_fit::stage1::subject::Subject;
use animimic_fit::stage1::{self, Input};
use glam::DVec3;

const SIZE: u32 = 384;
const FPS: f64 = 24.0;
const BEHIND: [u8; 3] = [225; 3];
/// Moduli of the arms and of the body [Pa].
const ARMS: [f64; 3] = [6e4, 2e5, 8e5];
const BODY: f64 = 1e6;

/// Surfaces of the truth \[frame\]\[vertex\], on the cage that the fit has: a lattice is stiffer the coarser it is.
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
    let frames = simulated.frames().zip(&motion.poses);
    frames.map(|(cage, pose)| tissue.surface(cage, &tissue.world(pose))).collect()
}

#[test]
fn the_stiffness_of_every_arm_is_learnt_from_a_video_and_its_looseness_too() {
    let asset = three_arms();
    let motion = shaken(&asset, 25, FPS);
    let real = truth(&asset, &motion);
    let camera = camera(SIZE);
    let studio = Studio::with_light(&asset, Default::default()).unwrap();
    let frames: Vec<Image> = real.iter().map(|x| studio.draw(&camera, x, BEHIND).0).collect();
    let masks: Vec<Mask> = real.iter().map(|x| silhouette(&camera, &asset.mesh, x)).collect();
    let blank = Image::filled(SIZE as usize, SIZE as usize, BEHIND);
    let input = Input {
        asset: &asset,
        camera: &camera,
        frames: &frames,
        masks: &masks,
        backgrounds: std::slice::from_ref(&blank),
        flow: &dense_flow,
        tracks: None,
        depth: &[],
        depth_kind: DepthKind::Metric,
    };
    let subject = Subject::new(&asset).unwrap();
    let light = stage1::first_light(&input, &subject).unwrap();
    let stage = stage1::stage(&input, &subject, &light, stage1::Settings::default());
    let watched = [Watched { stage: &stage, poses: &motion.poses, fps: FPS }];
    let wish = Wish { rounds: 3, steps: 6, ..Wish::default() };
    let found = learn(&asset, &Settings::default(), &wish, &watched, &mut |_| Ok(())).unwrap();
    println!("loose {:?}, clusters {:?}, energies {:.0?}", found.settings.loose, found.clusters, found.energies);
    assert_eq!(found.settings.loose, ARM_JOINTS, "no joint turns and yet the arms swing");
    for (joint, young) in ARM_JOINTS.iter().zip(ARMS) {
        let group = found.groups.of_joint[*joint] as usize;
        let ratio = found.ln_youngs[group].exp() / young;
        println!("arm {joint}: {ratio:.3} of the truth, ln E ± {:.3}", found.deviations[group]);
        assert!(ratio > 1.0 / 1.5 && ratio < 1.5);
    }
}
