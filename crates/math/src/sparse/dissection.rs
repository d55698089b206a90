//! Geometric nested dissection: a fill-reducing order for points with coordinates.
//!
//! Each part is cut by a plane across an axis; the vertices that must be removed are the minimum vertex cover of the cut
//! edges (König's theorem on a maximum bipartite matching), and the cut with the best separator among several axes and
//! positions wins. George 1973 for the idea; no graph partitioner is needed because the points know where they are.

/// Parts of at most this many points are not cut further.
const LEAF_POINTS: usize = 12;
/// Positions tried along each axis, as shares of the points on the low side.
const CUTS: [f64; 5] = [0.5, 0.45, 0.55, 0.4, 0.6];

/// The order and the tree of separators.
#[derive(Clone, Debug, Default)]
pub struct Dissection {
    /// Point eliminated at each position.
    pub order: Vec<u32>,
    /// Tree nodes in postorder: the positions each eliminates, and its parent node.
    pub nodes: Vec<DissectionNode>,
}

/// One separator or leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DissectionNode {
    /// First position.
    pub start: u32,
    /// One past the last position.
    pub end: u32,
    /// Parent in the node list, none for a root.
    pub parent: Option<u32>,
}

/// Orders points (coordinates per point) with neighbours in compressed lists: those of `i` are
/// `neighbour[start[i]..start[i + 1]]`.
pub fn nested_dissection(points: &[[f64; 3]], start: &[u32], neighbour: &[u32]) -> Dissection {
    let mut work = Work { points, start, neighbour, side: vec![0; points.len()], result: Dissection::default() };
    let ids: Vec<u32> = (0..points.len() as u32).collect();
    work.dissect(ids);
    work.result
}

struct Work<'a> {
    points: &'a [[f64; 3]],
    start: &'a [u32],
    neighbour: &'a [u32],
    /// 0 outside the present part, else the side of the cut.
    side: Vec<u8>,
    result: Dissection,
}

/// A cut: low side, high side, separator.
struct Cut {
    parts: [Vec<u32>; 3],
    cost: f64,
}

impl Work<'_> {
    /// Orders one part; returns its root node, none if the part is empty.
    fn dissect(&mut self, ids: Vec<u32>) -> Option<u32> {
        if ids.is_empty() {
            return None;
        }
        let cut = if ids.len() <= LEAF_POINTS { None } else { self.best_cut(&ids) };
        let (children, own) = match cut {
            None => (vec![], ids),
            Some(Cut { parts: [low, high, separator], .. }) => {
                drop(ids);
                let children = [low, high].into_iter().filter_map(|part| self.dissect(part)).collect();
                (children, separator)
            }
        };
        let start = self.result.order.len() as u32;
        self.result.order.extend(&own);
        let node = self.result.nodes.len() as u32;
        self.result.nodes.push(DissectionNode { start, end: start + own.len() as u32, parent: None });
        children.into_iter().for_each(|c: u32| self.result.nodes[c as usize].parent = Some(node));
        Some(node)
    }

    fn best_cut(&mut self, ids: &[u32]) -> Option<Cut> {
        let mut best: Option<Cut> = None;
        for axis in 0..3 {
            let key = |i: u32, a: usize| self.points[i as usize][(axis + a) % 3];
            let mut sorted = ids.to_vec();
            sorted.sort_by(|&i, &j| {
                (0..3).map(|a| key(i, a).total_cmp(&key(j, a))).find(|o| o.is_ne()).unwrap_or(i.cmp(&j))
            });
            for share in CUTS {
                let low = (share * sorted.len() as f64) as usize;
                let cut = self.separate(&sorted[..low], &sorted[low..]);
                let useful = cut.parts[0].len().min(cut.parts[1].len()) > 0 || cut.parts[2].is_empty();
                if useful && best.as_ref().is_none_or(|b| cut.cost < b.cost) {
                    best = Some(cut);
                }
            }
        }
        best
    }

    /// The smallest vertex set whose removal disconnects the two sides.
    fn separate(&mut self, low: &[u32], high: &[u32]) -> Cut {
        low.iter().for_each(|&i| self.side[i as usize] = 1);
        high.iter().for_each(|&i| self.side[i as usize] = 2);
        let (start, neighbour, sides) = (self.start, self.neighbour, &self.side);
        let across = |i: u32| {
            let near = &neighbour[start[i as usize] as usize..start[i as usize + 1] as usize];
            near.iter().copied().filter(|&j| sides[j as usize] == 2)
        };
        let boundary: Vec<u32> = low.iter().copied().filter(|&i| across(i).next().is_some()).collect();
        let mut right: Vec<u32> = boundary.iter().flat_map(|&i| across(i)).collect();
        right.sort_unstable();
        right.dedup();
        let edges: Vec<Vec<u32>> = boundary
            .iter()
            .map(|&i| across(i).map(|j| right.binary_search(&j).expect("collected above") as u32).collect())
            .collect();
        let (cover_left, cover_right) = minimum_vertex_cover(&edges, right.len());
        let mark = |side: &mut Vec<u8>, points: &[u32], cover: &[bool]| {
            points.iter().zip(cover).filter(|(_, c)| **c).for_each(|(&i, _)| side[i as usize] = 3);
        };
        mark(&mut self.side, &boundary, &cover_left);
        mark(&mut self.side, &right, &cover_right);
        let mut parts = [vec![], vec![], vec![]];
        for &i in low.iter().chain(high) {
            parts[self.side[i as usize] as usize - 1].push(i);
            self.side[i as usize] = 0;
        }
        let (a, b, s) = (parts[0].len() as f64, parts[1].len() as f64, parts[2].len() as f64);
        // Factoring a separator costs s³; an uneven cut leaves a larger half, whose own cost grows like its square.
        let imbalance = (a - b).abs() / (a + b).max(1.0);
        Cut { cost: s.powi(3).max(1.0) * (1.0 + 2.0 * imbalance * imbalance) + imbalance, parts }
    }
}

/// König: from a maximum matching of the bipartite graph (left vertex → right neighbours) to a minimum vertex cover.
fn minimum_vertex_cover(edges: &[Vec<u32>], right: usize) -> (Vec<bool>, Vec<bool>) {
    const NONE: u32 = u32::MAX;
    let (mut of_left, mut of_right) = (vec![NONE; edges.len()], vec![NONE; right]);
    let mut seen = vec![NONE; right];
    for root in 0..edges.len() as u32 {
        augment(edges, root, &mut of_left, &mut of_right, &mut seen);
    }
    let (mut reached_left, mut reached_right) = (vec![false; edges.len()], vec![false; right]);
    let mut stack: Vec<u32> = (0..edges.len() as u32).filter(|&l| of_left[l as usize] == NONE).collect();
    stack.iter().for_each(|&l| reached_left[l as usize] = true);
    while let Some(l) = stack.pop() {
        for &r in &edges[l as usize] {
            if !std::mem::replace(&mut reached_right[r as usize], true) {
                let next = of_right[r as usize];
                if next != NONE && !std::mem::replace(&mut reached_left[next as usize], true) {
                    stack.push(next);
                }
            }
        }
    }
    reached_left.iter_mut().for_each(|b| *b = !*b);
    (reached_left, reached_right)
}

/// One augmenting path from `root` by depth-first search with an explicit stack; `seen[r] == root` marks visited.
fn augment(edges: &[Vec<u32>], root: u32, of_left: &mut [u32], of_right: &mut [u32], seen: &mut [u32]) {
    let mut path: Vec<(u32, usize)> = vec![(root, 0)];
    while let Some((left, tried)) = path.last_mut() {
        let Some(&r) = edges[*left as usize].get(*tried) else {
            path.pop();
            continue;
        };
        *tried += 1;
        if std::mem::replace(&mut seen[r as usize], root) == root {
            continue;
        }
        let next = of_right[r as usize];
        if next != u32::MAX {
            path.push((next, 0));
            continue;
        }
        for &(l, tried) in &path {
            let r = edges[l as usize][tried - 1];
            of_left[l as usize] = r;
            of_right[r as usize] = l;
        }
        return;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a grid with 6-neighbour edges.
    pub fn grid(n: [usize; 3]) -> (Vec<[f64; 3]>, Vec<u32>, Vec<u32>) {
        let id = |i: usize, j: usize, k: usize| ((i * n[1] + j) * n[2] + k) as u32;
        let (mut points, mut start, mut neighbour) = (vec![], vec![0], vec![]);
        for i in 0..n[0] {
            for j in 0..n[1] {
                for k in 0..n[2] {
                    points.push([i as f64, j as f64, k as f64]);
                    let near = [(i > 0).then(|| id(i - 1, j, k)), (i + 1 < n[0]).then(|| id(i + 1, j, k))];
                    neighbour.extend(near.into_iter().flatten());
                    let near = [(j > 0).then(|| id(i, j - 1, k)), (j + 1 < n[1]).then(|| id(i, j + 1, k))];
                    neighbour.extend(near.into_iter().flatten());
                    let near = [(k > 0).then(|| id(i, j, k - 1)), (k + 1 < n[2]).then(|| id(i, j, k + 1))];
                    neighbour.extend(near.into_iter().flatten());
                    start.push(neighbour.len() as u32);
                }
            }
        }
        (points, start, neighbour)
    }

    #[test]
    fn every_point_is_ordered_once_and_siblings_do_not_touch() {
        let (points, start, neighbour) = grid([13, 7, 5]);
        let d = nested_dissection(&points, &start, &neighbour);
        let mut seen = d.order.clone();
        seen.sort_unstable();
        assert_eq!(seen, (0..points.len() as u32).collect::<Vec<_>>());
        let mut node_of = vec![0u32; points.len()];
        for (n, node) in d.nodes.iter().enumerate() {
            (node.start..node.end).for_each(|p| node_of[d.order[p as usize] as usize] = n as u32);
            assert!(node.parent.is_none_or(|p| p as usize > n), "postorder");
        }
        let is_ancestor = |a: u32, mut b: u32| loop {
            if a == b {
                break true;
            }
            match d.nodes[b as usize].parent {
                Some(p) => b = p,
                None => break false,
            }
        };
        for i in 0..points.len() {
            for &j in &neighbour[start[i] as usize..start[i + 1] as usize] {
                let (a, b) = (node_of[i], node_of[j as usize]);
                assert!(is_ancestor(a.max(b), a.min(b)), "edge {i}-{j} joins unrelated parts {a}, {b}");
            }
        }
    }

    #[test]
    fn the_first_separator_of_a_long_box_is_its_cross_section() {
        let (points, start, neighbour) = grid([20, 6, 6]);
        let d = nested_dissection(&points, &start, &neighbour);
        let top = d.nodes.last().expect("not empty");
        assert_eq!(top.end - top.start, 36);
    }

    #[test]
    fn loose_points_are_ordered_too() {
        let points: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i % 7), 0.0, 0.0]).collect();
        let d = nested_dissection(&points, &[0; 101], &[]);
        assert_eq!(d.order.len(), 100);
    }
}
