//! Dense inverse search (Kroeger, Timofte, Dai, Van Gool: Fast Optical Flow using Dense Inverse Search, ECCV 2016).
//!
//! On each level of a pyramid, coarse to fine: patches of 8×8 pixels on a grid find their displacement u by inverse
//! compositional Lucas–Kanade with mean normalisation (eq. 2–4),
//! Δu = H⁻¹ Σ S^T (I₁(x + u) − I₀(x)), H = Σ S^T S, S = ∇I₀ − mean;
//! then every pixel takes the mean of the patches that cover it, weighted by 1 / max(1, |I₁(x + u) − I₀(x)|) (eq. 5),
//! and variational refinement smooths it (§2.3). Neighbouring patches hand each other their results in two scans, as in
//! OpenCV's DISOpticalFlow, whose medium preset the search follows.

use super::variational::{Refinement, refine};
use super::{Flow, Gray};

/// Side of a patch [px].
const PATCH: usize = 8;
/// Replicated border around the second image, so that patches may leave it [px].
const BORDER: usize = 16;
/// The coarsest level still holds this many patches across its shorter side.
const MIN_PATCHES_ACROSS: usize = 3;
/// A search that moves farther than this from its start is undone [px of its level].
const MAX_DRIFT: f32 = PATCH as f32;
/// Smallest determinant of H that is inverted; below, the patch has no texture to follow.
const MIN_DETERMINANT: f32 = 1e-3;
/// Relaxation sweeps double with every coarser level up to this many.
const MAX_SWEEPS: usize = 40;

/// Settings of [`dis`].
#[derive(Clone, Debug)]
pub struct FlowOptions {
    /// Level at which the search ends; its flow is enlarged to full size (0 = full size, 1 = half).
    pub finest_level: usize,
    /// Distance between patches [px].
    pub stride: usize,
    /// Descent steps per patch and scan.
    pub steps: usize,
    /// Rounds of variational refinement per level; 0 for none.
    pub refinements: usize,
}

impl Default for FlowOptions {
    fn default() -> Self {
        Self { finest_level: 1, stride: 3, steps: 12, refinements: 4 }
    }
}

/// Flow from `a` to `b` (same size). Images under 16 pixels give no motion.
pub fn dis(a: &Gray, b: &Gray, options: &FlowOptions) -> Flow {
    assert_eq!((a.width, a.height), (b.width, b.height), "flow needs two images of one size");
    let short = a.width.min(a.height);
    if short < 2 * PATCH {
        return Flow::zero(a.width, a.height);
    }
    let mut coarsest = 0;
    while short >> (coarsest + 1) >= MIN_PATCHES_ACROSS * PATCH {
        coarsest += 1;
    }
    let finest = options.finest_level.min(coarsest);
    let (pyramid_a, pyramid_b) = (a.pyramid(coarsest + 1), b.pyramid(coarsest + 1));
    let top = &pyramid_a[coarsest];
    let mut flow = Planes::zero(top.width, top.height);
    for level in (finest..=coarsest).rev() {
        let (a, b) = (&pyramid_a[level], &pyramid_b[level]);
        if level < coarsest {
            flow = flow.enlarged(a.width, a.height);
        }
        flow = search_level(a, b, &flow, options);
        if options.refinements > 0 {
            let fine = Refinement { rounds: options.refinements, ..Refinement::default() };
            let sweeps = (fine.sweeps << (level - finest)).min(MAX_SWEEPS);
            refine(a, b, &mut flow, &Refinement { sweeps, ..fine });
        }
    }
    for image in pyramid_a[..finest].iter().rev() {
        flow = flow.enlarged(image.width, image.height);
    }
    Flow { width: a.width, height: a.height, vectors: flow.u.iter().zip(&flow.v).map(|(&u, &v)| [u, v]).collect() }
}

/// Flow as two planes, for row-wise arithmetic.
#[derive(Clone, Debug)]
pub(super) struct Planes {
    pub width: usize,
    pub height: usize,
    pub u: Vec<f32>,
    pub v: Vec<f32>,
}

impl Planes {
    fn zero(width: usize, height: usize) -> Self {
        Self { width, height, u: vec![0.0; width * height], v: vec![0.0; width * height] }
    }

    /// Twice the size and twice the displacement; bilinear.
    fn enlarged(&self, width: usize, height: usize) -> Self {
        // Between which source pixels each one lies, and where.
        let between = |size: usize, source: usize| -> Vec<(usize, usize, f32)> {
            (0..size)
                .map(|k| {
                    let x = (0.5 * (k as f32 - 0.5)).clamp(0.0, (source - 1) as f32);
                    (x as usize, (x as usize + 1).min(source - 1), x - (x as usize) as f32)
                })
                .collect()
        };
        let (columns, rows) = (between(width, self.width), between(height, self.height));
        let double = |values: &[f32]| {
            let mut out = Vec::with_capacity(width * height);
            for &(y0, y1, fy) in &rows {
                let (above, below) =
                    (&values[y0 * self.width..][..self.width], &values[y1 * self.width..][..self.width]);
                out.extend(columns.iter().map(|&(x0, x1, fx)| {
                    let top = above[x0] + fx * (above[x1] - above[x0]);
                    let bottom = below[x0] + fx * (below[x1] - below[x0]);
                    2.0 * (top + fy * (bottom - top))
                }));
            }
            out
        };
        Self { width, height, u: double(&self.u), v: double(&self.v) }
    }
}

/// The second image with a replicated border.
struct Bordered {
    stride: usize,
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Bordered {
    fn new(image: &Gray) -> Self {
        let (width, height) = (image.width, image.height);
        let stride = width + 2 * BORDER;
        let mut values = Vec::with_capacity(stride * (height + 2 * BORDER));
        for y in 0..height + 2 * BORDER {
            let row = &image.values[y.saturating_sub(BORDER).min(height - 1) * width..][..width];
            values.extend(std::iter::repeat_n(row[0], BORDER));
            values.extend_from_slice(row);
            values.extend(std::iter::repeat_n(row[width - 1], BORDER));
        }
        Self { stride, width, height, values }
    }

    /// Rows of the 9×9 block under a patch whose corner is at (x, y), and the fractions for bilinear interpolation.
    fn window(&self, x: f32, y: f32) -> (usize, f32, f32) {
        let clamp = |v: f32, size: usize| (v + BORDER as f32).clamp(1.0, (size + 2 * BORDER - PATCH - 2) as f32);
        let (x, y) = (clamp(x, self.width), clamp(y, self.height));
        let (x0, y0) = (x as usize, y as usize);
        (y0 * self.stride + x0, x - x0 as f32, y - y0 as f32)
    }

    /// Interpolated row `r` of a patch at a window.
    #[inline(always)]
    fn row(&self, (corner, fx, fy): (usize, f32, f32), r: usize) -> [f32; PATCH] {
        let top: &[f32; PATCH + 1] =
            self.values[corner + r * self.stride..][..PATCH + 1].try_into().expect("nine values were taken");
        let bottom: &[f32; PATCH + 1] =
            self.values[corner + (r + 1) * self.stride..][..PATCH + 1].try_into().expect("nine values were taken");
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        std::array::from_fn(|i| {
            weights[0] * top[i] + weights[1] * top[i + 1] + weights[2] * bottom[i] + weights[3] * bottom[i + 1]
        })
    }
}

/// The first image's side of one patch: pixels, gradients, H⁻¹.
struct Template<'a> {
    image: &'a Gray,
    gx: &'a [f32],
    gy: &'a [f32],
    x: usize,
    y: usize,
    sum_gx: f32,
    sum_gy: f32,
    inverse: [f32; 3],
}

#[inline(always)]
fn row8(values: &[f32], at: usize) -> &[f32; PATCH] {
    values[at..at + PATCH].try_into().expect("eight values were taken")
}

const PIXELS: f32 = (PATCH * PATCH) as f32;

impl<'a> Template<'a> {
    fn new(image: &'a Gray, gx: &'a [f32], gy: &'a [f32], x: usize, y: usize) -> Self {
        let mut sums = [[0.0f32; PATCH]; 5];
        for r in 0..PATCH {
            let at = (y + r) * image.width + x;
            let (a, b) = (row8(gx, at), row8(gy, at));
            for i in 0..PATCH {
                sums[0][i] += a[i];
                sums[1][i] += b[i];
                sums[2][i] += a[i] * a[i];
                sums[3][i] += a[i] * b[i];
                sums[4][i] += b[i] * b[i];
            }
        }
        let [sum_gx, sum_gy, xx, xy, yy] = sums.map(|s| s.iter().sum::<f32>());
        let (xx, xy, yy) =
            (xx - sum_gx * sum_gx / PIXELS, xy - sum_gx * sum_gy / PIXELS, yy - sum_gy * sum_gy / PIXELS);
        let determinant = (xx * yy - xy * xy).max(MIN_DETERMINANT);
        let inverse = [yy / determinant, -xy / determinant, xx / determinant];
        Self { image, gx, gy, x, y, sum_gx, sum_gy, inverse }
    }

    /// Mean-normalised squared error at displacement u and Σ Sᵀ r.
    #[inline(always)]
    fn residual(&self, b: &Bordered, u: [f32; 2]) -> Residual {
        let window = b.window(self.x as f32 + u[0], self.y as f32 + u[1]);
        let mut sums = [[0.0f32; PATCH]; 4];
        for r in 0..PATCH {
            let at = (self.y + r) * self.image.width + self.x;
            let (i0, gx, gy) = (row8(&self.image.values, at), row8(self.gx, at), row8(self.gy, at));
            let i1 = b.row(window, r);
            for i in 0..PATCH {
                let d = i1[i] - i0[i];
                sums[0][i] += d;
                sums[1][i] += d * d;
                sums[2][i] += d * gx[i];
                sums[3][i] += d * gy[i];
            }
        }
        let [d, dd, dx, dy] = sums.map(|s| s.iter().sum::<f32>());
        Residual { error: dd - d * d / PIXELS, slope: [dx - d * self.sum_gx / PIXELS, dy - d * self.sum_gy / PIXELS] }
    }

    /// Descends from `start`, with what is left there, while the error falls.
    fn descend(&self, b: &Bordered, start: [f32; 2], there: Residual, steps: usize) -> [f32; 2] {
        let mut best = (start, f32::INFINITY);
        let (mut u, mut left) = (start, there);
        for step in 0..steps {
            if step > 0 {
                left = self.residual(b, u);
            }
            if left.error >= best.1 {
                break;
            }
            best = (u, left.error);
            let [x, y] = left.slope;
            let step = [self.inverse[0] * x + self.inverse[1] * y, self.inverse[1] * x + self.inverse[2] * y];
            u = [u[0] - step[0], u[1] - step[1]];
            let size = step[0].abs().max(step[1].abs());
            if size.is_nan() || size <= 0.01 {
                break;
            }
        }
        let drift = (best.0[0] - start[0]).hypot(best.0[1] - start[1]);
        if drift > MAX_DRIFT { start } else { best.0 }
    }
}

/// What a displacement leaves of a patch's difference.
#[derive(Clone, Copy)]
struct Residual {
    error: f32,
    /// Σ Sᵀ r.
    slope: [f32; 2],
}

/// One level: patch search in two scans, then densification.
fn search_level(a: &Gray, b: &Gray, initial: &Planes, options: &FlowOptions) -> Planes {
    let (gx, gy) = a.gradients();
    let bordered = Bordered::new(b);
    let stride = options.stride.max(1);
    let corners = |size: usize| -> Vec<usize> {
        let mut list: Vec<usize> = (0..=size - PATCH).step_by(stride).collect();
        if list.last() != Some(&(size - PATCH)) {
            list.push(size - PATCH);
        }
        list
    };
    let (xs, ys) = (corners(a.width), corners(a.height));
    let columns = xs.len();
    let templates: Vec<Template> = ys
        .iter()
        .flat_map(|&y| xs.iter().map(move |&x| (x, y)))
        .map(|(x, y)| Template::new(a, &gx, &gy, x, y))
        .collect();
    let mut found: Vec<[f32; 2]> = templates
        .iter()
        .map(|t| {
            let centre = (t.y + PATCH / 2) * a.width + t.x + PATCH / 2;
            [initial.u[centre], initial.v[centre]]
        })
        .collect();
    let n = templates.len();
    for scan in 0..2 {
        for k in 0..n {
            let (i, towards) = if scan == 0 { (k, -1i64) } else { (n - 1 - k, 1) };
            let (row, column) = (i / columns, i % columns);
            let mut start = found[i];
            let mut left = templates[i].residual(&bordered, start);
            let beside = column as i64 + towards;
            let beyond = row as i64 + towards;
            let neighbours = [
                (beside >= 0 && beside < columns as i64).then(|| row * columns + beside as usize),
                (beyond >= 0 && beyond < ys.len() as i64).then(|| beyond as usize * columns + column),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                let candidate = found[neighbour];
                if candidate != start {
                    let there = templates[i].residual(&bordered, candidate);
                    if there.error < left.error {
                        (start, left) = (candidate, there);
                    }
                }
            }
            found[i] = templates[i].descend(&bordered, start, left, options.steps);
        }
    }
    densify(&templates, &found, &bordered, a)
}

fn densify(templates: &[Template], found: &[[f32; 2]], b: &Bordered, a: &Gray) -> Planes {
    let mut out = Planes::zero(a.width, a.height);
    let mut total = vec![0.0f32; a.width * a.height];
    for (t, &u) in templates.iter().zip(found) {
        let window = b.window(t.x as f32 + u[0], t.y as f32 + u[1]);
        for r in 0..PATCH {
            let at = (t.y + r) * a.width + t.x;
            let i0 = row8(&a.values, at);
            let i1 = b.row(window, r);
            let weights: [f32; PATCH] = std::array::from_fn(|i| 1.0 / (i1[i] - i0[i]).abs().max(1.0));
            let (ou, ov) = (&mut out.u[at..at + PATCH], &mut out.v[at..at + PATCH]);
            for i in 0..PATCH {
                ou[i] += weights[i] * u[0];
                ov[i] += weights[i] * u[1];
            }
            for (sum, w) in total[at..at + PATCH].iter_mut().zip(weights) {
                *sum += w;
            }
        }
    }
    for ((u, v), w) in out.u.iter_mut().zip(&mut out.v).zip(&total) {
        // Every pixel lies in at least one patch: the last corner of a row is flush with the border.
        *u /= w;
        *v /= w;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth pattern, moved and slightly turned by an analytic map.
    fn pattern(size: usize, shift: [f32; 2], angle: f32) -> (Gray, impl Fn(f32, f32) -> [f32; 2]) {
        let c = size as f32 / 2.0;
        let (s, k) = angle.sin_cos();
        let value = move |x: f32, y: f32| {
            128.0
                + 40.0 * (0.21 * x + 0.05 * y).sin()
                + 35.0 * (0.17 * y - 0.08 * x).cos()
                + 20.0 * (0.4 * x).sin() * (0.37 * y).sin()
        };
        // The moved image at q shows what was at R⁻¹(q − c − shift) + c.
        let values = (0..size * size)
            .map(|i| {
                let (x, y) = ((i % size) as f32 - c - shift[0], (i / size) as f32 - c - shift[1]);
                value(k * x + s * y + c, -s * x + k * y + c)
            })
            .collect();
        let flow = move |x: f32, y: f32| {
            let (dx, dy) = (x - c, y - c);
            [k * dx - s * dy + shift[0] - dx, s * dx + k * dy + shift[1] - dy]
        };
        (Gray { width: size, height: size, values }, flow)
    }

    #[test]
    fn a_known_motion_of_several_pixels_is_found_to_a_tenth_of_a_pixel() {
        for (shift, angle) in [([0.0, 0.0], 0.0), ([3.3, -1.7], 0.0), ([-6.0, 4.0], 0.03), ([12.0, 5.0], -0.02)] {
            let (a, _) = pattern(160, [0.0; 2], 0.0);
            let (b, truth) = pattern(160, shift, angle);
            let flow = dis(&a, &b, &FlowOptions::default());
            let mut sum = 0.0;
            let mut count = 0;
            for y in 24..136 {
                for x in 24..136 {
                    let (f, t) = (flow.vectors[y * 160 + x], truth(x as f32, y as f32));
                    sum += (f[0] - t[0]).hypot(f[1] - t[1]);
                    count += 1;
                }
            }
            let error = sum / count as f32;
            println!("shift {shift:?}, angle {angle}: mean end-point error {error:.4} px");
            assert!(error < 0.1);
        }
    }

    #[test]
    fn blank_and_tiny_images_do_not_move() {
        let blank = Gray { width: 70, height: 50, values: vec![217.0; 3500] };
        assert!(dis(&blank, &blank, &FlowOptions::default()).vectors.iter().all(|v| *v == [0.0; 2]));
        let tiny = Gray { width: 9, height: 9, values: (0..81).map(|i| i as f32).collect() };
        assert_eq!(dis(&tiny, &tiny, &FlowOptions::default()), Flow::zero(9, 9));
    }
}
