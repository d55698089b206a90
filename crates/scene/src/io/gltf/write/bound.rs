//! Which joints a file shows elsewhere than where they are bound.
//!
//! Programs that keep a bind pose (Blender, Unreal) put a joint back there where a clip has no key for it; the clip then plays differently after
//! an export of theirs. So these joints get keys also where they stand still. Where a joint is bound is what importers make of it: its
//! inverse bind matrix inverted, relative to that of its parent; a joint whose parent binds nothing stands where its node puts it.

use super::animation::Moves;
use super::bin::Output;
use crate::Asset;
use crate::io::SceneError;
use crate::io::gltf::json::Place;
use crate::rig::Transform;
use glam::{DAffine3, DMat4, DVec3};
use std::collections::BTreeMap;

/// Differences up to this are rounding: as a share of the diagonal [rad, or of the scale].
const SAME: f64 = 1e-5;

/// Whether translation, rotation and scale of each joint at rest differ from those of its bind pose in the document.
pub(super) fn away_from_bind(out: &Output, asset: &Asset, node_of_joint: &[usize]) -> Vec<Moves> {
    let (inverse_binds, diagonal) = (inverse_binds(out), asset.mesh.diagonal());
    let of = |j: usize| inverse_binds.get(&node_of_joint[j]);
    let joints = asset.rig.skeleton.joints.iter().enumerate();
    let away = joints.map(|(j, joint)| match (joint.parent.and_then(of), of(j)) {
        (Some(parent), Some(own)) => differences(&joint.rest, &(*parent * own.inverse()), diagonal),
        _ => [false; 3],
    });
    away.collect()
}

fn differences(rest: &Transform, bound: &DAffine3, diagonal: f64) -> Moves {
    if !bound.is_finite() {
        return [true; 3];
    }
    let bound = Transform::from_affine(*bound);
    let apart = |a: DVec3, b: DVec3| (a - b).abs().max_element();
    [
        apart(rest.translation, bound.translation) > SAME * diagonal,
        rest.rotation.angle_between(bound.rotation) > SAME,
        apart(rest.scale, bound.scale) > SAME * rest.scale.abs().max_element(),
    ]
}

/// The inverse bind matrix of every node that is a joint of a skin, the last skin's; none of skins whose matrices cannot be read.
fn inverse_binds(out: &Output) -> BTreeMap<usize, DAffine3> {
    let document = out.document();
    let of_skin = |skin: &Place| -> Result<Vec<(usize, DAffine3)>, SceneError> {
        let matrices = document.numbers(&skin.need("inverseBindMatrices")?)?;
        let joints = skin.list("joints")?.iter().map(Place::usize).collect::<Result<Vec<_>, _>>()?;
        let matrix = |m: &[f64]| DAffine3::from_mat4(DMat4::from_cols_slice(m));
        Ok(joints.into_iter().zip(matrices.rows().filter(|m| m.len() == 16).map(matrix)).collect())
    };
    document.root.list("skins").into_iter().flatten().filter_map(|skin| of_skin(&skin).ok()).flatten().collect()
}
