//! Which joints carry each vertex of a cage: the surface's skin weights, continued through the tets.
//!
//! A cage vertex whose tets hold surface vertices takes their mean, weighted by barycentric coordinates; every other one is
//! the mean of its neighbours (discrete harmonic), so weights fall off inside a body as they do along its skin.

use animimic_scene::Skin;
use animimic_sim::tet::Cage;

/// Sweeps of Gauss–Seidel over the vertices without surface: far more than a cage is deep, at the default size.
const SWEEPS: usize = 60;

/// Weight of every joint at every vertex of a cage.
#[derive(Clone, Debug, Default)]
pub struct CageWeights {
    /// Joints of the skeleton that carry anything, ascending.
    pub joints: Vec<usize>,
    /// Weights, \[cage vertex\]\[index into `joints`\], summing to 1.
    pub rows: Vec<Vec<f64>>,
}

impl CageWeights {
    /// Continues the weights of a skin into a cage of its surface.
    pub fn new(skin: &Skin, cage: &Cage) -> Self {
        let mut joints: Vec<usize> =
            skin.influences.iter().flatten().map(|i| skin.slots[i.slot as usize].joint).collect();
        joints.sort_unstable();
        joints.dedup();
        let column = |joint: usize| joints.binary_search(&joint).expect("listed above");
        let (count, vertices) = (joints.len(), cage.mesh.positions.len());
        let mut rows = vec![vec![0.0; count]; vertices];
        let mut seen = vec![0.0; vertices];
        for (v, (&tet, coordinates)) in cage.embedding.tet.iter().zip(&cage.embedding.barycentric).enumerate() {
            for (&k, &b) in cage.mesh.tets[tet as usize].iter().zip(coordinates) {
                let share = b.max(0.0);
                seen[k as usize] += share;
                for i in &skin.influences[v] {
                    rows[k as usize][column(skin.slots[i.slot as usize].joint)] += share * i.weight;
                }
            }
        }
        let known: Vec<bool> = seen.iter().map(|s| *s > LEAST_SHARE).collect();
        for (row, s) in rows.iter_mut().zip(&seen).filter(|(_, s)| **s > LEAST_SHARE) {
            row.iter_mut().for_each(|w| *w /= s);
        }
        continue_inside(&mut rows, &known, &neighbours(&cage.mesh.tets, vertices));
        Self { joints, rows }
    }

    /// The joint that carries most of a cage vertex, as an index into `joints`, and its weight.
    pub fn main(&self, vertex: usize) -> (usize, f64) {
        let best = self.rows[vertex].iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)));
        best.map_or((0, 0.0), |(c, w)| (c, *w))
    }
}

/// A vertex that touches the surface by less than this knows nothing of it.
const LEAST_SHARE: f64 = 1e-6;

/// Vertices joined by a tet edge, ascending, \[vertex\].
pub(super) fn neighbours(tets: &[[u32; 4]], vertices: usize) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); vertices];
    for tet in tets {
        for &a in tet {
            out[a as usize].extend(tet.iter().filter(|b| **b != a));
        }
    }
    for list in &mut out {
        list.sort_unstable();
        list.dedup();
    }
    out
}

/// Fills what is not known: outwards from what is, then towards the mean of the neighbours.
fn continue_inside(rows: &mut [Vec<f64>], known: &[bool], neighbours: &[Vec<u32>]) {
    let mut filled = known.to_vec();
    let mut order = Vec::new();
    loop {
        let front: Vec<usize> =
            (0..rows.len()).filter(|&v| !filled[v] && neighbours[v].iter().any(|&n| filled[n as usize])).collect();
        if front.is_empty() {
            break;
        }
        for &v in &front {
            rows[v] = mean(rows, neighbours[v].iter().filter(|&&n| filled[n as usize]));
        }
        front.iter().for_each(|&v| filled[v] = true);
        order.extend(front);
    }
    for _ in 0..SWEEPS {
        for &v in &order {
            rows[v] = mean(rows, neighbours[v].iter());
        }
    }
}

fn mean<'a>(rows: &[Vec<f64>], of: impl Iterator<Item = &'a u32>) -> Vec<f64> {
    let (mut sum, mut count) = (vec![0.0; rows.first().map_or(0, Vec::len)], 0.0);
    for &n in of {
        sum.iter_mut().zip(&rows[n as usize]).for_each(|(s, w)| *s += w);
        count += 1.0;
    }
    sum.iter_mut().for_each(|s| *s /= f64::max(count, 1.0));
    sum
}
