//! The model that is fitted: everything about it that does not change from frame to frame.

use super::balls::Balls;
use super::layers::Layers;
use animimic_render::{RenderError, Surface};
use animimic_rig::limbs::{Limb, align_hinges, lateral, limbs};
use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::solve_tree::SolveTree;
use animimic_rig::{Anchor, FramePose, Posed};
use animimic_scene::{Asset, Pose};
use glam::DVec3;
use std::sync::OnceLock;

/// A rigged, textured model made ready for fitting.
pub struct Subject<'a> {
    /// What was read.
    pub asset: &'a Asset,
    /// The tree that is solved.
    pub tree: SolveTree,
    /// One anchor per vertex.
    pub vertices: Vec<Anchor>,
    /// Ready to draw.
    pub surface: Surface,
    /// Pseudo-anchors of all vertices, for smoothness.
    pub pseudo: Vec<Anchor>,
    /// Chains that can be swung as a whole.
    pub limbs: Vec<Limb>,
    /// The surface in two parts for each of them, made when first asked for.
    layers: OnceLock<Vec<Layers>>,
    /// Sideways direction of the body, if its limbs tell.
    pub lateral: Option<DVec3>,
    /// Balls that keep parts from passing through each other.
    pub balls: Balls,
    /// Rest diagonal [model unit].
    pub diagonal: f64,
}

impl<'a> Subject<'a> {
    /// Prepares an asset.
    ///
    /// # Errors
    /// When the mesh cannot be drawn.
    pub fn new(asset: &'a Asset) -> Result<Self, RenderError> {
        let tree = SolveTree::new(&asset.rig, &asset.mesh);
        let vertices = tree.vertex_anchors(&asset.rig);
        let pseudo = pseudo_anchors(&vertices, tree.kinematics.len());
        let diagonal = asset.mesh.diagonal();
        let mut limbs = limbs(&tree.kinematics, &tips(&tree, &vertices, &asset.mesh.positions), diagonal);
        let lateral = lateral(&tree.kinematics, &limbs);
        lateral.into_iter().for_each(|l| align_hinges(&tree.kinematics, &mut limbs, l));
        Ok(Self {
            lateral,
            limbs,
            layers: OnceLock::new(),
            surface: Surface::new(&asset.mesh, &asset.looks)?,
            diagonal,
            balls: Balls::new(&vertices, &asset.mesh.positions, tree.kinematics.len()),
            asset,
            tree,
            vertices,
            pseudo,
        })
    }

    /// The surface in two parts: limb number `limb`, and the rest.
    pub fn layers(&self, limb: usize) -> &Layers {
        &self.layers.get_or_init(|| self.limbs.iter().map(|l| Layers::new(self, l)).collect())[limb]
    }

    /// Forward kinematics.
    pub fn posed(&self, pose: &FramePose) -> Posed {
        self.tree.kinematics.pose(pose)
    }

    /// Posed vertices [model unit].
    pub fn skinned(&self, posed: &Posed) -> Vec<DVec3> {
        self.vertices.iter().map(|a| a.position(posed)).collect()
    }

    /// The file's pose for a solved frame.
    pub fn file_pose(&self, pose: &FramePose) -> Pose {
        self.tree.pose(&self.asset.rig, pose)
    }
}

/// The vertex farthest from each joint among those that follow it most; the joint itself where there is none.
fn tips(tree: &SolveTree, vertices: &[Anchor], positions: &[DVec3]) -> Vec<DVec3> {
    let mut tips = tree.kinematics.pivots.clone();
    for (anchor, &x) in vertices.iter().zip(positions) {
        let j = anchor.main_joint();
        let pivot = tree.kinematics.pivots[j];
        if x.distance(pivot) > tips[j].distance(pivot) {
            tips[j] = x;
        }
    }
    tips
}
