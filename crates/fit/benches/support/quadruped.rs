//! The recorded benchmark scene: a skinned quadruped with vertex colours, its motion and its camera.

use animimic_math::so3;
use animimic_render::Surface;
use animimic_rig::anchor::Share;
use animimic_rig::{Anchor, FramePose, Kinematics, pose_vjp};
use animimic_scene::io::npz::{self, Archive};
use animimic_scene::{Camera, Look, Mesh, Part};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// One mesh of the benchmark with its rig.
pub struct Quadruped {
    /// Coloured surface.
    pub surface: Surface,
    /// The tree: every joint turns, the root slides too.
    pub kinematics: Kinematics,
    /// One anchor per vertex.
    pub vertices: Vec<Anchor>,
    /// Axis-angle rotations \[frame · joint\].
    rotations: Vec<DVec3>,
    /// Root offsets \[frame\] [m].
    offsets: Vec<DVec3>,
    view_from_world: DAffine3,
    focal_over_size: f64,
}

/// An array of the benchmark's file.
pub fn numbers(archive: &Archive, name: &str) -> Vec<f64> {
    archive.need(name).expect("the benchmark's file has this array").to_f64()
}

/// The same as points.
pub fn points(archive: &Archive, name: &str) -> Vec<DVec3> {
    numbers(archive, name).chunks_exact(3).map(DVec3::from_slice).collect()
}

/// The anchor of a rest point with some weights, by joint.
pub fn anchor(x: DVec3, weights: impl Iterator<Item = (usize, f64)>) -> Anchor {
    let share = |(joint, weight): (usize, f64)| Share { joint, weight, weighted_rest: x * weight };
    let mut shares: Vec<Share> = weights.filter(|(_, w)| *w > 0.0).map(share).collect();
    shares.sort_by_key(|s| s.joint);
    Anchor { shares }
}

impl Quadruped {
    /// Reads `quad_NAME.npz`; the surface looks like `look`.
    pub fn read(folder: &Path, name: &str, look: Look) -> Self {
        let file = npz::read(folder.join(format!("quad_{name}.npz"))).expect("the benchmark's scene is readable");
        let positions = points(&file, "verts");
        let (index, weight) = (numbers(&file, "skin_idx"), numbers(&file, "skin_w"));
        let skin = |v: usize| (4 * v..4 * v + 4).map(|k| (index[k] as usize, weight[k]));
        let vertices = positions.iter().enumerate().map(|(v, &x)| anchor(x, skin(v))).collect();
        let triangles: Vec<[u32; 3]> =
            numbers(&file, "faces").chunks(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]).collect();
        let colors = numbers(&file, "colors").chunks(3).map(|c| [c[0] as f32, c[1] as f32, c[2] as f32]).collect();
        let part = Part { vertices: 0..positions.len(), triangles: 0..triangles.len(), ..Part::default() };
        let mesh = Mesh { positions, triangles, colors, parts: vec![part], ..Mesh::default() };
        let parents: Vec<Option<usize>> =
            numbers(&file, "parents").iter().map(|&p| (p >= 0.0).then_some(p as usize)).collect();
        let (turns, slides) = (vec![true; parents.len()], parents.iter().map(Option::is_none).collect());
        let rotation = DMat3::from_cols_slice(&numbers(&file, "cam_R")).transpose();
        let translation = DVec3::from_slice(&numbers(&file, "cam_t"));
        Self {
            surface: Surface::new(&mesh, &[look]).expect("the benchmark's mesh is sound"),
            kinematics: Kinematics::new(parents, points(&file, "joints"), turns, slides),
            vertices,
            rotations: points(&file, "aa"),
            offsets: points(&file, "trans"),
            view_from_world: DAffine3::from_mat3_translation(rotation, translation),
            focal_over_size: numbers(&file, "focal_over_size")[0],
        }
    }

    /// The benchmark's camera at an image size.
    pub fn camera(&self, size: u32) -> Camera {
        let (f, c) = (self.focal_over_size * f64::from(size), 0.5 * f64::from(size));
        Camera { width: size, height: size, fx: f, fy: f, cx: c, cy: c, view_from_world: self.view_from_world }
    }

    /// Number of recorded frames.
    pub fn frames(&self) -> usize {
        self.offsets.len()
    }

    /// The recorded pose of a frame.
    pub fn pose(&self, frame: usize) -> FramePose {
        let mut pose = self.kinematics.rest();
        let n = self.kinematics.len();
        pose.rotations = self.rotations[frame * n..(frame + 1) * n].iter().map(|&r| so3::exp(r)).collect();
        pose.displacements[0] = self.offsets[frame];
        pose
    }

    /// Vertices of a pose.
    pub fn posed(&self, pose: &FramePose) -> Vec<DVec3> {
        let posed = self.kinematics.pose(pose);
        self.vertices.iter().map(|a| a.position(&posed)).collect()
    }

    /// Adjoint of [`Quadruped::posed`], in the increments of [`Kinematics::retract`].
    pub fn pose_vjp(&self, pose: &FramePose, d_vertices: &[DVec3]) -> Vec<f64> {
        pose_vjp(&self.kinematics, &self.kinematics.pose(pose), &self.vertices, d_vertices)
    }
}

/// Increments in the recordings' order, all rotations and then the root's offset, from the tree's, where the offset comes second.
pub fn recorded_order(increments: &[f64]) -> Vec<f64> {
    [&increments[..3], &increments[6..], &increments[3..6]].concat()
}

/// The way back.
pub fn tree_order(recorded: &[f64]) -> Vec<f64> {
    let offset = recorded.len() - 3;
    [&recorded[..3], &recorded[offset..], &recorded[3..offset]].concat()
}
