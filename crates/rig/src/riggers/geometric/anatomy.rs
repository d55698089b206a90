//! Which chain is what: where the head is, which limbs are legs, where the pelvis lies.
//!
//! Up is +Y, as everywhere here. What an upright body faces is told by its feet, else taken as +Z (glTF's convention).

use super::chains::{Chain, Graph};
use super::pairs;
use super::symmetry::Mirror;
use glam::DVec3;

/// A trunk whose ends differ in height by more than this share of their distance stands upright.
const UPRIGHT: f64 = 0.65;

/// A leg ends in the lowest part of the model (share of the height), is this long [longest side], and leads down by this share of its length.
const GROUND: f64 = 0.25;
const LEG_LENGTH: f64 = 0.06;
const LEG_DROP: f64 = 0.35;

/// Legs whose places on the trunk differ by less than this share of its length are one pair or row.
const SAME_ROW: f64 = 0.22;

/// What speaks for the head's end of a lying trunk: logarithm of its thickness, each of up to three short chains on it, its height [longest side].
const THICK: f64 = 1.0;
const EARS: f64 = 0.4;
const HIGH: f64 = 3.5;

/// Legs on this first or last share of the trunk are at its end; its thickness is what tells head from tail.
const LAST: f64 = 0.15;

/// What the ways to a ball's centre and along the trunk count beside the way to the ball.
const CENTRE: f64 = 0.3;
const ALONG: f64 = 0.08;

/// Chains on this last share of the trunk, short beside the model, sit on the head.
const HEAD_SHARE: f64 = 0.3;
const SHORT: f64 = 0.25;

/// What a limb is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// The chain from tail to head.
    Trunk,
    /// Row of legs from behind, and number of rows.
    Leg(usize, usize),
    /// Off the ground, on an upright trunk or one with a single row of legs.
    Arm,
    /// Off the ground, spread to the side of a lying trunk.
    Wing,
    /// On the head.
    Ear,
    /// On the tail.
    TailFin,
    /// On a body without legs.
    Fin,
    /// On another limb.
    Twig,
}

/// The chains with their meaning.
pub(crate) struct Anatomy {
    /// Chain 0 is the trunk, tail to head.
    pub chains: Vec<Chain>,
    /// \[chain\].
    pub roles: Vec<Role>,
    /// Where on the trunk each chain begins; partners begin at the same place.
    pub place: Vec<usize>,
    /// The limb on the other side that is like this one, if both are there \[chain\].
    pub partner: Vec<Option<usize>>,
    /// Place of the pelvis on the trunk.
    pub pelvis: usize,
    /// Place of the foremost row of limbs before the pelvis, if there is one.
    pub chest: Option<usize>,
    /// The trunk stands upright.
    pub upright: bool,
    /// Unit vector to the body's left.
    pub left: DVec3,
}

impl Anatomy {
    /// Reads a pruned curve skeleton. `heights` are the lowest and highest coordinates of the surface.
    pub fn new(graph: &Graph, mirror: Option<&Mirror>, heights: [f64; 2]) -> Self {
        let trunk = head_last(graph, graph.trunk(mirror), heights);
        let upright = is_upright(graph, &trunk);
        let chains = graph.chains(trunk);
        let mut place: Vec<usize> = chains.iter().map(|c| place_on_trunk(graph, &chains, c)).collect();
        let along = arc(graph, &chains[0].nodes);
        let whole = along[along.len() - 1].max(1e-9 * graph.longest);
        let partner = match mirror {
            Some(m) if !m.exact => pairs::partners(graph, &chains, &place, m),
            _ => vec![None; chains.len()],
        };
        let apart = place.clone();
        for (c, other) in partner.iter().enumerate().filter_map(|(c, p)| Some((c, (*p)?))) {
            place[c] = nearest(&along, 0.5 * (along[apart[c]] + along[apart[other]]));
        }
        let leg = |c: usize| is_leg(graph, &chains[c], heights);
        let legs: Vec<usize> = (1..chains.len())
            .filter(|&c| chains[c].parent.is_some_and(|p| p.0 == 0) && (leg(c) || partner[c].is_some_and(leg)))
            .collect();
        let mut rows = rows(&legs, |c| along[place[c]] / whole, &partner);
        if upright {
            // Hands may reach the ground, but only the lowest row stands on it.
            rows.truncate(1);
        }
        let mean_place = |row: &[usize]| {
            let mean = row.iter().map(|&c| along[place[c]]).sum::<f64>() / row.len() as f64;
            nearest(&along, mean)
        };
        let pelvis = match rows.first() {
            Some(row) => mean_place(row),
            None => nearest(&along, balance(graph, &chains[0].nodes, &along)),
        };
        let role = |c: usize| role_of(graph, &chains, c, &rows, upright, along[place[c]] / whole);
        let roles: Vec<Role> = (0..chains.len()).map(role).collect();
        let front: Vec<usize> = (1..chains.len())
            .filter(|&c| match roles[c] {
                Role::Leg(row, count) => row + 1 == count && count > 1,
                Role::Arm | Role::Wing => true,
                _ => false,
            })
            .filter(|&c| along[place[c]] > along[pelvis] + 0.08 * whole)
            .collect();
        let chest = (!front.is_empty()).then(|| mean_place(&front));
        let forward = facing(graph, &chains, &roles, upright);
        let mut left = DVec3::Y.cross(forward).normalize_or(DVec3::X);
        if let Some(m) = mirror {
            left = if m.normal.dot(left) < 0.0 { -m.normal } else { m.normal };
        }
        Self { chains, roles, place, partner, pelvis, chest, upright, left }
    }
}

/// Way along a chain \[place\].
pub(crate) fn arc(graph: &Graph, nodes: &[usize]) -> Vec<f64> {
    let mut out = vec![0.0];
    for w in nodes.windows(2) {
        out.push(out[out.len() - 1] + graph.at(w[0]).distance(graph.at(w[1])));
    }
    out
}

/// Index of the entry nearest to a value.
pub(crate) fn nearest(values: &[f64], to: f64) -> usize {
    (0..values.len()).min_by(|&a, &b| (values[a] - to).abs().total_cmp(&(values[b] - to).abs())).unwrap_or(0)
}

fn is_upright(graph: &Graph, trunk: &[usize]) -> bool {
    let d = graph.at(trunk[trunk.len() - 1]) - graph.at(trunk[0]);
    d.y.abs() > UPRIGHT * d.length()
}

/// Turns the trunk so that it ends in the head: the upper end of one that stands upright on legs, the end away from legs at the other end;
/// else the thicker, higher end with more on it.
fn head_last(graph: &Graph, mut trunk: Vec<usize>, heights: [f64; 2]) -> Vec<usize> {
    let (first, last) = (trunk[0], trunk[trunk.len() - 1]);
    let upright = is_upright(graph, &trunk);
    let standing = upright && stands(graph, &trunk, heights);
    let turn = if standing {
        graph.at(first).y > graph.at(last).y
    } else if let Some(share) = lone_row(graph, &trunk, heights).filter(|s| (s - 0.5).abs() > 0.5 - LAST) {
        // Legs at the very end: the body ends there, however its other end hangs.
        share > 0.5
    } else {
        let along = arc(graph, &trunk);
        let whole = along[along.len() - 1];
        let short: Vec<usize> = graph
            .chains(trunk.clone())
            .iter()
            .filter(|c| c.parent.is_some_and(|p| p.0 == 0))
            .filter(|c| graph.length(&c.nodes[c.exit..]) < SHORT * graph.longest)
            .filter(|c| !is_leg(graph, c, heights))
            .filter_map(|c| c.parent.map(|p| p.1))
            .collect();
        // `from_end` is the way from the end that is judged.
        let score = |from_end: &dyn Fn(f64) -> f64, tip: usize| {
            let within = |i: usize, share: f64| from_end(along[i]) < share * whole;
            let near: Vec<f64> =
                (0..trunk.len()).filter(|&i| within(i, LAST)).map(|i| graph.radius(trunk[i])).collect();
            let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
            let ears = short.iter().filter(|&&i| within(i, HEAD_SHARE)).count().min(3);
            // What is set upright without legs, a fish for display, may have its head below.
            let height = if upright { 0.0 } else { graph.at(tip).y / graph.longest };
            THICK * mean.max(1e-3 * graph.longest).ln() + EARS * ears as f64 + HIGH * height
        };
        score(&|s| s, first) > score(&|s| whole - s, last)
    };
    if turn {
        trunk.reverse();
    }
    trunk
}

/// Whether legs grow on the trunk.
fn stands(graph: &Graph, trunk: &[usize], heights: [f64; 2]) -> bool {
    let chains = graph.chains(trunk.to_vec());
    chains.iter().any(|c| c.parent.is_some_and(|p| p.0 == 0) && is_leg(graph, c, heights))
}

/// Share of the trunk before the legs, if there is one row of them.
fn lone_row(graph: &Graph, trunk: &[usize], heights: [f64; 2]) -> Option<f64> {
    let chains = graph.chains(trunk.to_vec());
    let along = arc(graph, trunk);
    let on_trunk = |c: &usize| chains[*c].parent.is_some_and(|p| p.0 == 0);
    let legs: Vec<usize> = (1..chains.len()).filter(on_trunk).filter(|&c| is_leg(graph, &chains[c], heights)).collect();
    let share = |c: usize| along[place_on_trunk(graph, &chains, &chains[c])] / along[along.len() - 1];
    let rows = rows(&legs, share, &vec![None; chains.len()]);
    let [row] = &rows[..] else { return None };
    Some(row.iter().map(|&c| share(c)).sum::<f64>() / row.len() as f64)
}

fn is_leg(graph: &Graph, chain: &Chain, heights: [f64; 2]) -> bool {
    let tip = graph.at(chain.nodes[chain.nodes.len() - 1]);
    let length = graph.length(&chain.nodes[chain.exit..]);
    let drop = graph.at(chain.nodes[chain.exit]).y - tip.y;
    tip.y < heights[0] + GROUND * (heights[1] - heights[0])
        && length > LEG_LENGTH * graph.longest
        && drop > LEG_DROP * length
}

/// Where on the trunk a chain begins: the ball nearest to where it comes out (a tail that hangs beside a leg has smaller ones than the
/// pelvis), rather not far along the trunk from where the curves meet.
pub(crate) fn place_on_trunk(graph: &Graph, chains: &[Chain], chain: &Chain) -> usize {
    let trunk = &chains[0].nodes;
    let mut top = chain;
    while let Some((c, _)) = top.parent.filter(|p| p.0 != 0) {
        top = &chains[c];
    }
    let meet = top.parent.map_or(0, |p| p.1);
    let p = graph.at(top.nodes[top.exit]);
    let along = arc(graph, trunk);
    let cost = |i: usize| {
        let far = graph.at(trunk[i]).distance(p);
        (far - graph.radius(trunk[i])).max(0.0) + CENTRE * far + ALONG * (along[i] - along[meet]).abs()
    };
    (0..trunk.len()).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
}

/// Legs in rows from behind. A pair is a row of its own; other legs that begin near each other are one.
fn rows(legs: &[usize], share: impl Fn(usize) -> f64, partner: &[Option<usize>]) -> Vec<Vec<usize>> {
    let mut order = legs.to_vec();
    order.sort_by(|&a, &b| {
        share(a).total_cmp(&share(b)).then(a.min(partner[a].unwrap_or(a)).cmp(&b.min(partner[b].unwrap_or(b))))
    });
    let mut rows: Vec<Vec<usize>> = Vec::new();
    for leg in order {
        let joins = |row: &Vec<usize>| match partner[leg] {
            Some(other) => row.contains(&other),
            None => row.iter().all(|&l| partner[l].is_none()) && share(leg) - share(row[0]) < SAME_ROW,
        };
        match rows.last_mut() {
            Some(row) if joins(row) => row.push(leg),
            _ => rows.push(vec![leg]),
        }
    }
    rows
}

/// Centre of mass along the trunk.
fn balance(graph: &Graph, trunk: &[usize], along: &[f64]) -> f64 {
    let mass = |i: usize| graph.radius(trunk[i]).powi(2);
    let sum: f64 = (0..trunk.len()).map(mass).sum();
    (0..trunk.len()).map(|i| mass(i) * along[i]).sum::<f64>() / sum.max(f64::MIN_POSITIVE)
}

fn role_of(graph: &Graph, chains: &[Chain], c: usize, rows: &[Vec<usize>], upright: bool, share: f64) -> Role {
    let Some((on, _)) = chains[c].parent else { return Role::Trunk };
    if on != 0 {
        return Role::Twig;
    }
    if let Some(row) = rows.iter().position(|r| r.contains(&c)) {
        return Role::Leg(row, rows.len());
    }
    let length = graph.length(&chains[c].nodes[chains[c].exit..]);
    // Arms of what goes on two legs may be short and high; four legs leave no arms.
    let head = if upright || rows.len() == 1 { 0.5 * HEAD_SHARE } else { HEAD_SHARE };
    if share > 1.0 - head && length < SHORT * graph.longest {
        return Role::Ear;
    }
    if upright {
        return Role::Arm;
    }
    match rows.len() {
        0 if share < HEAD_SHARE => Role::TailFin,
        0 => Role::Fin,
        _ if share < HEAD_SHARE => Role::TailFin,
        1 => Role::Arm,
        _ => Role::Wing,
    }
}

/// Horizontal direction in which the body looks.
fn facing(graph: &Graph, chains: &[Chain], roles: &[Role], upright: bool) -> DVec3 {
    let trunk = &chains[0].nodes;
    let flat = |d: DVec3| DVec3::new(d.x, 0.0, d.z);
    if !upright {
        return flat(graph.at(trunk[trunk.len() - 1]) - graph.at(trunk[0])).normalize_or(DVec3::Z);
    }
    let toes: DVec3 = (1..chains.len())
        .filter(|&c| matches!(roles[c], Role::Leg(..)))
        .map(|c| {
            let n = &chains[c].nodes;
            flat(graph.at(n[n.len() - 1]) - graph.at(n[n.len() * 3 / 4]))
        })
        .sum();
    // Feet that point nowhere say nothing.
    if toes.length() > 0.02 * graph.longest { toes.normalize_or(DVec3::Z) } else { DVec3::Z }
}
