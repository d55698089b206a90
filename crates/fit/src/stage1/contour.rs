//! Silhouettes as point correspondences: rendered boundary pixels ↔ observed boundary pixels, both ways.

use animimic_scene::Mask;
use glam::DVec2;

/// Boundary pixels of a mask with outward normals, and the nearest one from everywhere.
pub struct Contour {
    width: usize,
    /// Pixel centres of the boundary.
    pub points: Vec<DVec2>,
    /// Outward unit normals.
    pub normals: Vec<DVec2>,
    /// Index of the nearest boundary pixel \[pixel\]; `u32::MAX` if there is none.
    nearest: Vec<u32>,
}

/// Cosine between rendered and observed normals below which they do not match.
const NORMAL_AGREEMENT: f64 = 0.5;
/// Radius of the window in which the normal is taken from the coverage's slope [px].
const NORMAL_RADIUS: isize = 3;

impl Contour {
    /// The contour of the pixels inside a mask. Pixels at the image border do not count: there the object is cut off.
    pub fn new(mask: &Mask) -> Self {
        let (w, h) = (mask.width, mask.height);
        let (mut points, mut normals, mut at) = (Vec::new(), Vec::new(), Vec::new());
        for y in 1..h.saturating_sub(1) {
            for x in 1..w.saturating_sub(1) {
                let open = |x: usize, y: usize| !mask.inside(x, y);
                if open(x, y) || !(open(x - 1, y) || open(x + 1, y) || open(x, y - 1) || open(x, y + 1)) {
                    continue;
                }
                if let Some(n) = normal(mask, x, y) {
                    points.push(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                    normals.push(n);
                    at.push(y * w + x);
                }
            }
        }
        let nearest = nearest_feature(w, h, &at);
        Self { width: w, points, normals, nearest }
    }

    /// Index of the boundary point nearest to a pixel.
    pub fn nearest(&self, pixel: DVec2) -> Option<usize> {
        let height = self.nearest.len() / self.width.max(1);
        let x = (pixel.x.max(0.0) as usize).min(self.width.saturating_sub(1));
        let y = (pixel.y.max(0.0) as usize).min(height.saturating_sub(1));
        let i = *self.nearest.get(y * self.width + x)?;
        (i != u32::MAX).then_some(i as usize)
    }

    /// Pairs of this (rendered) contour's points with an observed one's, nearest ones from here to there and back, about
    /// `wanted` each way, no farther apart than `reach` [px].
    pub fn pairs(&self, observed: &Contour, reach: f64, wanted: usize) -> Vec<(usize, usize)> {
        let step = |n: usize| n / wanted + 1;
        let there = (0..self.points.len())
            .step_by(step(self.points.len()))
            .filter_map(|r| Some((r, observed.nearest(self.points[r])?)));
        let back = (0..observed.points.len())
            .step_by(step(observed.points.len()))
            .filter_map(|o| Some((self.nearest(observed.points[o])?, o)));
        there.chain(back).filter(|&(r, o)| self.matches(r, observed, o, reach)).collect()
    }

    /// Whether a point may be the same edge as an observed one: within reach, and facing alike.
    pub fn matches(&self, r: usize, observed: &Contour, o: usize, reach: f64) -> bool {
        self.points[r].distance(observed.points[o]) <= reach
            && self.normals[r].dot(observed.normals[o]) >= NORMAL_AGREEMENT
    }
}

/// Outward normal: against the slope of coverage in a small window.
fn normal(mask: &Mask, x: usize, y: usize) -> Option<DVec2> {
    let mut sum = DVec2::ZERO;
    for dy in -NORMAL_RADIUS..=NORMAL_RADIUS {
        for dx in -NORMAL_RADIUS..=NORMAL_RADIUS {
            let (px, py) = (x as isize + dx, y as isize + dy);
            if px >= 0 && py >= 0 && (px as usize) < mask.width && (py as usize) < mask.height {
                let c = f64::from(mask.coverage[py as usize * mask.width + px as usize]) / 255.0;
                sum -= DVec2::new(dx as f64, dy as f64) * c;
            }
        }
    }
    (sum.length_squared() > 1e-12).then(|| sum.normalize())
}

/// Nearest feature pixel from every pixel: two-pass exact Euclidean feature transform (Meijster et al. 2000).
fn nearest_feature(width: usize, height: usize, features: &[usize]) -> Vec<u32> {
    let mut column = vec![u32::MAX; width * height];
    for (i, &p) in features.iter().enumerate() {
        column[p] = i as u32;
    }
    // Row by row, as memory lies.
    let rows: Vec<u32> = features.iter().map(|p| (p / width) as u32).collect();
    for y in 1..height {
        let (above, here) = column[(y - 1) * width..(y + 1) * width].split_at_mut(width);
        here.iter_mut().zip(&*above).for_each(|(here, above)| nearer_row(here, *above, &rows, y));
    }
    for y in (0..height.saturating_sub(1)).rev() {
        let (here, below) = column[y * width..(y + 2) * width].split_at_mut(width);
        here.iter_mut().zip(&*below).for_each(|(here, below)| nearer_row(here, *below, &rows, y));
    }
    let mut nearest = vec![u32::MAX; width * height];
    let (mut hull, mut starts) = (Vec::new(), Vec::new());
    for y in 0..height {
        let squared_rise = |x: usize| -> Option<i64> {
            let i = column[y * width + x];
            (i != u32::MAX).then(|| (i64::from(rows[i as usize]) - y as i64).pow(2))
        };
        hull.clear();
        starts.clear();
        for x in 0..width {
            let Some(rise) = squared_rise(x) else { continue };
            loop {
                let Some(&last) = hull.last() else {
                    hull.push(x);
                    starts.push(0i64);
                    break;
                };
                let last_rise = squared_rise(last).unwrap_or(0);
                let (a, b) = (last as i64, x as i64);
                let cross = (b * b - a * a + rise - last_rise).div_euclid(2 * (b - a)) + 1;
                if cross <= *starts.last().unwrap_or(&0) && hull.len() > 1 {
                    hull.pop();
                    starts.pop();
                    continue;
                }
                if cross <= 0 && hull.len() == 1 {
                    hull.pop();
                    starts.pop();
                    continue;
                }
                if cross < width as i64 {
                    hull.push(x);
                    starts.push(cross);
                }
                break;
            }
        }
        let mut k = 0;
        for x in 0..width {
            while k + 1 < hull.len() && starts[k + 1] <= x as i64 {
                k += 1;
            }
            if let Some(&from) = hull.get(k) {
                nearest[y * width + x] = column[y * width + from];
            }
        }
    }
    nearest
}

/// Takes over the candidate of the next row where its feature's row is nearer to row `y`.
fn nearer_row(here: &mut u32, candidate: u32, rows: &[u32], y: usize) {
    let distance = |i: u32| (rows[i as usize] as usize).abs_diff(y);
    if candidate != u32::MAX && (*here == u32::MAX || distance(candidate) < distance(*here)) {
        *here = candidate;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn the_feature_transform_equals_brute_force() {
        let (w, h) = (37, 23);
        let mut rng = SplitMix64(5);
        let features: Vec<usize> = (0..w * h).filter(|_| rng.uniform() < 0.02).collect();
        let nearest = nearest_feature(w, h, &features);
        let distance = |p: usize, f: usize| ((p % w).abs_diff(f % w)).pow(2) + ((p / w).abs_diff(f / w)).pow(2);
        for p in 0..w * h {
            let best = features.iter().map(|&f| distance(p, f)).min().expect("there are features");
            assert_eq!(distance(p, features[nearest[p] as usize]), best, "pixel {p}");
        }
    }

    #[test]
    fn normals_of_a_disc_point_outwards() {
        let inside = |x: i32, y: i32| (x - 20).pow(2) + (y - 20).pow(2) < 144;
        let coverage = (0..1600).map(|i| if inside(i % 40, i / 40) { 255 } else { 0 }).collect();
        let contour = Contour::new(&Mask { width: 40, height: 40, coverage });
        assert!(contour.points.len() > 50);
        for (p, n) in contour.points.iter().zip(&contour.normals) {
            assert!((*p - DVec2::new(20.5, 20.5)).normalize().dot(*n) > 0.95);
        }
    }
}
