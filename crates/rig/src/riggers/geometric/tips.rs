//! Where a solid ends: the persistent maxima of the distance from its middle.
//!
//! Let the level of a cell be its distance from a central one, measured through the solid. Going down from the farthest cells, the parts of
//! the solid above the level grow and meet. A part that has grown long before it meets an older one is a limb; a corner of a body, of a
//! fin or of a cape is not, because it meets its surroundings at once (persistence of connected components, Edelsbrunner et al. 2002,
//! of the function whose level sets give the Reeb graph of a limb structure).

use super::solid::Solid;
use animimic_scene::solid::UnionFind;

/// An end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tip {
    pub cell: u32,
    /// Level at which its part meets another that is an end as well: the height of a crotch or an armpit. 0 if none does.
    pub meets: f64,
}

/// Ends that stick out by `least` at least, the farthest first.
pub(crate) fn tips(solid: &Solid, level: &[f64], least: f64) -> Vec<Tip> {
    let mut order: Vec<u32> = (0..solid.len() as u32).collect();
    order.sort_by(|&a, &b| level[b as usize].total_cmp(&level[a as usize]).then(a.cmp(&b)));
    let mut rank = vec![0u32; solid.len()];
    order.iter().enumerate().for_each(|(r, &c)| rank[c as usize] = r as u32);
    // Sets of ranks: the smaller root, which is the farther cell, names a set.
    let mut sets = UnionFind::new(solid.len());
    let mut found: Vec<Tip> = vec![Tip { cell: order[0], meets: 0.0 }];
    for (r, &cell) in order.iter().enumerate() {
        let mut roots: Vec<usize> = Vec::new();
        solid.each_neighbour(cell, |n, _| {
            if (rank[n as usize] as usize) < r {
                roots.push(sets.find(rank[n as usize] as usize));
            }
        });
        roots.sort_unstable();
        roots.dedup();
        let here = level[cell as usize];
        let mut met = false;
        for &young in roots.iter().skip(1) {
            let top = order[young];
            if level[top as usize] - here >= least {
                found.push(Tip { cell: top, meets: here });
                met = true;
            }
        }
        if let (true, Some(old)) = (met, roots.first()) {
            // The older part ends its own limb here too, unless it met another one farther out.
            if let Some(t) = found.iter_mut().find(|t| t.cell == order[*old] && t.meets == 0.0) {
                t.meets = here;
            }
        }
        roots.into_iter().for_each(|root| sets.join(root, r));
    }
    found.sort_by_key(|t| rank[t.cell as usize]);
    found
}
