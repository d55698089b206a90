//! The recorded benchmark scene: a skinned quadruped with vertex colours, its pose parameters and their adjoint.

use animimic_render::Surface;
use animimic_scene::io::npz::{self, Archive};
use animimic_scene::{Camera, Look, Mesh, Part};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::path::Path;

/// One mesh of the benchmark with its rig.
pub struct Quadruped {
    /// Unlit, coloured surface.
    pub surface: Surface,
    rest: Vec<DVec3>,
    influences: Vec<[(usize, f64); 4]>,
    joints: Vec<DVec3>,
    parents: Vec<Option<usize>>,
    rotations: Vec<f64>,
    offsets: Vec<f64>,
    view_from_world: DAffine3,
    focal_over_size: f64,
}

/// Local rotations and root offset.
#[derive(Clone)]
pub struct QuadrupedPose {
    /// Local rotation \[joint\].
    pub rotations: Vec<DQuat>,
    /// Root offset [m].
    pub offset: DVec3,
}

fn numbers(archive: &Archive, name: &str) -> Vec<f64> {
    archive.need(name).expect("the benchmark's file has this array").to_f64()
}

fn points(values: &[f64]) -> Vec<DVec3> {
    values.chunks(3).map(DVec3::from_slice).collect()
}

impl Quadruped {
    /// Reads `quad_NAME.npz`.
    pub fn read(folder: &Path, name: &str) -> Self {
        let file = npz::read(folder.join(format!("quad_{name}.npz"))).expect("the benchmark's scene is readable");
        let rest = points(&numbers(&file, "verts"));
        let triangles: Vec<[u32; 3]> =
            numbers(&file, "faces").chunks(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]).collect();
        let colors = numbers(&file, "colors").chunks(3).map(|c| [c[0] as f32, c[1] as f32, c[2] as f32]).collect();
        let part = Part { vertices: 0..rest.len(), triangles: 0..triangles.len(), ..Part::default() };
        let mesh = Mesh { positions: rest.clone(), triangles, colors, parts: vec![part], ..Mesh::default() };
        let look = Look { unlit: true, double_sided: true, ..Look::default() };
        let (index, weight) = (numbers(&file, "skin_idx"), numbers(&file, "skin_w"));
        let influences = index
            .chunks(4)
            .zip(weight.chunks(4))
            .map(|(i, w)| std::array::from_fn(|k| (i[k] as usize, w[k])))
            .collect();
        let rotation = DMat3::from_cols_slice(&numbers(&file, "cam_R")).transpose();
        let translation = DVec3::from_slice(&numbers(&file, "cam_t"));
        Self {
            surface: Surface::new(&mesh, &[look]).expect("the benchmark's mesh is sound"),
            rest,
            influences,
            joints: points(&numbers(&file, "joints")),
            parents: numbers(&file, "parents").iter().map(|&p| (p >= 0.0).then_some(p as usize)).collect(),
            rotations: numbers(&file, "aa"),
            offsets: numbers(&file, "trans"),
            view_from_world: DAffine3::from_mat3_translation(rotation, translation),
            focal_over_size: numbers(&file, "focal_over_size")[0],
        }
    }

    /// The benchmark's camera at an image size.
    pub fn camera(&self, size: u32) -> Camera {
        let (f, c) = (self.focal_over_size * f64::from(size), 0.5 * f64::from(size));
        Camera { width: size, height: size, fx: f, fy: f, cx: c, cy: c, view_from_world: self.view_from_world }
    }

    /// The recorded pose of a frame.
    pub fn pose(&self, frame: usize) -> QuadrupedPose {
        let n = 3 * self.joints.len();
        let rotations = self.rotations[frame * n..(frame + 1) * n].chunks(3);
        QuadrupedPose {
            rotations: rotations.map(|r| DQuat::from_scaled_axis(DVec3::from_slice(r))).collect(),
            offset: DVec3::from_slice(&self.offsets[3 * frame..3 * frame + 3]),
        }
    }

    /// Rotation and position of every joint.
    fn joints_of(&self, pose: &QuadrupedPose) -> Vec<(DMat3, DVec3)> {
        let mut world: Vec<(DMat3, DVec3)> = Vec::new();
        for (j, r) in pose.rotations.iter().enumerate() {
            let local = DMat3::from_quat(*r);
            world.push(match self.parents[j] {
                None => (local, self.joints[j] + pose.offset),
                Some(p) => {
                    let (parent, origin) = world[p];
                    (parent * local, origin + parent * (self.joints[j] - self.joints[p]))
                }
            });
        }
        world
    }

    /// Vertices of a pose.
    pub fn vertices(&self, pose: &QuadrupedPose) -> Vec<DVec3> {
        let world = self.joints_of(pose);
        self.rest
            .iter()
            .zip(&self.influences)
            .map(|(&v, influences)| influences.iter().map(|&(j, w)| self.carried(&world, j, v) * w).sum())
            .collect()
    }

    fn carried(&self, world: &[(DMat3, DVec3)], j: usize, v: DVec3) -> DVec3 {
        world[j].0 * (v - self.joints[j]) + world[j].1
    }

    /// Adjoint of [`Quadruped::vertices`] for R_j ← R_j exp δ_j at δ = 0, joint by joint, then the root offset: 93 numbers.
    pub fn pose_vjp(&self, pose: &QuadrupedPose, d_vertices: &[DVec3]) -> Vec<f64> {
        let world = self.joints_of(pose);
        // Per joint: force Σ w d and its moment Σ w (x_j − c_j) × d about the joint, both handed on to the ancestors.
        let n = self.joints.len();
        let (mut force, mut moment) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
        for ((&v, influences), &d) in self.rest.iter().zip(&self.influences).zip(d_vertices) {
            for &(j, w) in influences {
                force[j] += d * w;
                moment[j] += (self.carried(&world, j, v) - world[j].1).cross(d) * w;
            }
        }
        for j in (0..n).rev() {
            if let Some(p) = self.parents[j] {
                let (f, m) = (force[j], moment[j]);
                force[p] += f;
                moment[p] += m + (world[j].1 - world[p].1).cross(f);
            }
        }
        let mut g: Vec<f64> = (0..n).flat_map(|j| (world[j].0.transpose() * moment[j]).to_array()).collect();
        g.extend(force[0].to_array());
        g
    }
}
