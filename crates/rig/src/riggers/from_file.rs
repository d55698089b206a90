//! A rig made elsewhere: RigNet's `rig.txt`, or the skin of a GLB (UniRig, Puppeteer, an artist's).

use super::{RigError, RigOptions, Rigger, on_grid};
use animimic_scene::io::{self, orphans, rig_txt};
use animimic_scene::{Asset, Influence, Rig, Skin, Slot};

pub(crate) struct FromFile;

impl Rigger for FromFile {
    fn name(&self) -> &'static str {
        "from-file"
    }

    fn summary(&self) -> &'static str {
        "the rig of another file: rig.txt of the same vertices, or a rigged GLB of the same shape"
    }

    fn rig(&self, asset: &Asset, options: &RigOptions) -> Result<Rig, RigError> {
        let path = options.file.as_deref().ok_or(RigError::FileMissing)?;
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt")) {
            let text = rig_txt::read(path)?;
            let count = asset.mesh.positions.len();
            let own = || ((0..count as u32).collect(), count);
            let (raw, count) = options.raw_vertices.clone().unwrap_or_else(own);
            let mut copy = Asset { mesh: asset.mesh.clone(), ..Asset::default() };
            rig_txt::apply(&text, &mut copy, &raw, count).map_err(|e| e.in_file(path))?;
            return Ok(copy.rig);
        }
        let other = io::read(path)?;
        if !other.rig.is_articulated() {
            return Err(RigError::NoSkeleton(path.to_owned()));
        }
        Ok(transferred(&other, asset))
    }
}

/// The other asset's rig as displayed, bound to this mesh: each vertex takes the weights of the other's nearest one.
fn transferred(other: &Asset, asset: &Asset) -> Rig {
    let mut skeleton = other.rig.skeleton.clone();
    skeleton.joints.iter_mut().for_each(|j| j.node = None);
    let world = skeleton.rest_world();
    let slots = &other.rig.skin.slots;
    let given = other.mesh.positions.len();
    let positions: Vec<_> = other.mesh.positions.iter().chain(&asset.mesh.positions).copied().collect();
    let mut lists: Vec<Vec<Influence>> = other.rig.skin.influences.clone();
    lists.iter_mut().flatten().for_each(|i| i.slot = slots[i.slot as usize].joint as u32);
    lists.resize(positions.len(), Vec::new());
    orphans::adopt(&positions, &mut lists);
    let influences = lists.split_off(given).into_iter().map(|l| on_grid(merged(l))).collect();
    let bind = |joint: usize| Slot { joint, inverse_bind: world[joint].inverse() };
    let slots = (0..world.len()).map(bind).collect();
    Rig { skeleton, skin: Skin { slots, bind_positions: asset.mesh.positions.clone(), influences } }
}

/// One entry per joint, largest first: several skins of a file may name the same joint.
fn merged(list: Vec<Influence>) -> Vec<Influence> {
    let mut out: Vec<Influence> = Vec::new();
    for i in list {
        match out.iter_mut().find(|o| o.slot == i.slot) {
            Some(o) => o.weight += i.weight,
            None => out.push(i),
        }
    }
    out.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.slot.cmp(&b.slot)));
    out
}
