//! Stage 2: soft tissue on a skeleton. The only place where rig and simulation meet.
//!
//! A cage of tets is built around the displayed rest pose ([`Tissue`]). Flesh in the cores of bones is held by the joints'
//! displacements from rest, T_j(t) = G_j(t) G_j(rest)⁻¹; the rest is free ([`holds`]). A motion is simulated
//! ([`Tissue::simulate`]), and the surface follows its tets ([`surface`]).
//!
//! Units: lengths are scaled so that the rest diagonal is `size_m` (1 m unless said otherwise).

pub mod bones;
pub mod clusters;
pub mod estimate;
pub mod evidence;
pub mod fixtures;
pub mod holds;
pub mod learn;
pub mod loosen;
pub mod motion;
mod normal;
pub mod seen;
pub mod surface;
pub mod together;
pub mod verdict;
pub mod weights;

use crate::FitError;
use animimic_scene::{Asset, Rig, TetMesh};
use animimic_sim::tet::{Cage, DEFAULT_TETS, cage};
use animimic_sim::{Body, Elasticity, Tether};
use bones::Bone;
use glam::{DAffine3, DVec3};
use holds::{Choice, FREE, Hold};
pub use motion::{Report, Simulated, Stepping};
use surface::Skinning;
use weights::CageWeights;

/// Stiffness of a hold over that of the flesh that it holds, a cell of it: enough to hold it, not so much as to crush it where bones
/// come near each other.
const HOLD: f64 = 10.0;

/// Modulus above which a material that is given is held more than in proportion: gristle, firmer than all flesh [Pa].
const FIRM: f64 = 1e7;

/// How tissue is made of a model.
#[derive(Clone, Debug)]
pub struct Settings {
    /// About how many tets.
    pub tets: usize,
    /// Length of the rest diagonal [m].
    pub size_m: f64,
    /// Skeleton joints that do not drive: what hangs on them follows by inertia and elasticity.
    pub loose: Vec<usize>,
    /// Whether the roots of loose flesh follow the skin.
    pub held_roots: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { tets: DEFAULT_TETS, size_m: 1.0, loose: Vec::new(), held_roots: true }
    }
}

/// A model's body, ready to be simulated.
pub struct Tissue<'a> {
    /// The model.
    pub asset: &'a Asset,
    /// The cage in the displayed rest pose [model unit].
    pub cage: Cage,
    /// Metres per model unit.
    pub scale: f64,
    /// Weights of joints at the cage's vertices.
    pub weights: CageWeights,
    /// Points of the flesh that joints hold.
    pub holds: Vec<Hold>,
    /// Vertices of the cage at the roots of loose flesh, which follow the skin ([`holds::seams`]).
    pub seams: Vec<u32>,
    /// The joint that drives each cage vertex, as an index into the weights' joints, or [`FREE`].
    pub driver: Vec<u32>,
    /// The body in metres.
    pub body: Body,
    /// Bones of the joints that carry something.
    pub bones: Vec<Bone>,
    /// How the surface follows.
    pub skinning: Skinning,
    /// The joint whose displacement counts for each skeleton joint: itself, or the next one above that drives.
    carrier: Vec<usize>,
    /// Rest transforms of the joints, world space, inverted.
    joint_from_rest: Vec<DAffine3>,
}

impl<'a> Tissue<'a> {
    /// Builds the cage of a rigged model and chooses its drivers.
    ///
    /// # Errors
    /// A surface that cannot be filled; a size that is not positive.
    pub fn new(asset: &'a Asset, settings: &Settings) -> Result<Self, FitError> {
        let cage = cage(&asset.mesh, settings.tets)?;
        Self::with_cage(asset, cage, settings)
    }

    /// The same with a cage made before.
    ///
    /// # Errors
    /// A size that is not positive; a cage that is not one of this model.
    pub fn with_cage(asset: &'a Asset, cage: Cage, settings: &Settings) -> Result<Self, FitError> {
        if !(settings.size_m > 0.0 && settings.size_m.is_finite()) {
            return Err(FitError::Input(format!("a rest diagonal of {} m; it must be positive", settings.size_m)));
        }
        if cage.embedding.tet.len() != asset.rig.skin.influences.len() {
            return Err(FitError::Input("the cage was made of another model".into()));
        }
        let rig = &asset.rig;
        let scale = settings.size_m / asset.mesh.diagonal();
        let weights = CageWeights::new(&rig.skin, &cage);
        let rest_world = rig.skeleton.rest_world();
        let origins: Vec<DVec3> = rest_world.iter().map(|g| g.translation).collect();
        let bones = bones::bones(rig, &origins, &asset.mesh, &weights);
        let carrier = carriers(rig, &settings.loose);
        let loose: Vec<bool> = weights.joints.iter().map(|j| settings.loose.contains(j)).collect();
        let choice =
            Choice { mesh: &cage.mesh, spacing: cage.spacing, weights: &weights, bones: &bones, loose: &loose };
        let (holds, driver) = holds::holds(&choice);
        let seams = if settings.held_roots { holds::seams(&choice, &driver) } else { Vec::new() };
        let positions = cage.mesh.positions.iter().map(|x| *x * scale).collect();
        let mesh = TetMesh { positions, tets: cage.mesh.tets.clone() };
        let driven: Vec<u32> = (0..driver.len() as u32).filter(|&v| driver[v as usize] != FREE).collect();
        let stiffness = HOLD * cage.spacing * scale;
        let tether = |h: &Hold| Tether { tet: h.tet, barycentric: h.barycentric, stiffness };
        let seam = |&v: &u32| holds::at_vertex(&cage.mesh, 0, v).map(|h| tether(&h));
        let tethers = holds.iter().map(tether).chain(seams.iter().filter_map(seam)).collect();
        let body = Body::new(&mesh, &driven)?.tethered(tethers)?;
        let holding: Vec<bool> = (0..weights.joints.len() as u32)
            .map(|c| loose[c as usize] || driver.contains(&c) || holds.iter().any(|h| h.joint == c))
            .collect();
        let mut skinned: Vec<bool> = driver.iter().map(|d| *d != FREE).collect();
        seams.iter().for_each(|&v| skinned[v as usize] = true);
        let skinning = Skinning::new(asset, &cage, &weights, &skinned, &holding);
        let joint_from_rest = rest_world.iter().map(|g| g.inverse()).collect();
        Ok(Self { asset, cage, scale, weights, holds, seams, driver, body, bones, skinning, carrier, joint_from_rest })
    }

    /// The same tissue, held as a material that is given asks for: flesh as before, what is firmer than that with 10 E s √(1 + (E/E_f)²),
    /// s a cell, for it would drag its holds away. Not for a material that is sought: to be firm would then be to follow the joints,
    /// which the frames prefer where poses were fitted by skinning.
    pub fn holding(mut self, material: &Elasticity) -> Self {
        for tether in &mut self.body.tethers {
            let young = material.ln_youngs[material.cluster[tether.tet as usize] as usize].exp();
            tether.stiffness *= (1.0 + (young / FIRM).powi(2)).sqrt();
        }
        self
    }

    /// Displacement from rest of every skeleton joint, T = G G(rest)⁻¹; that of the joint above where a joint is loose or its rest
    /// transform has no inverse.
    pub fn displacements(&self, world_from_joint: &[DAffine3]) -> Vec<DAffine3> {
        self.displaced(world_from_joint, |j| self.carrier[j] == j)
    }

    /// Displacements of the joints that `counts`, those of the joints above of all others.
    pub(super) fn displaced(&self, world_from_joint: &[DAffine3], counts: impl Fn(usize) -> bool) -> Vec<DAffine3> {
        let mut own: Vec<DAffine3> = Vec::with_capacity(world_from_joint.len());
        for (j, (g, inverse)) in world_from_joint.iter().zip(&self.joint_from_rest).enumerate() {
            let t = *g * *inverse;
            let above = self.asset.rig.skeleton.joints[j].parent.map_or(DAffine3::IDENTITY, |p| own[p]);
            own.push(if t.is_finite() && counts(j) { t } else { above });
        }
        own
    }

    /// Positions of the driven vertices, the holds and the seams [m], in the order of `body.driven` and `body.tethers`, for joints at
    /// `world_from_joint`.
    pub fn driven_positions(&self, world_from_joint: &[DAffine3]) -> Vec<DVec3> {
        let displacements = self.displacements(world_from_joint);
        let rest = &self.cage.mesh.positions;
        let at = |&v: &u32| {
            let joint = self.weights.joints[self.driver[v as usize] as usize];
            displacements[joint].transform_point3(rest[v as usize]) * self.scale
        };
        let held = self
            .holds
            .iter()
            .map(|h| displacements[self.weights.joints[h.joint as usize]].transform_point3(h.point) * self.scale);
        let all = if self.seams.is_empty() { Vec::new() } else { self.displaced(world_from_joint, |_| true) };
        let seam = |&v: &u32| (rest[v as usize] + self.skinned_cage_vertex(v as usize, &all)) * self.scale;
        self.body.driven.iter().map(at).chain(held).chain(self.seams.iter().map(seam)).collect()
    }
}

/// The next joint above, or itself, that is not loose.
fn carriers(rig: &Rig, loose: &[usize]) -> Vec<usize> {
    let mut out: Vec<usize> = Vec::with_capacity(rig.skeleton.joints.len());
    for (j, joint) in rig.skeleton.joints.iter().enumerate() {
        let carrier = match joint.parent {
            Some(p) if loose.contains(&j) => out[p],
            _ => j,
        };
        out.push(carrier);
    }
    out
}

#[cfg(test)]
mod tests;
