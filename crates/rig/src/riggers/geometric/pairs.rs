//! Which limbs are partners, on a body that is symmetric but stands in another pose.
//!
//! Partners lie on either side of the plane, are about as long, and grow about at the same place of the trunk. In mid-stride their places
//! differ, so all limbs are assigned together: the sum of the differences is least.

use super::anatomy::arc;
use super::chains::{Chain, Graph};
use super::symmetry::Mirror;

/// Differences that count 1: of places on the trunk [share of its length], and of lengths [logarithm].
const PLACE: f64 = 0.2;
const LENGTH: f64 = 0.5;

/// A limb without a partner counts this much; so a pair may count twice that.
const ALONE: f64 = 1.2;

/// A limb lies on a side if its outer half is farther from the plane than this share of its radius, on average.
const BESIDE: f64 = 0.3;

/// Limbs of a side that are assigned at most, the longest: a body has no more in pairs.
const MOST: usize = 6;

/// What is compared.
struct Limb {
    chain: usize,
    share: f64,
    length: f64,
}

/// Partner of every chain; `place` is where each begins on the trunk.
pub(crate) fn partners(graph: &Graph, chains: &[Chain], place: &[usize], mirror: &Mirror) -> Vec<Option<usize>> {
    let along = arc(graph, &chains[0].nodes);
    let whole = along[along.len() - 1].max(1e-9 * graph.longest);
    let mut sides: [Vec<Limb>; 2] = [Vec::new(), Vec::new()];
    for (c, chain) in chains.iter().enumerate().filter(|(_, chain)| chain.parent.is_some_and(|p| p.0 == 0)) {
        let side = lean(graph, chain, mirror);
        if side.abs() > BESIDE {
            let limb =
                Limb { chain: c, share: along[place[c]] / whole, length: graph.length(&chain.nodes[chain.exit..]) };
            sides[usize::from(side > 0.0)].push(limb);
        }
    }
    for side in &mut sides {
        side.sort_by(|a, b| b.length.total_cmp(&a.length).then(a.chain.cmp(&b.chain)));
        side.truncate(MOST);
    }
    let mut partner = vec![None; chains.len()];
    let mut best = (f64::INFINITY, Vec::new());
    assign(&sides, 0.0, &mut Vec::new(), &mut best);
    for (a, b) in sides[0].iter().zip(best.1).filter_map(|(a, b)| Some((a, &sides[1][b?]))) {
        partner[a.chain] = Some(b.chain);
        partner[b.chain] = Some(a.chain);
    }
    partner
}

/// Mean signed distance of a chain's outer half from the plane, in its radii.
pub(crate) fn lean(graph: &Graph, chain: &Chain, mirror: &Mirror) -> f64 {
    let outer = &chain.nodes[chain.nodes.len() / 2..];
    let sum = |f: &dyn Fn(usize) -> f64| outer.iter().map(|&k| f(k)).sum::<f64>();
    sum(&|k| mirror.side(graph.at(k))) / sum(&|k| graph.radius(k)).max(f64::MIN_POSITIVE)
}

/// Tries all assignments of the first side's limbs to the second's, depth first; keeps the cheapest.
fn assign(sides: &[Vec<Limb>; 2], cost: f64, so_far: &mut Vec<Option<usize>>, best: &mut (f64, Vec<Option<usize>>)) {
    if cost >= best.0 {
        return;
    }
    let Some(limb) = sides[0].get(so_far.len()) else {
        let left = sides[1].len() - so_far.iter().flatten().count();
        let total = cost + ALONE * left as f64;
        if total < best.0 {
            *best = (total, so_far.clone());
        }
        return;
    };
    for (k, other) in sides[1].iter().enumerate() {
        if !so_far.contains(&Some(k)) {
            let unlike = ((limb.share - other.share) / PLACE).powi(2)
                + ((limb.length / other.length.max(1e-300)).max(1e-300).ln() / LENGTH).powi(2);
            so_far.push(Some(k));
            assign(sides, cost + unlike, so_far, best);
            so_far.pop();
        }
    }
    so_far.push(None);
    assign(sides, cost + ALONE, so_far, best);
    so_far.pop();
}
