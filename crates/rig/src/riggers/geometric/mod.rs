//! A skeleton and weights from the shape alone.
//!
//! surface → solid voxels ([`solid`]) → curve skeleton ([`medial`]), halved where the shape is symmetric ([`symmetry`]) → trunk and limbs
//! ([`chains`]) → what is what ([`anatomy`]) → joints ([`joints`]) → weights through the solid ([`weights`]).

mod anatomy;
mod bends;
mod chains;
mod grid;
mod joints;
mod medial;
mod names;
mod pairs;
mod solid;
mod symmetry;
mod tips;
mod weights;

use super::{RigError, RigOptions, Rigger, assemble, one_bone};
use anatomy::Anatomy;
use animimic_scene::solid::{Soup, WindingNumber};
use animimic_scene::{Asset, Mesh, Rig};
use chains::Graph;
use glam::DVec3;
use joints::Draft;
use medial::MedialTree;
use solid::Solid;
use symmetry::Mirror;
use weights::Seeds;

/// The rigger.
pub(crate) struct Geometric;

impl Rigger for Geometric {
    fn name(&self) -> &'static str {
        "geometric"
    }

    fn summary(&self) -> &'static str {
        "curve skeleton of the solid, joints where limbs bend, weights through the solid; any surface"
    }

    fn rig(&self, asset: &Asset, options: &RigOptions) -> Result<Rig, RigError> {
        rig(&asset.mesh, options)
    }
}

/// A joint to be, with what it moves.
pub(crate) struct Placed {
    pub name: String,
    pub position: DVec3,
    pub parent: Option<usize>,
    pub seeds: Vec<(DVec3, f64)>,
}

/// A rig has this many joints at most; where more come out, the level of detail is lowered by this factor until they do not.
const MOST_JOINTS: usize = 80;
const COARSER: f64 = 0.7;
const TRIES: usize = 6;

fn rig(mesh: &Mesh, options: &RigOptions) -> Result<Rig, RigError> {
    let soup = Soup::new(mesh)?;
    let longest = (soup.bounds[1] - soup.bounds[0]).max_element();
    let mirror = Mirror::find(&soup, longest);
    let exact = mirror.as_ref().filter(|m| m.exact);
    let winding = WindingNumber::new(&soup);
    let solid = Solid::new(&soup, &winding, exact.and_then(Mirror::axis));
    let found = (0..TRIES as i32)
        .map(|k| placed(&solid, &soup, longest, mirror.as_ref(), options.fineness() * COARSER.powi(k)))
        .find(|joints| joints.len() <= MOST_JOINTS);
    let Some(joints) = found.filter(|joints| joints.len() > 1) else { return Ok(one_bone::rig(mesh)) };
    let seeds: Seeds =
        joints.iter().enumerate().flat_map(|(j, p)| p.seeds.iter().map(move |&(c, r)| (j, c, r))).collect();
    let influences = weights::weights(&solid, &soup, mesh, &seeds, joints.len());
    Ok(assemble(mesh, joints.into_iter().map(|p| (p.name, p.position, p.parent)).collect(), influences))
}

/// All joints of a solid.
fn placed(solid: &Solid, soup: &Soup, longest: f64, mirror: Option<&Mirror>, fineness: f64) -> Vec<Placed> {
    let exact = mirror.filter(|m| m.exact);
    let tree = MedialTree::new(solid, longest, fineness, exact);
    let graph = Graph::new(&tree, longest);
    let anatomy = Anatomy::new(&graph, mirror, [soup.bounds[0].y, soup.bounds[1].y]);
    let drafts = joints::joints(&graph, &anatomy, mirror, fineness);
    let sides = names::sides(&graph, &anatomy, &drafts, mirror);
    names::named(mirrored(drafts, &sides, exact), mirror.map(|m| m.normal.dot(anatomy.left)))
}

/// All joints of a half body: each lateral one is followed by its image. Side: +1 where the plane's normal points to.
fn mirrored(drafts: Vec<Draft>, sides: &[i8], exact: Option<&Mirror>) -> Vec<(Draft, i8)> {
    let mut out: Vec<(Draft, i8)> = Vec::new();
    // Index of each draft in `out`, and of its image.
    let mut place: Vec<(usize, usize)> = Vec::new();
    for (draft, &side) in drafts.into_iter().zip(sides) {
        let at = out.len();
        let parent = draft.parent;
        let lateral = draft.lateral;
        let twin = exact.filter(|_| lateral).map(|m| Draft {
            position: m.image(draft.position),
            seeds: draft.seeds.iter().map(|&(c, r)| (m.image(c), r)).collect(),
            parent: parent.map(|p| place[p].1),
            ..draft.clone()
        });
        // What crosses the plane within a central part belongs to both halves.
        out.push((Draft { parent: parent.map(|p| place[p].0), ..draft }, side));
        place.push((at, if twin.is_some() { at + 1 } else { at }));
        out.extend(twin.map(|t| (t, -side)));
    }
    out
}
