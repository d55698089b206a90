//! The creature's soft tissue: its tail has one joint, which no muscle moves, and swings by inertia and elasticity.
//!
//! The truth is simulated on a cage of twice as many tets as a fit has.

use super::Example;
use crate::Error;
use animimic_fit::soft::clusters::by_joint;
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_scene::{Asset, Motion};
use animimic_sim::{Elasticity, Model};
use glam::DVec3;

/// The joint whose flesh swings.
pub const LOOSE: &str = "tail";
/// Young's modulus of the tail, for a rest diagonal of 1 m [Pa].
pub const TAIL_YOUNG: f64 = 2.5e5;
/// Young's modulus of everything else [Pa].
pub const BODY_YOUNG: f64 = 2e6;
/// About how many tets the truth has.
pub const TETS: usize = 6000;

const POISSON: f64 = 0.4;
const DENSITY: f64 = 1000.0;

/// True surfaces of the example's motion \[frame\]\[vertex\].
///
/// # Errors
/// [`Error::Fit`] never happens for the creature, which is sound.
pub fn surfaces(example: &Example) -> Result<Vec<Vec<DVec3>>, Error> {
    moved(&example.asset, &example.motion)
}

/// The same for another motion of the creature.
///
/// # Errors
/// As [`surfaces`].
pub fn moved(asset: &Asset, motion: &Motion) -> Result<Vec<Vec<DVec3>>, Error> {
    let joints = &asset.rig.skeleton.joints;
    let loose: Vec<usize> = (0..joints.len()).filter(|&j| joints[j].name == LOOSE).collect();
    let tissue = Tissue::new(asset, &Settings { tets: TETS, loose: loose.clone(), ..Settings::default() })?;
    let one = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), BODY_YOUNG, POISSON, DENSITY);
    let material =
        Elasticity { cluster: by_joint(&tissue, &loose), ln_youngs: vec![BODY_YOUNG.ln(), TAIL_YOUNG.ln()], ..one };
    let simulated = tissue.simulate(&material, &Stepping::default(), &motion.poses, motion.fps)?;
    Ok(simulated.surfaces(&tissue, &motion.poses))
}
