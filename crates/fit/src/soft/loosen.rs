//! Which chains of joints are loose, by evidence: a tail that no muscle moves is explained better by inertia than by its joints.
//!
//! Each chain that ends in a tip is tried: it holds nothing, what hangs on it follows by inertia at a few stiffnesses, and it stays
//! loose where that brings the evidence's energy clearly below what its held joints leave, at the best of the same stiffnesses.

use super::bones::live;
use super::clusters::by_joint;
use super::estimate::{Clip, Problem};
use super::{Settings, Tissue};
use crate::FitError;
use animimic_scene::{Asset, Rig};
use animimic_sim::tet::cage;
use animimic_sim::{Elasticity, Model};

/// About how many tets a trial has: what is asked is coarse.
const TETS: usize = 800;
/// Stiffness of the body in trials [Pa], and changes of its logarithm that are tried for a chain.
const YOUNG: f64 = 1e5;
const CHANGES: [f64; 6] = [-1.5, -0.5, 0.5, 1.5, 2.5, 4.0];
/// A chain is loose where the energy falls to this share.
const CLEARLY: f64 = 0.97;

/// Chains of joints that carry something, from below a branching to the tip.
pub fn chains(rig: &Rig, carrying: &[usize]) -> Vec<Vec<usize>> {
    let joints = &rig.skeleton.joints;
    let live = live(rig, carrying);
    let below = |j: usize| (0..joints.len()).filter(|&c| live[c] && joints[c].parent == Some(j)).count();
    let mut out = Vec::new();
    for tip in (0..joints.len()).filter(|&j| live[j] && below(j) == 0) {
        let mut chain = vec![tip];
        let mut at = tip;
        while let Some(p) = joints[at].parent.filter(|&p| below(p) == 1) {
            chain.push(p);
            at = p;
        }
        // A body that is one chain must be held somewhere.
        if joints[at].parent.is_none() {
            chain.pop();
        }
        chain.reverse();
        if chain.iter().any(|j| carrying.contains(j)) {
            out.push(chain);
        }
    }
    out
}

/// The settings with the chains that the evidence takes to be loose beside those that they name, and with their roots held or not, as
/// the evidence says. `solid` holds Poisson's ratio and the density [kg/m³].
///
/// # Errors
/// As [`Tissue::new`] and [`Tissue::simulate`].
pub fn loose(asset: &Asset, settings: &Settings, clips: &[Clip], solid: (f64, f64)) -> Result<Settings, FitError> {
    let cage = cage(&asset.mesh, TETS)?;
    let tissue = |settings: &Settings| Tissue::with_cage(asset, cage.clone(), settings);
    let mut best = settings.clone();
    let held = tissue(&best)?;
    let carrying = held.weights.joints.clone();
    // Every loose chain has a stiffness of its own.
    let mut parts: Vec<Part> = Vec::new();
    let named = Part { joints: settings.loose.clone(), ln_young: YOUNG.ln() };
    let mut least = trial(&held, &mut parts, named, clips, solid)?;
    for chain in chains(&asset.rig, &carrying) {
        if chain.iter().all(|j| best.loose.contains(j)) {
            continue;
        }
        let loose_parts = parts.len();
        let loose = best.loose.iter().copied().chain(chain.iter().copied()).collect();
        let more = Settings { loose, ..best.clone() };
        let part = || Part { joints: chain.clone(), ln_young: YOUNG.ln() };
        let with = trial(&tissue(&more)?, &mut parts, part(), clips, solid)?;
        let loosened = parts.pop();
        // Held, the chain may have another stiffness too.
        if with < CLEARLY * least && with < CLEARLY * trial(&tissue(&best)?, &mut parts, part(), clips, solid)? {
            parts.pop();
            parts.extend(loosened);
            (best, least) = (more, with);
        } else {
            parts.truncate(loose_parts);
        }
    }
    if !best.loose.is_empty() {
        let other = Settings { held_roots: !best.held_roots, ..best.clone() };
        let nothing = Part { joints: Vec::new(), ln_young: YOUNG.ln() };
        if trial(&tissue(&other)?, &mut parts, nothing, clips, solid)? < CLEARLY * least {
            best = other;
        }
    }
    Ok(best)
}

/// Loose flesh with its stiffness in trials.
struct Part {
    joints: Vec<usize>,
    ln_young: f64,
}

/// Adds a part at the stiffness at which the energy is least; returns that energy. A part without joints is the body.
fn trial(
    tissue: &Tissue,
    parts: &mut Vec<Part>,
    part: Part,
    clips: &[Clip],
    (poisson, density): (f64, f64),
) -> Result<f64, FitError> {
    parts.push(part);
    let joints: Vec<usize> = parts.iter().flat_map(|p| &p.joints).copied().collect();
    let of_joint: Vec<u32> = parts.iter().enumerate().flat_map(|(k, p)| vec![k as u32 + 1; p.joints.len()]).collect();
    let rank = |r: u32| r.checked_sub(1).map_or(0, |j| of_joint[j as usize]);
    let one = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), YOUNG, poisson, density);
    let material = Elasticity {
        cluster: by_joint(tissue, &joints).into_iter().map(rank).collect(),
        ln_youngs: std::iter::once(YOUNG.ln()).chain(parts.iter().map(|p| p.ln_young)).collect(),
        ..one
    };
    let open = if parts[parts.len() - 1].joints.is_empty() { 0 } else { parts.len() };
    let deviations: Vec<f64> = (0..=parts.len()).map(|k| if k == open { 1.0 } else { KNOWN }).collect();
    let problem = Problem {
        tissue,
        clips,
        substeps: 1,
        prior_deviations: &deviations,
        groups: None,
        damping: false,
        pictures: false,
    };
    let (found, energy) = problem.best_of(&material, &CHANGES)?;
    let last = parts.len() - 1;
    parts[last].ln_young = found.ln_youngs[open];
    Ok(energy)
}

/// Width of a prior that keeps what it is of.
const KNOWN: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_rig::fixtures::{creature, joint};

    #[test]
    fn chains_end_in_tips_and_begin_below_a_branching() {
        let rig = creature().0;
        let carrying: Vec<usize> = rig.skin.slots.iter().map(|s| s.joint).collect();
        let chains = chains(&rig, &carrying);
        println!("{chains:?}");
        assert!(chains.contains(&vec![joint::THIGH, joint::SHIN]), "a leg hangs on the spine");
        assert!(chains.iter().all(|c| !c.contains(&joint::SPINE) && !c.contains(&joint::ARMATURE)));
    }
}
