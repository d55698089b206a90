//! From a bare mesh to an asset: checks, welding, and one joint that carries everything.

use super::{ReadOptions, SceneError, check_extent, weld};
use crate::rig::{Influence, Joint, Rig, Skeleton, Skin, Slot, Transform};
use crate::{Asset, Look, Mesh, Source};
use glam::{DAffine3, DVec3};

/// Builds an asset of a mesh read from a format without structure of its own.
///
/// `positions`, `triangles`, `parts` and optional attributes of `mesh` are set; the rest is filled in here.
pub(crate) fn asset(
    mut mesh: Mesh,
    looks: Vec<Look>,
    options: &ReadOptions,
    mut warnings: Vec<String>,
) -> Result<Asset, SceneError> {
    check_vertices(&mut mesh, options, &mut warnings)?;
    check_extent(&mesh)?;
    let rig = single_joint(&mesh.positions);
    let (welded, welded_count) = weld::by_position(&mesh.positions);
    mesh.welded = welded;
    mesh.welded_count = welded_count;
    Ok(Asset { mesh, looks, rig, motions: Vec::new(), source: Source::Plain, warnings })
}

/// One joint at the origin that carries all vertices.
fn single_joint(positions: &[DVec3]) -> Rig {
    let joint = Joint { name: "root".into(), parent: None, rest: Transform::IDENTITY, node: None };
    let skin = Skin {
        slots: vec![Slot { joint: 0, inverse_bind: DAffine3::IDENTITY }],
        bind_positions: positions.to_vec(),
        influences: vec![vec![Influence { slot: 0, weight: 1.0 }]; positions.len()],
    };
    Rig { skeleton: Skeleton { joints: vec![joint] }, skin }
}

/// Refuses (or drops) triangles with vertices that are missing or not finite.
fn check_vertices(mesh: &mut Mesh, options: &ReadOptions, warnings: &mut Vec<String>) -> Result<(), SceneError> {
    // Formats without float limits of their own: beyond f32 nothing can be written back.
    let sound = |p: &DVec3| p.is_finite() && p.abs().max_element() < f64::from(f32::MAX);
    let good: Vec<bool> = mesh.positions.iter().map(sound).collect();
    let usable = |t: &[u32; 3]| t.iter().all(|&i| good.get(i as usize) == Some(&true));
    let bad_vertices = good.iter().filter(|g| !**g).count();
    let bad_triangles = mesh.triangles.iter().filter(|t| !usable(t)).count();
    if bad_vertices + bad_triangles == 0 {
        return Ok(());
    }
    if !options.repair {
        let first = good.iter().position(|g| !g);
        let what = match first {
            Some(v) => format!("{bad_vertices} vertices are not finite, the first is vertex {v}"),
            None => format!("{bad_triangles} triangles use vertices that do not exist"),
        };
        return Err(SceneError::invalid("", format!("{what}; use --repair to drop them")));
    }
    warnings.push(format!("repaired: dropped {bad_triangles} triangles, {bad_vertices} vertices are not finite"));
    let stand_in = mesh.positions.iter().copied().find(sound).unwrap_or(DVec3::ZERO);
    mesh.positions.iter_mut().zip(&good).filter(|(_, g)| !**g).for_each(|(p, _)| *p = stand_in);
    let mut kept = Vec::with_capacity(mesh.triangles.len());
    for part in &mut mesh.parts {
        let first = kept.len();
        kept.extend(mesh.triangles[part.triangles.clone()].iter().filter(|t| usable(t)));
        part.triangles = first..kept.len();
    }
    mesh.triangles = kept;
    Ok(())
}
