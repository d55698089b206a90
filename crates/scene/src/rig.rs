//! Skeleton, skin and the rig they form.
//!
//! One description serves skinned meshes, rigid parts hung on bones and static models under transformed parents: every
//! scene node that moves a vertex (and its ancestors) is a [`Joint`]; every vertex lists influences by [`Slot`], a joint
//! with an inverse bind matrix. A rigid part is a slot with the identity as inverse bind.

use crate::Pose;
use glam::{DAffine3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Translation, rotation and scale of a joint relative to its parent: `T · R · S` as in glTF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Translation [model unit].
    pub translation: DVec3,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Scale per axis.
    pub scale: DVec3,
}

impl Transform {
    /// No motion.
    pub const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };

    /// The same as an affine map.
    pub fn affine(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }

    /// Nearest TRS of an affine map (shear is lost).
    pub fn from_affine(a: DAffine3) -> Self {
        let (scale, rotation, translation) = a.to_scale_rotation_translation();
        Self { translation, rotation: rotation.normalize(), scale }
    }
}

/// One joint of a [`Skeleton`].
#[derive(Clone, Debug)]
pub struct Joint {
    /// Name in the file.
    pub name: String,
    /// Parent joint; always smaller than the joint's own index. `None` for a root.
    pub parent: Option<usize>,
    /// Local transform in the rest pose (the file as displayed).
    pub rest: Transform,
    /// glTF node index, where the rig came from or goes to a GLB.
    pub node: Option<usize>,
}

/// Joints in topological order (parents first). Several roots are allowed.
#[derive(Clone, Debug, Default)]
pub struct Skeleton {
    /// The joints.
    pub joints: Vec<Joint>,
}

impl Skeleton {
    /// World transform of every joint for some local transforms. `locals` \[joint\].
    pub fn world_from_joint(&self, locals: &[Transform]) -> Vec<DAffine3> {
        let mut world: Vec<DAffine3> = Vec::with_capacity(self.joints.len());
        for (joint, local) in self.joints.iter().zip(locals) {
            let parent = joint.parent.map_or(DAffine3::IDENTITY, |p| world[p]);
            world.push(parent * local.affine());
        }
        world
    }

    /// The local transforms of the rest pose.
    pub fn rest_locals(&self) -> Vec<Transform> {
        self.joints.iter().map(|j| j.rest).collect()
    }

    /// World transform of every joint in the rest pose.
    pub fn rest_world(&self) -> Vec<DAffine3> {
        self.world_from_joint(&self.rest_locals())
    }
}

/// A joint together with the inverse bind matrix with which it moves vertices.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// Joint index.
    pub joint: usize,
    /// `joint_from_vertex_buffer`: maps stored vertex positions into the joint's space at bind time.
    pub inverse_bind: DAffine3,
}

/// One influence of a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Influence {
    /// Index into [`Skin::slots`].
    pub slot: u32,
    /// Weight in \[0, 1\]; the weights of a vertex sum to 1.
    pub weight: f64,
}

/// Skin weights: which slots move a vertex, and how much.
#[derive(Clone, Debug, Default)]
pub struct Skin {
    /// All slots of all skins of the file.
    pub slots: Vec<Slot>,
    /// Positions as stored in the vertex buffer (bind space), per vertex.
    pub bind_positions: Vec<DVec3>,
    /// Influences \[vertex\], largest first, weights summing to 1; never empty.
    pub influences: Vec<Vec<Influence>>,
}

impl Skin {
    /// The joint that moves a vertex most; `None` for a vertex without influences.
    pub fn main_joint(&self, vertex: usize) -> Option<usize> {
        let most = self.influences.get(vertex)?.iter().max_by(|a, b| a.weight.total_cmp(&b.weight))?;
        Some(self.slots[most.slot as usize].joint)
    }
}

/// A skeleton and a skin: all that is needed to pose a mesh.
#[derive(Clone, Debug, Default)]
pub struct Rig {
    /// The joints.
    pub skeleton: Skeleton,
    /// The weights.
    pub skin: Skin,
}

impl Rig {
    /// All vertices in the rest pose: the model as displayed.
    pub fn at_rest(&self) -> Vec<DVec3> {
        self.skinned(&self.skeleton.rest_world())
    }

    /// All vertices in a pose.
    pub fn in_pose(&self, pose: &Pose) -> Vec<DVec3> {
        self.skinned(&self.skeleton.world_from_joint(&pose.locals))
    }

    /// Skins all vertices for some world transforms of the joints (linear blend skinning): x_v = Σ_k w_k G_k B_k X_v.
    pub fn skinned(&self, world_from_joint: &[DAffine3]) -> Vec<DVec3> {
        let slots: Vec<DAffine3> = self.skin.slots.iter().map(|s| world_from_joint[s.joint] * s.inverse_bind).collect();
        self.skin
            .influences
            .iter()
            .zip(&self.skin.bind_positions)
            .map(|(influences, &x)| {
                influences.iter().map(|i| slots[i.slot as usize].transform_point3(x) * i.weight).sum()
            })
            .collect()
    }

    /// Whether the rig can deform anything: more than one joint carries weight, or a joint carries only part of the mesh.
    pub fn is_articulated(&self) -> bool {
        let mut joints: Vec<usize> =
            self.skin.influences.iter().flatten().map(|i| self.skin.slots[i.slot as usize].joint).collect();
        joints.sort_unstable();
        joints.dedup();
        joints.len() > 1
    }
}
