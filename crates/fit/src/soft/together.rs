//! Poses and tissue together, block by block.
//!
//! Stage 1's poses explain the frames by skinning alone, so a simulation driven by them explains them worse. In turn, the motion
//! is simulated, what the soft surface adds to skinning is held fixed in the bones' frames ([`Flesh`]), and the poses are
//! solved again for the surface so made, with the last rounds of stage 1: its correspondences, outlines, rendered terms and priors.
//! Joints that are loose are seen by nothing then, and priors and smoothness have them. Where flesh is not soft the surface is the skinned
//! one. The round that explains the frames best is the result.

use super::Tissue;
use super::learn::{simulated, skinned};
use super::seen::energies;
use crate::FitError;
use crate::stage1::flesh::Flesh;
use crate::stage1::polish;
use crate::stage1::solve::Stage;
use animimic_rig::FramePose;
use animimic_scene::Pose;
use animimic_sim::Elasticity;
use glam::DVec3;
use rayon::prelude::*;

/// A motion whose soft surface explains the frames.
#[derive(Clone, Debug)]
pub struct Together {
    /// Poses \[frame\].
    pub poses: Vec<Pose>,
    /// The surface \[frame\]\[vertex\].
    pub surfaces: Vec<Vec<DVec3>>,
    /// Energy of each frame of it.
    pub frames: Vec<f64>,
    /// Energy of the surface before, and after each round.
    pub energies: Vec<f64>,
}

/// How poses are solved for a soft surface.
#[derive(Clone, Copy, Debug)]
pub struct Turns<'a> {
    /// Share of softness of each vertex: the rest is skinned. Where all is, poses are solved as often and nothing is simulated: what as
    /// much search finds without tissue.
    pub share: &'a [f64],
    /// Most turns.
    pub rounds: usize,
    /// Energy that the result has to compete with. Where there is one, rendered terms count too, in all turns but the first: they take
    /// several times as long.
    pub rival: Option<f64>,
}

/// A round that lowers the energy by less than this share is the last.
const SETTLED: f64 = 0.02;
/// A step of a polish that gains less than this share is its last: the next turn polishes on.
const POLISHED: f64 = 2e-3;
/// So many times the rival's energy before rendered terms count will not come down to it: they take off a tenth or so.
const HOPELESS: f64 = 1.15;

/// Solves the poses of a clip, given at some frames per second, for its soft surface; `go_on` is asked before each turn.
///
/// # Errors
/// As [`Tissue::simulate`]; a stop, which `go_on` asks for.
pub fn together(
    tissue: &Tissue,
    material: &Elasticity,
    stage: &mut Stage,
    (poses, fps): (&[Pose], f64),
    turns: Turns,
    go_on: &mut dyn FnMut() -> Result<(), FitError>,
) -> Result<Together, FitError> {
    let subject = stage.subject;
    let rig = &tissue.asset.rig;
    let loose: Vec<usize> = (0..rig.skeleton.joints.len()).filter(|&j| tissue.carrier[j] != j).collect();
    let soft = turns.share.iter().any(|share| *share > 0.0);
    let surface = |poses: &[Pose]| -> Result<Vec<Vec<DVec3>>, FitError> {
        let skinned = skinned(tissue.asset, poses);
        if !soft {
            return Ok(skinned);
        }
        let mut soft = simulated(tissue, material, poses, fps)?;
        blend(&skinned, &mut soft, turns.share);
        Ok(soft)
    };
    let mut surfaces = surface(poses)?;
    let seen = energies(stage, &surfaces);
    let mut least: f64 = seen.iter().sum();
    let mut best = Together { poses: poses.to_vec(), surfaces: surfaces.clone(), frames: seen, energies: vec![least] };
    let mut frames: Vec<FramePose> = poses.iter().map(|p| subject.tree.frame(rig, p)).collect();
    for round in 0..turns.rounds {
        go_on()?;
        stage.flesh = soft.then(|| Flesh::new(subject, &loose, &frames, &surfaces));
        stage.finish(&mut frames);
        if turns.rival.is_some() && round > 0 {
            // What softness has to beat is skinning at its best.
            stage.polish(&mut frames, if soft { POLISHED } else { polish::SETTLED });
        }
        stage.flesh = None;
        let solved: Vec<Pose> = frames.iter().map(|f| subject.file_pose(f)).collect();
        surfaces = surface(&solved)?;
        let seen = energies(stage, &surfaces);
        let energy: f64 = seen.iter().sum();
        best.energies.push(energy);
        let gain = 1.0 - energy / least;
        if gain > 0.0 {
            least = energy;
            (best.poses, best.surfaces, best.frames) = (solved, surfaces.clone(), seen);
        }
        let hopeless = round == 0 && turns.rival.is_some_and(|rival| least > HOPELESS * rival);
        if hopeless || round > 0 && gain < SETTLED {
            break;
        }
    }
    Ok(best)
}

/// Brings `soft` \[frame\]\[vertex\] back to `skinned` where a vertex's share of softness is less than 1.
pub fn blend(skinned: &[Vec<DVec3>], soft: &mut [Vec<DVec3>], share: &[f64]) {
    soft.par_iter_mut().zip(skinned).for_each(|(soft, skinned)| {
        for ((x, s), share) in soft.iter_mut().zip(skinned).zip(share) {
            *x = if *share == 0.0 { *s } else { s.lerp(*x, *share) };
        }
    });
}
