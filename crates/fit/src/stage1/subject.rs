//! The model that is fitted: everything about it that does not change from frame to frame.

use animimic_rig::smoothness::pseudo_anchors;
use animimic_rig::solve_tree::SolveTree;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Posed};
use animimic_render::{RenderError, Surface};
use animimic_scene::{Asset, Pose};
use glam::DVec3;

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
    /// Their Jacobian structure.
    pub pseudo_columns: Vec<AnchorColumns>,
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
        let pseudo_columns = pseudo.iter().map(|a| a.columns(&tree.kinematics)).collect();
        Ok(Self {
            surface: Surface::new(&asset.mesh, &asset.looks)?,
            diagonal: asset.mesh.diagonal(),
            asset,
            tree,
            vertices,
            pseudo,
            pseudo_columns,
        })
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
