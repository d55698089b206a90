//! Names of joints: role, side, number, as in `leg_front_L_02`.

use super::Placed;
use super::anatomy::Anatomy;
use super::chains::Graph;
use super::joints::Draft;
use super::pairs;
use super::symmetry::Mirror;

/// A limb lies beside the plane if its middle is farther from it than this share of its own radius there.
const BESIDE: f64 = 0.5;

/// Side of every draft: +1 where the plane's normal points to, −1 on the other, 0 in the middle or without a plane.
pub(crate) fn sides(graph: &Graph, anatomy: &Anatomy, drafts: &[Draft], mirror: Option<&Mirror>) -> Vec<i8> {
    let Some(mirror) = mirror else { return vec![0; drafts.len()] };
    let mut out: Vec<i8> = Vec::new();
    for draft in drafts {
        let inherited = draft.parent.map_or(0, |p| out[p]);
        let own = if draft.chain == 0 {
            0
        } else if anatomy.partner[draft.chain].is_some() {
            pairs::lean(graph, &anatomy.chains[draft.chain], mirror).signum() as i8
        } else {
            let nodes = &anatomy.chains[draft.chain].nodes;
            let node = nodes[nodes.len() / 2];
            let side = mirror.side(graph.at(node));
            if side.abs() > BESIDE * graph.radius(node) { side.signum() as i8 } else { 0 }
        };
        out.push(match (inherited, draft.lateral) {
            (0, true) => 1,
            (0, false) => own,
            (side, _) => side,
        });
    }
    out
}

/// Gives unique names. `left` is positive where the plane's normal points to the body's left.
pub(crate) fn named(drafts: Vec<(Draft, i8)>, left: Option<f64>) -> Vec<Placed> {
    let mut taken: Vec<(String, usize, i8)> = Vec::new();
    drafts
        .into_iter()
        .map(|(draft, side)| {
            // Chains of one kind on one side are told apart by a number of their own.
            let kind: Vec<usize> = taken.iter().filter(|t| t.0 == draft.stem && t.2 == side).map(|t| t.1).collect();
            let rank = kind.iter().position(|&c| c == draft.chain).unwrap_or_else(|| {
                taken.push((draft.stem.clone(), draft.chain, side));
                kind.len()
            });
            let mut name = draft.stem.clone();
            if rank > 0 {
                name += &(rank + 1).to_string();
            }
            if let (Some(left), true) = (left, side != 0) {
                name += if f64::from(side) * left > 0.0 { "_L" } else { "_R" };
            }
            if let Some(number) = draft.number {
                name += &format!("_{number:02}");
            }
            Placed { name, position: draft.position, parent: draft.parent, seeds: draft.seeds }
        })
        .collect()
}
