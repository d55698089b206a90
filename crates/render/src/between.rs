//! What is seen between pixel centres: single sight lines, cast only where several silhouettes cross one pair of pixels.
//!
//! A slit or a limb thinner than a pixel leaves two or more crossings between two neighbouring centres. What lies between them
//! no pixel shows, and which of them are hidden the pixels do not tell either. So one looks just past each crossing: what is met
//! there is nearer and hides it, or is what it stands out against. All sights of a picture are answered in one walk over the
//! triangles. (Zigzags of an outline cross within a thousandth of a pixel of each other, hence the step's bound by the next crossing.)

use crate::project::ScreenPoint;
use crate::raster::NONE;
use crate::silhouette::{Crossing, Silhouette};

/// Side of the squares by which points are found [px].
const CELL: usize = 8;

/// How far beside an outline one looks past it [px].
const BESIDE: f32 = 1e-3;

/// What two neighbouring pixels show may reach back by this factor in inverse depth between their centres: steep walls do.
const SLACK: f32 = 0.9;

/// A sight line: screen position and what it meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sight {
    pub x: f32,
    pub y: f32,
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
            let (x, y) = ((a % width) as f32 + 0.5, (a / width) as f32 + 0.5);
            let found = &out.crossings[first..];
            out.sights.extend(found.iter().enumerate().map(|(k, c)| {
                // Not past the next outline.
                let next = if c.surface_first { found.get(k + 1) } else { k.checked_sub(1).map(|k| &found[k]) };
                let step = next.map_or(BESIDE, |n| BESIDE.min(0.5 * (n.t - c.t).abs()));
                let t = if c.surface_first { c.t + step } else { c.t - step };
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
    let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
    let mut cells: Vec<Vec<u32>> = vec![Vec::new(); columns * rows];
    for (k, s) in sights.iter().enumerate() {
        cells[s.y as usize / CELL * columns + s.x as usize / CELL].push(k as u32);
    }
    for (index, t) in triangles.iter().enumerate() {
        let p = t.map(|v| screen[v as usize]);
        let range = |a: f64, b: f64, c: f64, count: usize| {
            let cell = |v: f64| (v.max(0.0) as usize / CELL).min(count);
            cell(a.min(b).min(c))..(cell(a.max(b).max(c)) + 1).min(count)
        };
        for row in range(p[0].y, p[1].y, p[2].y, rows) {
            for column in range(p[0].x, p[1].x, p[2].x, columns) {
                for &k in &cells[row * columns + column] {
                    meet(&mut sights[k as usize], &p, index as u32, cull_back);
                }
            }
        }
    }
}

fn meet(sight: &mut Sight, p: &[ScreenPoint; 3], triangle: u32, cull_back: &[bool]) {
    let (x, y) = (f64::from(sight.x), f64::from(sight.y));
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
