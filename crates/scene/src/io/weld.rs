//! Joining of vertices that seams split: equal position, and equal influences so that they stay together in every pose.

use crate::rig::Skin;
use glam::DVec3;
use std::collections::HashMap;

/// Vertex → welded vertex (numbered by first occurrence) and their number, by exact stored position and exact influences.
pub fn by_bind_and_influences(skin: &Skin) -> (Vec<u32>, usize) {
    number(skin.bind_positions.iter().zip(&skin.influences).map(|(&x, influences)| {
        let list: Vec<(u32, u64)> = influences.iter().map(|i| (i.slot, i.weight.to_bits())).collect();
        (bits(x), list)
    }))
}

/// Vertex → welded vertex (numbered by first occurrence) and their number, by exact position.
pub fn by_position(positions: &[DVec3]) -> (Vec<u32>, usize) {
    number(positions.iter().map(|&x| bits(x)))
}

/// Bits that are equal exactly when the points are (−0 equals 0).
fn bits(x: DVec3) -> [u64; 3] {
    [x.x, x.y, x.z].map(|c| (c + 0.0).to_bits())
}

fn number<K: std::hash::Hash + Eq>(keys: impl Iterator<Item = K>) -> (Vec<u32>, usize) {
    // The map is only looked up, never iterated: the numbering does not depend on its order.
    let mut seen: HashMap<K, u32> = HashMap::new();
    let welded = keys
        .map(|key| {
            let next = seen.len() as u32;
            *seen.entry(key).or_insert(next)
        })
        .collect();
    (welded, seen.len())
}
