//! What is seen between pixel centres: single sight lines, cast only where several silhouettes cross one pair of pixels.
//!
//! A slit or a limb thinner than a pixel leaves two or more crossings between two neighbouring centres. What lies between them
//! no pixel shows, and which of them are hidden the pixels do not tell either. So one looks just past each crossing: what is met
//! there is nearer and hides it, or is what it stands out against. All sights of a picture are answered in one walk over the
//! triangles. (Zigzags of an outline cross within a thousandth of a pixel of each other, hence the step's bound by the next crossing.)

use crate::project::ScreenPoint;
use crate::raster::NONE;
use crate::silhouette::{Crossing, Silhouette};
use wide::f64x2;

/// Side of the squares by which points are found [px].
const CELL: usize = 2;

/// Side of the blocks by which most triangles are found to be far from all points [px].
const BLOCK: usize = 8;

/// How far beside an outline one looks past it [px].
const BESIDE: f32 = 1e-3;

/// What two neighbouring pixels show may reach back by this factor in inverse depth between their centres: steep walls do.
const SLACK: f32 = 0.9;

/// Crossings all within this distance are one outline's zigzag, a single step [px].
const ZIGZAG: f32 = 0.05;

/// A sight line: screen position and what it meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sight {
    pub x: f64,
    pub y: f64,
    /// [`NONE`] where there is only background.
    pub triangle: u32,
    /// Inverse depth, 0 on the background.
    pub q: f32,
}

/// A pair of pixels with several crossings that may be seen.
#[derive(Clone, Debug)]
pub(crate) struct Crowded {
    /// As [`Crossing::pair`].
    pub pair: u32,
    /// In order along the pair.
    pub crossings: std::ops::Range<usize>,
}

/// All crowded pairs of a picture.
#[derive(Clone, Debug, Default)]
pub(crate) struct Between {
    pub crowded: Vec<Crowded>,
    pub crossings: Vec<Crossing>,
    /// Per crossing: the sight just past it, on the side where its surface is not.
    pub sights: Vec<Sight>,
}

impl Between {
    /// Finds the pairs with two or more crossings that are not behind what both pixels show (`inv_z`, of width `width`), and looks
    /// between these.
    pub fn new(
        silhouette: &Silhouette,
        inv_z: &[f32],
        width: usize,
        triangles: &[[u32; 3]],
        screen: &[ScreenPoint],
        cull_back: &[bool],
    ) -> Self {
        let mut out = Self::default();
        for same in silhouette.crossings.chunk_by(|a, b| a.pair == b.pair) {
            let pair = same[0].pair;
            let (a, vertical) = (pair as usize / 2, pair % 2 == 1);
            let b = a + if vertical { width } else { 1 };
            let hidden = SLACK * inv_z[a].min(inv_z[b]);
            let first = out.crossings.len();
            if same.len() < 2 {
                continue;
            }
            out.crossings.extend(same.iter().filter(|c| c.q > hidden));
            if out.crossings.len() < first + 2 {
                out.crossings.truncate(first);
                continue;
            }
            out.crossings[first..].sort_by(|a, b| a.t.total_cmp(&b.t));
            if out.crossings[out.crossings.len() - 1].t - out.crossings[first].t < ZIGZAG {
                out.crossings.truncate(first);
                continue;
            }
            let (x, y) = ((a % width) as f64 + 0.5, (a / width) as f64 + 0.5);
            let found = &out.crossings[first..];
            out.sights.extend(found.iter().enumerate().map(|(k, c)| {
                // Not past the next outline.
                let next = if c.surface_first { found.get(k + 1) } else { k.checked_sub(1).map(|k| &found[k]) };
                let step = next.map_or(BESIDE, |n| BESIDE.min(0.5 * (n.t - c.t).abs()));
                let t = f64::from(c.t) + f64::from(if c.surface_first { step } else { -step });
                let (x, y) = if vertical { (x, y + t) } else { (x + t, y) };
                Sight { x, y, triangle: NONE, q: 0.0 }
            }));
            out.crowded.push(Crowded { pair, crossings: first..out.crossings.len() });
        }
        look(&mut out.sights, triangles, screen, cull_back, width, inv_z.len() / width.max(1));
        out
    }

    /// Whether a pair is crowded.
    pub fn contains(&self, pair: u32) -> bool {
        self.crowded.binary_search_by_key(&pair, |c| c.pair).is_ok()
    }
}

/// Finds what each sight meets first. Triangles that reach behind the camera are left out.
fn look(
    sights: &mut [Sight],
    triangles: &[[u32; 3]],
    screen: &[ScreenPoint],
    cull_back: &[bool],
    width: usize,
    height: usize,
) {
    if sights.is_empty() {
        return;
    }
    let (columns, rows) = (width.div_ceil(CELL) + 1, height.div_ceil(CELL) + 1);
    let cell = |x: f64, y: f64| y as i32 as usize / CELL * columns + x as i32 as usize / CELL;
    // Sights of a square, and of neighbouring squares of a row, stand together: square → where its sights begin.
    let mut begin = vec![0u32; columns * rows + 1];
    sights.iter().for_each(|s| begin[cell(s.x, s.y) + 1] += 1);
    (1..begin.len()).for_each(|k| begin[k] += begin[k - 1]);
    let mut order: Vec<u32> = (0..sights.len() as u32).collect();
    order.sort_by_key(|&k| cell(sights[k as usize].x, sights[k as usize].y));
    // Blocks that hold a sight or lie left of or above one that does: all in which the bounds of a small triangle near it may begin.
    let across = width.div_ceil(BLOCK) + 1;
    let block = |x: f64, y: f64| y as i32 as usize / BLOCK * across + x as i32 as usize / BLOCK;
    let mut near = vec![false; across * (height.div_ceil(BLOCK) + 1)];
    for s in sights.iter() {
        let b = BLOCK as f64;
        for (x, y) in [(s.x, s.y), (s.x - b, s.y), (s.x, s.y - b), (s.x - b, s.y - b)] {
            near[block(x.max(0.0), y.max(0.0))] = true;
        }
    }
    let limit = f64x2::new([(width.div_ceil(CELL) * CELL) as f64, (height.div_ceil(CELL) * CELL) as f64]);
    for (index, t) in triangles.iter().enumerate() {
        let p = t.map(|v| f64x2::new([screen[v as usize].x, screen[v as usize].y]));
        let lo = p[0].fast_min(p[1]).fast_min(p[2]).fast_max(f64x2::ZERO).fast_min(limit).to_array();
        let hi = p[0].fast_max(p[1]).fast_max(p[2]).fast_max(f64x2::ZERO).fast_min(limit).to_array();
        let small = hi[0] - lo[0] < BLOCK as f64 && hi[1] - lo[1] < BLOCK as f64;
        if small && !near[block(lo[0], lo[1])] {
            continue;
        }
        let cells = |v: [f64; 2]| v.map(|v| v as i32 as usize / CELL);
        let ([left, top], [right, bottom]) = (cells(lo), cells(hi));
        for row in top..bottom + 1 {
            let row = row * columns;
            for &k in &order[begin[row + left] as usize..begin[row + right + 1] as usize] {
                let s = &mut sights[k as usize];
                if s.x >= lo[0] && s.x <= hi[0] && s.y >= lo[1] && s.y <= hi[1] {
                    meet(s, &t.map(|v| screen[v as usize]), index as u32, cull_back);
                }
            }
        }
    }
}

fn meet(sight: &mut Sight, p: &[ScreenPoint; 3], triangle: u32, cull_back: &[bool]) {
    let (x, y) = (sight.x, sight.y);
    if p.iter().all(|p| p.q as f32 <= sight.q) {
        return;
    }
    let e = [0, 1, 2].map(|k| {
        let (a, b) = (p[(k + 1) % 3], p[(k + 2) % 3]);
        (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x)
    });
    let area = e[0] + e[1] + e[2];
    let inside = e.iter().all(|&e| e >= 0.0) || e.iter().all(|&e| e <= 0.0);
    let hidden = area > 0.0 && cull_back.get(triangle as usize).copied().unwrap_or(false);
    if !inside || hidden || area == 0.0 || p.iter().any(|p| p.q <= 0.0) {
        return;
    }
    let q = ((e[0] * p[0].q + e[1] * p[1].q + e[2] * p[2].q) / area) as f32;
    if q > sight.q {
        (sight.q, sight.triangle) = (q, triangle);
    }
}
