//! The plane that maps a surface onto itself, if there is one: an upright one, as bodies that stand have, or a level one.

use animimic_scene::solid::Soup;
use glam::DVec3;
use std::collections::HashSet;
use std::f64::consts::PI;

/// Directions of the normal that are tried, around the vertical.
const DIRECTIONS: usize = 36;

/// Offsets tried on either side of the middle, and their step [longest side].
const OFFSETS: (i32, f64) = (6, 0.006);

/// Sample points on the surface.
const SAMPLES: usize = 6000;

/// Side of the boxes in which a sample's image must find the surface [longest side].
const BOX: f64 = 0.02;

/// Shares of samples that find the surface: of a symmetric pose, and of a symmetric body in another pose (with what an axis counts as).
const EXACT: f64 = 0.985;
const BODY: f64 = 0.6;

/// Bodies stand along the axes more often than not, and in mid-stride arms and legs look for a plane of their own: what an axis counts
/// as, in shares of samples.
const AXIS: f64 = 0.25;

/// A plane of symmetry.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mirror {
    /// Unit normal.
    pub normal: DVec3,
    /// normal · x for points x of the plane.
    pub offset: f64,
    /// The pose is symmetric too: what is built may be mirrored.
    pub exact: bool,
}

impl Mirror {
    /// Signed distance of a point [model unit].
    pub fn side(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// The mirror image of a point.
    pub fn image(&self, p: DVec3) -> DVec3 {
        p - 2.0 * self.side(p) * self.normal
    }

    /// The nearest point of the plane.
    pub fn flattened(&self, p: DVec3) -> DVec3 {
        p - self.side(p) * self.normal
    }

    /// The axis to which the normal is parallel, if it is one, and the plane's coordinate on it.
    pub fn axis(&self) -> Option<(usize, f64)> {
        (0..3).find(|&k| self.normal[k] == 1.0).map(|k| (k, self.offset))
    }

    /// Finds the best plane; `None` where no plane maps much of the surface onto itself.
    pub fn find(soup: &Soup, longest: f64) -> Option<Self> {
        let points = samples(soup);
        let side = BOX * longest;
        let key = |p: DVec3| (p / side).floor().to_array().map(|c| c as i64);
        // Only asked whether it holds a box, never iterated.
        let mut boxes: HashSet<[i64; 3]> = HashSet::new();
        for &p in &points {
            for corner in 0..8 {
                let shift = DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2)) - 0.5;
                boxes.insert(key(p + 0.8 * side * shift));
            }
        }
        let score = |m: &Mirror, every: usize| {
            let tried = points.iter().step_by(every);
            let hits = tried.clone().filter(|p| boxes.contains(&key(m.image(**p)))).count();
            hits as f64 / tried.len().max(1) as f64
        };
        let mut best: Option<(f64, Mirror)> = None;
        // What lies on its side is symmetric about a level plane.
        for normal in (0..DIRECTIONS).map(upright_normal).chain([DVec3::Y]) {
            let along = points.iter().map(|p| normal.dot(*p));
            let lo = along.clone().fold(f64::INFINITY, f64::min);
            let hi = along.clone().fold(f64::NEG_INFINITY, f64::max);
            let mean = along.sum::<f64>() / points.len().max(1) as f64;
            let tries = std::iter::once(0.5 * (lo + hi))
                .chain((-OFFSETS.0..=OFFSETS.0).map(|k| mean + f64::from(k) * OFFSETS.1 * longest));
            for offset in tries {
                let mirror = Mirror { normal, offset, exact: false };
                let s = score(&mirror, 4) + if mirror.axis().is_some_and(|a| a.0 != 1) { AXIS } else { 0.0 };
                if best.as_ref().is_none_or(|b| s > b.0 + 1e-9) {
                    best = Some((s, mirror));
                }
            }
        }
        let (likely, mirror) = best?;
        (likely > BODY).then_some(Mirror { exact: score(&mirror, 1) > EXACT, ..mirror })
    }
}

/// One of the horizontal directions. Exact axes stay exact: the grid is then laid symmetrically to the plane.
fn upright_normal(k: usize) -> DVec3 {
    let angle = PI * k as f64 / DIRECTIONS as f64;
    match 2 * k {
        0 => DVec3::X,
        n if n == DIRECTIONS => DVec3::Z,
        _ => DVec3::new(angle.cos(), 0.0, angle.sin()),
    }
}

/// Points spread evenly over the surface, the same for a surface and its image as far as that goes: centres of equal pieces of area.
fn samples(soup: &Soup) -> Vec<DVec3> {
    let area = |t: usize| {
        let [a, b, c] = soup.corners(t);
        0.5 * (b - a).cross(c - a).length()
    };
    let total: f64 = (0..soup.triangles.len()).map(area).sum();
    let mut points = Vec::with_capacity(SAMPLES);
    let mut due = 0.0;
    for t in 0..soup.triangles.len() {
        due += area(t) / total * SAMPLES as f64;
        let [a, b, c] = soup.corners(t);
        let mut k = 0u32;
        while due >= 1.0 {
            // A low-discrepancy sequence folded into the triangle (Roberts' R2).
            let (mut u, mut v) =
                ((0.5 + 0.754_877_67 * f64::from(k)).fract(), (0.5 + 0.569_840_29 * f64::from(k)).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            points.push(a + u * (b - a) + v * (c - a));
            due -= 1.0;
            k += 1;
        }
    }
    points
}
