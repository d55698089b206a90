//! Tetrahedral cages for any triangle mesh: closed or open, self-intersecting, of many parts, thin, with shells inside.
//!
//! The tets are those of a body-centred cubic lattice that the solid (generalised winding number above one half) or the surface
//! meets, all of one good shape. Where the lattice is coarser than the model, a tet is there once for every part of the
//! surface that passes through it on its own: fingers and legs never share one, and what is thinner than a tet still hangs together as
//! the surface does.
//!
//! Sources: winding numbers Jacobson et al. 2013, Barill et al. 2018; virtual nodes Molino, Bao and Fedkiw 2004; the lattice
//! Molino et al. 2003. Not fitted to the surface, because the surface is embedded and tets of one shape are the best for dynamics.

mod assemble;
mod lattice;
mod pieces;
mod quality;
mod regions;

pub use quality::{Quality, quality};

use crate::error::SimError;
use animimic_scene::solid::{Soup, SurfaceError, WindingNumber};
use animimic_scene::{Embedding, Mesh, TetMesh};
use assemble::Filling;
use glam::DVec3;
use lattice::Lattice;

/// Tets when nothing is said: the reference's scale.
pub const DEFAULT_TETS: usize = 3000;

/// Most tets that can be asked for.
const MOST_TETS: usize = 1_000_000;

/// The number of tets is as asked for within this share.
const NEAR_ENOUGH: f64 = 0.04;

/// Fillings tried at most.
const TRIES: usize = 7;

/// Cubes along the bounding box's diagonal at the first try.
const FIRST_CUBES: f64 = 20.0;

/// Number of tets ∝ spacing to this power, negative: between a shell's 2 and a body's 3.
const EXPONENT: f64 = 2.4;

/// Where the lattice stands relative to the bounding box [cubes]: no round numbers, so that flat sides of models do not lie in its planes.
const OFFSET: DVec3 = DVec3::new(0.377_964_47, 0.288_675_13, 0.447_213_59);

/// A tetrahedral mesh around a surface.
#[derive(Clone, Debug, Default)]
pub struct Cage {
    /// The tets at rest.
    pub mesh: TetMesh,
    /// The surface's vertices (the mesh's own, unwelded) in the tets.
    pub embedding: Embedding,
    /// Side of the lattice's cubes [model unit]; the longest edge of a tet.
    pub spacing: f64,
}

/// A cage of about `tets` tets for a surface.
///
/// # Errors
/// [`SimError::Surface`] where no triangle has an area, coordinates are not finite or indices out of range; `tets` out of range.
pub fn cage(surface: &Mesh, tets: usize) -> Result<Cage, SimError> {
    if !(1..=MOST_TETS).contains(&tets) {
        return Err(SimError::OutOfRange { name: "tets", value: tets as f64, range: "1 to 1000000" });
    }
    let soup = Soup::new(surface)?;
    let winding = WindingNumber::new(&soup);
    let mut joints_of: Vec<Vec<u32>> = vec![Vec::new(); soup.triangles.len()];
    for (k, (pair, _)) in soup.joints.iter().enumerate() {
        pair.iter().for_each(|&t| joints_of[t as usize].push(k as u32));
    }
    let mut spacing = soup.diagonal() / FIRST_CUBES;
    let mut best: Option<(f64, Cage)> = None;
    for _ in 0..TRIES {
        let lattice = Lattice { origin: soup.bounds[0] - OFFSET * spacing, spacing };
        let (mesh, embedding) = Filling::new(&soup, &winding, &joints_of, lattice).assemble();
        let off = (mesh.tets.len() as f64 / tets as f64).ln();
        if best.as_ref().is_none_or(|b| off.abs() < b.0) {
            best = Some((off.abs(), Cage { mesh, embedding, spacing }));
        }
        if off.abs() < NEAR_ENOUGH {
            break;
        }
        spacing *= (off / EXPONENT).exp().clamp(0.3, 3.0);
    }
    best.map(|b| b.1).ok_or(SimError::Surface(SurfaceError::Empty))
}
