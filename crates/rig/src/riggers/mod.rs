//! Riggers: ways to give a still model a skeleton and skin weights.
//!
//! A new rigger is one file with a type that implements [`Rigger`], and one word in [`RIGGERS`].

#[cfg(test)]
mod fixtures;
mod from_file;
mod geometric;
mod one_bone;
#[cfg(test)]
mod tests;

use animimic_scene::io::{SceneError, weld};
use animimic_scene::solid::SurfaceError;
use animimic_scene::{Asset, Influence, Joint, Mesh, Rig, Skeleton, Skin, Slot, Transform};
use glam::{DAffine3, DVec3};
use std::path::PathBuf;

/// What is asked of a rigger.
#[derive(Clone, Debug)]
pub struct RigOptions {
    /// Level of detail, 1 (few bones) to 5 (many).
    pub detail: u8,
    /// Where `from-file` finds the rig: a rigged GLB of the same shape, or RigNet's `rig.txt`.
    pub file: Option<PathBuf>,
    /// What the vertices of a `rig.txt` are: for each of the mesh's its number there, and how many there are. The mesh's own where absent.
    pub raw_vertices: Option<(Vec<u32>, usize)>,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self { detail: 3, file: None, raw_vertices: None }
    }
}

impl RigOptions {
    /// What lengths of bones and least lengths of branches are divided by.
    fn fineness(&self) -> f64 {
        1.4f64.powi(i32::from(self.detail.clamp(1, 5)) - 3)
    }
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The surface cannot be rigged.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A rig's file cannot be read, or belongs to another model.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The rigger needs a file.
    #[error("rigger from-file needs the file of a rig: a rigged GLB or a rig.txt")]
    FileMissing,
    /// The file has no skeleton.
    #[error("{}: has no skeleton that bends anything", .0.display())]
    NoSkeleton(PathBuf),
}

/// One way to rig.
pub trait Rigger: Sync {
    /// Name on the command line and in `animimic list riggers`.
    fn name(&self) -> &'static str;
    /// One line on how it works.
    fn summary(&self) -> &'static str;
    /// A rig for an asset's mesh as displayed. The same input gives the same rig.
    ///
    /// # Errors
    /// [`RigError`].
    fn rig(&self, asset: &Asset, options: &RigOptions) -> Result<Rig, RigError>;
}

/// All riggers, the default first.
pub const RIGGERS: &[&dyn Rigger] = &[&geometric::Geometric, &from_file::FromFile, &one_bone::OneBone];

/// A rigger by its name.
pub fn rigger(name: &str) -> Option<&'static dyn Rigger> {
    RIGGERS.iter().copied().find(|r| r.name() == name)
}

/// Puts a rig in the place of an asset's own; clips of the old one go.
pub fn attach(asset: &mut Asset, rig: Rig) {
    let (welded, count) = weld::by_bind_and_influences(&rig.skin);
    asset.mesh.welded = welded;
    asset.mesh.welded_count = count;
    asset.rig = rig;
    asset.motions.clear();
}

/// Weights are multiples of one over this: their sum is 1 in any order and survives every file format.
const GRID: f64 = 8_388_608.0;

/// Rounds a vertex's weights to the grid; the largest, which comes first, takes up the rest.
fn on_grid(mut list: Vec<Influence>) -> Vec<Influence> {
    list.iter_mut().for_each(|i| i.weight = (i.weight * GRID).round() / GRID);
    let others: f64 = list.iter().skip(1).map(|i| i.weight).sum();
    list.iter_mut().take(1).for_each(|i| i.weight = 1.0 - others);
    list
}

/// A rig of joints (name, world position, parent) without rotations at rest, one slot per joint.
fn assemble(mesh: &Mesh, joints: Vec<(String, DVec3, Option<usize>)>, influences: Vec<Vec<Influence>>) -> Rig {
    let slots = joints.iter().enumerate();
    let slots = slots.map(|(joint, j)| Slot { joint, inverse_bind: DAffine3::from_translation(-j.1) }).collect();
    let influences = influences.into_iter().map(on_grid).collect();
    let places: Vec<DVec3> = joints.iter().map(|j| j.1).collect();
    let joints = joints
        .into_iter()
        .map(|(name, position, parent)| {
            let origin = parent.map_or(DVec3::ZERO, |p| places[p]);
            let rest = Transform { translation: position - origin, ..Transform::IDENTITY };
            Joint { name, parent, rest, node: None }
        })
        .collect();
    Rig { skeleton: Skeleton { joints }, skin: Skin { slots, bind_positions: mesh.positions.clone(), influences } }
}
