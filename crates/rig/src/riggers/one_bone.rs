//! One bone in the middle that carries everything: the fallback for what has no limbs, and for people who want no skeleton.

use super::{RigError, RigOptions, Rigger, assemble};
use animimic_scene::{Asset, Influence, Mesh, Rig};

pub(crate) struct OneBone;

impl Rigger for OneBone {
    fn name(&self) -> &'static str {
        "one-bone"
    }

    fn summary(&self) -> &'static str {
        "a single bone in the middle of the box around the model; it moves as a whole"
    }

    fn rig(&self, asset: &Asset, _options: &RigOptions) -> Result<Rig, RigError> {
        Ok(rig(&asset.mesh))
    }
}

/// The rig.
pub(super) fn rig(mesh: &Mesh) -> Rig {
    let (lo, hi) = mesh.bounds();
    let influences = vec![vec![Influence { slot: 0, weight: 1.0 }]; mesh.positions.len()];
    assemble(mesh, vec![("root".into(), 0.5 * (lo + hi), None)], influences)
}
