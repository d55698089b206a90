//! What belongs together inside one lattice tet.
//!
//! Two legs may pass through the same tet; each must get a tet of its own. The solid in a tet is known by its surface pieces and by
//! sample points, the tet's own barycentric grid, of which those inside the solid count. They hold together by
//! 1. pieces that share an edge inside the tet;
//! 2. neighbouring points with nothing between; a point and the piece through which the way to its neighbour leaves the solid; and
//!    where the way leads from one body into another that overlaps it, the piece through which it enters;
//! 3. a piece and what is met first going inwards from it: another piece's inner side (thin parts, which hold no point), or a point in sight;
//! 4. pieces of different bodies that cut each other.
//!
//! A way never leads out of the solid and in again: bodies that touch stay apart, and so do parts of one body that overlap, because
//! points that one component encloses twice do not count.

use super::lattice::{Barycentric, Lattice};
use super::pieces::{Piece, segment_meets};
use animimic_scene::solid::Soup;
use animimic_scene::solid::UnionFind;
use animimic_scene::solid::{Enclosure, WindingNumber};
use glam::DVec3;

/// Steps of the sample grid along a tet's edge.
pub(crate) const GRID: usize = 4;

/// Points tried for a piece that meets no other one inwards.
const IN_SIGHT: usize = 6;

/// Lengths below this share of the spacing are none.
const NEAR: f64 = 1e-7;

/// The local components of one tet.
pub(crate) struct Regions {
    /// Number of them.
    pub count: u32,
    /// Component \[piece\].
    pub of_piece: Vec<u32>,
    /// Component \[sample\], `u32::MAX` outside.
    pub of_sample: Vec<u32>,
}

/// A tet's samples: barycentric numbers summing to [`GRID`], in the order of [`sample_grid`].
pub(crate) fn sample_grid() -> Vec<[usize; 4]> {
    let mut out = Vec::new();
    for a in 0..=GRID {
        for b in 0..=GRID - a {
            for c in 0..=GRID - a - b {
                out.push([a, b, c, GRID - a - b - c]);
            }
        }
    }
    out
}

/// Pairs of samples one step apart.
pub(crate) fn sample_pairs(grid: &[[usize; 4]]) -> Vec<[usize; 2]> {
    let mut out = Vec::new();
    for (i, a) in grid.iter().enumerate() {
        for (j, b) in grid.iter().enumerate().skip(i + 1) {
            if (0..4).map(|k| a[k].abs_diff(b[k])).sum::<usize>() == 2 {
                out.push([i, j]);
            }
        }
    }
    out
}

/// What does not change from tet to tet.
pub(crate) struct Context<'a> {
    pub soup: &'a Soup,
    pub winding: &'a WindingNumber,
    pub lattice: &'a Lattice,
    /// As [`sample_pairs`].
    pub pairs: &'a [[usize; 2]],
    /// Triangle → its entries in `soup.joints`.
    pub joints_of: &'a [Vec<u32>],
}

/// Finds them for a tet with its pieces and samples (position and what encloses it).
pub(crate) fn regions(context: &Context, pieces: &[Piece], samples: &[(DVec3, Enclosure)]) -> Regions {
    let mut local = Local {
        context,
        pieces,
        samples,
        corners: pieces.iter().map(|p| context.soup.corners(p.triangle as usize)).collect(),
        sets: UnionFind::new(pieces.len() + samples.len()),
    };
    local.join_edges();
    for &[a, b] in context.pairs {
        local.walk(a, b);
    }
    for piece in 0..pieces.len() {
        local.look_inwards(piece);
    }
    if context.soup.component_count > 1 {
        local.join_cuts();
    }
    local.numbered()
}

struct Local<'a> {
    context: &'a Context<'a>,
    pieces: &'a [Piece],
    samples: &'a [(DVec3, Enclosure)],
    corners: Vec<[DVec3; 3]>,
    /// Pieces, then samples.
    sets: UnionFind,
}

/// A piece on the way from one point to another.
struct Hit {
    /// Share of the way.
    at: f64,
    piece: usize,
    /// Leaves through the outer side.
    leaves: bool,
}

impl Local<'_> {
    fn piece_of(&self, triangle: u32) -> Option<usize> {
        self.pieces.binary_search_by_key(&triangle, |p| p.triangle).ok()
    }

    fn join_edges(&mut self) {
        let Some(first) = self.pieces.first() else { return };
        let barycentric = Barycentric::new(self.context.lattice.corners(&first.cell));
        for piece in 0..self.pieces.len() {
            let triangle = self.pieces[piece].triangle;
            for &joint in &self.context.joints_of[triangle as usize] {
                let ([t, u], edge) = self.context.soup.joints[joint as usize];
                let other = if t == triangle { u } else { t };
                // Each pair once.
                let Some(other) = self.piece_of(other).filter(|&o| o > piece) else { continue };
                let [a, b] = edge.map(|v| barycentric.at(self.context.soup.positions[v as usize]));
                if segment_meets(a, b) {
                    self.sets.join(piece, other);
                }
            }
        }
    }

    /// All pieces that the way from `a` to `b` crosses, in order; where it leaves and enters at one place, leaving first.
    fn hits(&self, a: DVec3, b: DVec3) -> Vec<Hit> {
        let mut hits: Vec<Hit> = self
            .corners
            .iter()
            .enumerate()
            .filter_map(|(piece, c)| crossing(a, b - a, c).map(|(at, leaves)| Hit { at, piece, leaves }))
            .filter(|h| h.at <= 1.0)
            .collect();
        hits.sort_by(|x, y| x.at.total_cmp(&y.at).then(y.leaves.cmp(&x.leaves)).then(x.piece.cmp(&y.piece)));
        hits
    }

    fn walk(&mut self, a: usize, b: usize) {
        let ((p, inside_a), (q, inside_b)) = (self.samples[a], self.samples[b]);
        if !inside_a.is_inside() && !inside_b.is_inside() {
            return;
        }
        let hits = self.hits(p, q);
        if inside_a.is_inside() {
            let end = inside_b.is_inside().then_some(b);
            self.follow(a, hits.iter().map(|h| (h.piece, h.leaves)), end);
        }
        if inside_b.is_inside() && !hits.is_empty() {
            self.follow(b, hits.iter().rev().map(|h| (h.piece, !h.leaves)), None);
        }
    }

    /// From a sample through pieces, as long as the way stays in the solid.
    fn follow(&mut self, from: usize, hits: impl Iterator<Item = (usize, bool)>, end: Option<usize>) {
        let n = self.pieces.len();
        let enclosure = self.samples[from].1;
        let mut depth = enclosure.total.round().max(1.0);
        for (piece, leaves) in hits {
            let component = self.context.soup.component[self.pieces[piece].triangle as usize];
            if leaves {
                self.sets.join(n + from, piece);
                depth -= 1.0;
                if depth < 1.0 {
                    return;
                }
            } else {
                // Another part of the same body: whether the way leads into it, or it lies beside, cannot be told.
                if enclosure.component == Some(component) && enclosure.largest > 0.5 {
                    return;
                }
                self.sets.join(n + from, piece);
                depth += 1.0;
            }
        }
        if let Some(end) = end {
            self.sets.join(n + from, n + end);
        }
    }

    fn look_inwards(&mut self, piece: usize) {
        let [a, b, c] = self.corners[piece];
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { return };
        let spacing = self.context.lattice.spacing;
        let start = self.pieces[piece].center - normal * (NEAR * spacing);
        let hits = self.hits(start, start - normal * spacing);
        if let Some(hit) = hits.iter().find(|h| h.piece != piece) {
            let middle = start - normal * (0.5 * hit.at * spacing);
            let thick = hit.at > NEAR;
            if hit.leaves && thick && !self.sets.same(piece, hit.piece) && self.context.winding.at(middle).is_inside() {
                self.sets.join(piece, hit.piece);
            }
        }
        self.join_in_sight(piece, start, -normal);
    }

    /// Surfaces of two bodies that cut each other inside the tet: one stands in the other, however small it is.
    fn join_cuts(&mut self) {
        let Some(first) = self.pieces.first() else { return };
        let barycentric = Barycentric::new(self.context.lattice.corners(&first.cell));
        let component = |piece: &Piece| self.context.soup.component[piece.triangle as usize];
        let cut = |a: &[DVec3; 3], b: &[DVec3; 3]| {
            (0..3).any(|k| {
                let (p, d) = (a[k], a[(k + 1) % 3] - a[k]);
                let at = crossing(p, d, b).map(|c| c.0).filter(|&at| at <= 1.0);
                at.is_some_and(|at| barycentric.at(p + d * at).iter().all(|&b| b >= -NEAR))
            })
        };
        for i in 0..self.pieces.len() {
            for j in i + 1..self.pieces.len() {
                if component(&self.pieces[i]) != component(&self.pieces[j]) && !self.sets.same(i, j) {
                    let (a, b) = (&self.corners[i], &self.corners[j]);
                    if cut(a, b) || cut(b, a) {
                        self.sets.join(i, j);
                    }
                }
            }
        }
    }

    /// Joins a piece with the nearest sample inside that is seen from `start`, on the side of `towards`.
    fn join_in_sight(&mut self, piece: usize, start: DVec3, towards: DVec3) {
        let n = self.pieces.len();
        let mut near: Vec<(f64, usize)> = (0..self.samples.len())
            .filter(|&s| self.samples[s].1.is_inside() && (self.samples[s].0 - start).dot(towards) > 0.0)
            .map(|s| (self.samples[s].0.distance_squared(start), s))
            .collect();
        near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        for &(_, s) in near.iter().take(IN_SIGHT) {
            if self.sets.same(piece, n + s) {
                break;
            }
            if self.hits(start, self.samples[s].0).is_empty() {
                self.sets.join(piece, n + s);
                break;
            }
        }
    }

    fn numbered(mut self) -> Regions {
        let n = self.pieces.len();
        let counts = |s: usize| s < n || self.samples[s - n].1.is_inside();
        let used: Vec<bool> = (0..n + self.samples.len()).map(counts).collect();
        let (mut number, mut count) = (vec![u32::MAX; used.len()], 0);
        let mut of = vec![u32::MAX; used.len()];
        for k in (0..used.len()).filter(|&k| used[k]) {
            let root = self.sets.find(k);
            if number[root] == u32::MAX {
                number[root] = count;
                count += 1;
            }
            of[k] = number[root];
        }
        let of_sample = of.split_off(n);
        Regions { count, of_piece: of, of_sample }
    }
}

/// Where a way crosses a triangle (share of `d`, at least 0), and whether it leaves through the outer side (Möller and Trumbore 1997).
fn crossing(p: DVec3, d: DVec3, [a, b, c]: &[DVec3; 3]) -> Option<(f64, bool)> {
    let (u, v) = (*b - *a, *c - *a);
    let h = d.cross(v);
    let det = u.dot(h);
    let inv = 1.0 / det;
    if !inv.is_finite() {
        return None;
    }
    let s = p - *a;
    let b1 = s.dot(h) * inv;
    let k = s.cross(u);
    let b2 = d.dot(k) * inv;
    let at = v.dot(k) * inv;
    let inside = b1 >= -1e-12 && b2 >= -1e-12 && b1 + b2 <= 1.0 + 1e-12 && at >= 0.0;
    // det = −d·n.
    inside.then_some((at, det < 0.0))
}
