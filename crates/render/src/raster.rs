//! Hard z-buffer rasterisation in bands of rows.
//!
//! Edge functions e(p) = (p.x − l.x)(h.y − l.y) − (p.y − l.y)(h.x − l.x) are evaluated eight pixels at a time, always from
//! the edge's upper end l to its lower end h, so that both triangles at an edge compute the same bits and every pixel centre
//! belongs to exactly one of them (top-left rule), also across seams where vertices are split. 1/z is linear on the screen.
//! Ties in depth go to the lower triangle index, so bands and threads do not show in the result.
//!
//! Barycentrics are resolved afterwards, once per visible pixel: overdraw costs only the depth test.

use crate::interpolate::Weights;
use crate::project::{ScreenPoint, project};
use crate::setup::{Candidate, Edge, Geometry, setup_all};
use animimic_scene::{Camera, Mask};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use wide::{f32x8, u32x8};

/// The triangle index of a pixel that shows none.
pub const NONE: u32 = u32::MAX;

/// Rows per band: a band's depth and index rows stay in the second-level cache, and 512 rows give 16 bands to share.
const BAND_ROWS: usize = 32;

/// Pixels per SIMD step.
const LANES: usize = 8;

/// What each pixel centre sees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Raster {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Visible triangle \[pixel\], [`NONE`] where there is none.
    pub triangle: Vec<u32>,
    /// Inverse depth along the camera axis \[pixel\] [1 / model unit]; 0 where there is no triangle.
    pub inv_z: Vec<f32>,
    /// Perspective-correct weights of the triangle's first and second vertex \[pixel\]; the third's is 1 − b0 − b1.
    pub bary: Vec<[f32; 2]>,
}

impl Raster {
    /// An empty raster of a size.
    fn reset(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.triangle.clear();
        self.triangle.resize(width * height, NONE);
        self.inv_z.clear();
        self.inv_z.resize(width * height, 0.0);
        self.bary.clear();
        self.bary.resize(width * height, [0.0; 2]);
    }

    /// Whether the pixel shows a triangle.
    pub fn covered(&self, pixel: usize) -> bool {
        self.triangle[pixel] != NONE
    }

    /// Depth along the camera axis [model unit], or `None` on the background.
    pub fn depth(&self, pixel: usize) -> Option<f64> {
        self.covered(pixel).then(|| 1.0 / f64::from(self.inv_z[pixel]))
    }

    /// All three weights of a covered pixel.
    pub fn weights(&self, pixel: usize) -> [f32; 3] {
        let [b0, b1] = self.bary[pixel];
        [b0, b1, 1.0 - b0 - b1]
    }

    /// The covered pixels as a mask (0 or 255).
    pub fn mask(&self) -> Mask {
        let coverage = self.triangle.iter().map(|&t| if t == NONE { 0 } else { 255 }).collect();
        Mask { width: self.width, height: self.height, coverage }
    }
}

/// Which side of a triangle is drawn.
#[derive(Clone, Copy, Debug, Default)]
pub struct Facing<'a> {
    /// Per triangle: whether its back (clockwise as seen) is hidden. Empty: everything is drawn from both sides.
    pub cull_back: &'a [bool],
}

/// Decides per pixel whether a triangle is there at all (alpha cutouts): (triangle, perspective-correct weights).
pub type Cutout<'a> = &'a (dyn Fn(u32, [f32; 3]) -> bool + Sync);

/// Rasterises with one thread: triangles (vertex indices) at `positions` (world space, per vertex), both sides drawn.
pub fn rasterize(camera: &Camera, positions: &[DVec3], triangles: &[[u32; 3]]) -> Raster {
    rasterize_projected(camera, positions, &project(camera, positions), triangles, Facing::default(), None, false)
}

/// The same with bands of rows shared among threads: the same bytes as [`rasterize`].
pub fn rasterize_parallel(camera: &Camera, positions: &[DVec3], triangles: &[[u32; 3]]) -> Raster {
    rasterize_projected(camera, positions, &project(camera, positions), triangles, Facing::default(), None, true)
}

/// Rasterises with all choices open: `screen` is [`project`]'s result for `positions`; triangles that refer to vertices
/// that do not exist are dropped.
pub fn rasterize_projected(
    camera: &Camera,
    positions: &[DVec3],
    screen: &[ScreenPoint],
    triangles: &[[u32; 3]],
    facing: Facing,
    cutout: Option<Cutout>,
    parallel: bool,
) -> Raster {
    let mut raster = Raster::default();
    rasterize_into(camera, positions, screen, triangles, facing, cutout, parallel, &mut raster);
    raster
}

/// [`rasterize_projected`] into an earlier raster, whose memory is used again.
pub fn rasterize_into(
    camera: &Camera,
    positions: &[DVec3],
    screen: &[ScreenPoint],
    triangles: &[[u32; 3]],
    facing: Facing,
    cutout: Option<Cutout>,
    parallel: bool,
    raster: &mut Raster,
) {
    let (width, height) = (camera.width as usize, camera.height as usize);
    raster.reset(width, height);
    let stride = width.next_multiple_of(LANES);
    if width == 0 || height == 0 {
        return;
    }
    let geometry = Geometry { camera, positions, screen, triangles, facing, cutout, width, height };
    if !parallel {
        let rows = Rows { first: 0, width, stride };
        let (triangle, inv_z, bary) = (&mut raster.triangle, &mut raster.inv_z, &mut raster.bary);
        draw_band(&geometry, &rows, triangle, inv_z, bary, |draw| setup_all(&geometry, draw));
        return;
    }
    let mut setups = Vec::with_capacity(triangles.len());
    setup_all(&geometry, &mut |s| setups.push(*s));
    let bins = bin(&setups, BAND_ROWS, height);
    let size = BAND_ROWS * width;
    let bands = raster.triangle.chunks_mut(size).zip(raster.inv_z.chunks_mut(size)).zip(raster.bary.chunks_mut(size));
    let work: Vec<_> = bands.zip(&bins).enumerate().collect();
    work.into_par_iter().for_each(|(index, (((triangle, inv_z), bary), bin)): (usize, BandWork)| {
        let rows = Rows { first: index * BAND_ROWS, width, stride };
        draw_band(&geometry, &rows, triangle, inv_z, bary, |draw| {
            bin.iter().for_each(|&s| draw(&setups[s as usize]));
        });
    });
}

/// A band's triangle, inverse depth and weight rows, and the setups that touch it.
type BandWork<'a> = (((&'a mut [u32], &'a mut [f32]), &'a mut [[f32; 2]]), &'a Vec<u32>);

struct Rows {
    first: usize,
    width: usize,
    stride: usize,
}

/// Triangles per band, in order.
fn bin(setups: &[Candidate], band: usize, height: usize) -> Vec<Vec<u32>> {
    let mut bins = vec![Vec::new(); height.div_ceil(band)];
    for (index, s) in setups.iter().enumerate() {
        for b in s.rows[0] as usize / band..=(s.rows[1] as usize - 1) / band {
            bins[b].push(index as u32);
        }
    }
    bins
}

/// Draws into a band of rows what `each` hands over, then resolves the weights.
fn draw_band(
    geometry: &Geometry,
    rows: &Rows,
    triangle: &mut [u32],
    inv_z: &mut [f32],
    bary: &mut [[f32; 2]],
    each: impl FnOnce(&mut dyn FnMut(&Candidate)),
) {
    let height = triangle.len() / rows.width;
    let padded = rows.stride != rows.width;
    let (mut wide_triangle, mut wide_q) = if padded {
        (vec![NONE; rows.stride * height], vec![0.0f32; rows.stride * height])
    } else {
        (Vec::new(), Vec::new())
    };
    {
        let (ids, qs) = if padded { (&mut wide_triangle[..], &mut wide_q[..]) } else { (&mut *triangle, &mut *inv_z) };
        each(&mut |s| match geometry.cutout {
            None => draw(s, rows, height, ids, qs),
            Some(keep) => draw_cutout(geometry, s, rows, height, keep, ids, qs),
        });
    }
    if padded {
        for row in 0..height {
            let (from, to) = (row * rows.stride, row * rows.width);
            triangle[to..to + rows.width].copy_from_slice(&wide_triangle[from..from + rows.width]);
            inv_z[to..to + rows.width].copy_from_slice(&wide_q[from..from + rows.width]);
        }
    }
    resolve(geometry, rows, triangle, bary);
}

const NARROW_COLUMNS: [f32; 8] = [0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5];
const LANE_CENTRES: [f32; 8] = [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5];

fn draw(s: &Candidate, rows: &Rows, height: usize, ids: &mut [u32], qs: &mut [f32]) {
    let y0 = (s.rows[0] as usize).max(rows.first);
    let y1 = (s.rows[1] as usize).min(rows.first + height);
    if s.columns[1] - s.columns[0] <= 4 {
        return draw_narrow(s, rows, y0..y1, ids, qs);
    }
    let x0 = s.columns[0] as usize / LANES * LANES;
    let x1 = s.columns[1] as usize;
    let (edges, plane) = (s.edges(), s.depth());
    let id = u32x8::splat(s.triangle);
    let centres = f32x8::new(LANE_CENTRES);
    let ex = edges.map(|e| f32x8::splat(e.x));
    let dy = edges.map(|e| f32x8::splat(e.dy));
    let least = edges.map(|e| f32x8::splat(e.least));
    let (qx, q_lo, q_hi) = (f32x8::splat(plane.qx), f32x8::splat(s.q_range[0]), f32x8::splat(s.q_range[1]));
    for y in y0..y1 {
        let yc = y as f32 + 0.5;
        let t = edges.map(|e| f32x8::splat(-(yc - e.y) * e.dx));
        let q_row = f32x8::splat(plane.q + plane.qy * (yc - plane.y0));
        let row = (y - rows.first) * rows.stride;
        for x in (x0..x1).step_by(LANES) {
            let xc = f32x8::splat(x as f32) + centres;
            let inside = (xc - ex[0]).mul_add(dy[0], t[0]).simd_ge(least[0])
                & (xc - ex[1]).mul_add(dy[1], t[1]).simd_ge(least[1])
                & (xc - ex[2]).mul_add(dy[2], t[2]).simd_ge(least[2]);
            if inside.to_bitmask() == 0 {
                continue;
            }
            let at = row + x;
            let old_q = load(&qs[at..at + LANES]);
            let q = (xc - f32x8::splat(plane.x0)).mul_add(qx, q_row).fast_max(q_lo).fast_min(q_hi);
            let nearer = inside & q.simd_gt(old_q);
            if nearer.to_bitmask() == 0 {
                continue;
            }
            qs[at..at + LANES].copy_from_slice(&nearer.bitselect(q, old_q).to_array());
            let old_id: [u32; LANES] = ids[at..at + LANES].try_into().expect("slice of eight");
            let mask: u32x8 = lane_bits(nearer);
            ids[at..at + LANES].copy_from_slice(&mask.bitselect(id, u32x8::new(old_id)).to_array());
        }
    }
}

/// The same for a narrow triangle: four columns of two rows at a time, without a branch for each pixel. The same operations, hence
/// the same bits.
#[inline(always)]
fn draw_narrow(s: &Candidate, rows: &Rows, ys: std::ops::Range<usize>, ids: &mut [u32], qs: &mut [f32]) {
    let x0 = (s.columns[0] as usize).min(rows.stride - 4);
    let xc = f32x8::splat(x0 as f32) + f32x8::new(NARROW_COLUMNS);
    let last = ys.end.saturating_sub(1);
    for y in ys.step_by(2) {
        let below = (y + 1).min(last);
        let at = [(y - rows.first) * rows.stride + x0, (below - rows.first) * rows.stride + x0];
        let old = pair_up(quad(qs, at[0]), quad(qs, at[1]));
        let old_q = f32x8::new(old);
        if f32x8::splat(s.q_range[1]).simd_gt(old_q).to_bitmask() == 0 {
            continue;
        }
        let (upper, lower) = (y as f32 + 0.5, below as f32 + 0.5);
        let yc = f32x8::new([upper, upper, upper, upper, lower, lower, lower, lower]);
        let holds = |e: &Edge| {
            let t = -(yc - f32x8::splat(e.y)) * f32x8::splat(e.dx);
            (xc - f32x8::splat(e.x)).mul_add(f32x8::splat(e.dy), t).simd_ge(f32x8::splat(e.least))
        };
        let [a, b, c] = s.edges();
        let inside = holds(&a) & holds(&b) & holds(&c);
        if inside.to_bitmask() == 0 {
            continue;
        }
        let plane = s.depth();
        let q_row = f32x8::splat(plane.q) + f32x8::splat(plane.qy) * (yc - f32x8::splat(plane.y0));
        let q = (xc - f32x8::splat(plane.x0)).mul_add(f32x8::splat(plane.qx), q_row);
        let q = q.fast_max(f32x8::splat(s.q_range[0])).fast_min(f32x8::splat(s.q_range[1]));
        let nearer = inside & q.simd_gt(old_q);
        let new_q = nearer.bitselect(q, old_q).to_array();
        let old_id = u32x8::new(pair_up(quad(ids, at[0]), quad(ids, at[1])));
        let new_id = lane_bits(nearer).bitselect(u32x8::splat(s.triangle), old_id).to_array();
        for (k, at) in at.into_iter().enumerate() {
            qs[at..at + 4].copy_from_slice(&new_q[4 * k..4 * k + 4]);
            ids[at..at + 4].copy_from_slice(&new_id[4 * k..4 * k + 4]);
        }
    }
}

/// Four values of a row.
#[inline(always)]
fn quad<T: Copy>(values: &[T], at: usize) -> [T; 4] {
    values[at..at + 4].try_into().expect("slice of four")
}

#[inline(always)]
fn pair_up<T: Copy>([a, b, c, d]: [T; 4], [e, f, g, h]: [T; 4]) -> [T; 8] {
    [a, b, c, d, e, f, g, h]
}

fn load(s: &[f32]) -> f32x8 {
    let a: [f32; LANES] = s.try_into().expect("slice of eight");
    f32x8::new(a)
}

/// Lane masks as integers.
fn lane_bits(mask: f32x8) -> u32x8 {
    u32x8::new(mask.to_array().map(f32::to_bits))
}

/// The slow path of surfaces with alpha cutouts: one pixel at a time, the cutout asked before the depth is written.
fn draw_cutout(g: &Geometry, s: &Candidate, rows: &Rows, height: usize, keep: Cutout, ids: &mut [u32], qs: &mut [f32]) {
    let y0 = (s.rows[0] as usize).max(rows.first);
    let y1 = (s.rows[1] as usize).min(rows.first + height);
    let (edges, plane) = (s.edges(), s.depth());
    for y in y0..y1 {
        let yc = y as f32 + 0.5;
        for x in s.columns[0] as usize..s.columns[1] as usize {
            let xc = x as f32 + 0.5;
            let inside = edges.iter().all(|e| e.holds(xc, yc));
            let at = (y - rows.first) * rows.stride + x;
            let q = plane.at(xc, yc, s.q_range);
            if inside && q > qs[at] && keep(s.triangle, weights_at(g, s.triangle, x, y)) {
                qs[at] = q;
                ids[at] = s.triangle;
            }
        }
    }
}

/// Perspective-correct weights for all covered pixels of a band.
fn resolve(g: &Geometry, rows: &Rows, triangle: &[u32], bary: &mut [[f32; 2]]) {
    let mut current = NONE;
    let mut affine = None;
    for (row, (ids, out)) in triangle.chunks(rows.width).zip(bary.chunks_mut(rows.width)).enumerate() {
        let y = rows.first + row;
        for (x, (&id, out)) in ids.iter().zip(out).enumerate() {
            if id == NONE {
                continue;
            }
            if id != current {
                current = id;
                affine = Weights::new(corners(g, id));
            }
            *out = match &affine {
                Some(w) => w.at(x as f32 + 0.5, y as f32 + 0.5),
                None => {
                    let [b0, b1, _] = ray_weights(g, id, x, y);
                    [b0, b1]
                }
            };
        }
    }
}

fn weights_at(g: &Geometry, id: u32, x: usize, y: usize) -> [f32; 3] {
    match Weights::new(corners(g, id)) {
        Some(w) => {
            let [b0, b1] = w.at(x as f32 + 0.5, y as f32 + 0.5);
            [b0, b1, 1.0 - b0 - b1]
        }
        None => ray_weights(g, id, x, y),
    }
}

fn corners(g: &Geometry, id: u32) -> [ScreenPoint; 3] {
    g.triangles[id as usize].map(|c| g.screen[c as usize])
}

/// Weights from the pixel's ray, b_i ∝ d · (v_j × v_k): right for triangles that reach behind the camera too.
fn ray_weights(g: &Geometry, id: u32, x: usize, y: usize) -> [f32; 3] {
    let v = g.triangles[id as usize].map(|c| g.camera.to_view(g.positions[c as usize]));
    let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
    let d = DVec3::new((pixel.x - g.camera.cx) / g.camera.fx, (pixel.y - g.camera.cy) / g.camera.fy, 1.0);
    let w = [d.dot(v[1].cross(v[2])), d.dot(v[2].cross(v[0])), d.dot(v[0].cross(v[1]))];
    let sum = w[0] + w[1] + w[2];
    w.map(|w| if sum == 0.0 { 1.0 / 3.0 } else { (w / sum) as f32 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::blob;
    use animimic_math::gradcheck::SplitMix64;

    fn flat_camera(size: u32) -> Camera {
        // Screen x, y = world x, y at z = 1.
        let view_from_world = glam::DAffine3::IDENTITY;
        Camera { width: size, height: size, fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, view_from_world }
    }

    #[test]
    fn every_pixel_of_a_triangulated_square_is_covered_exactly_once() {
        // Vertices on a quarter-pixel grid, so that edges pass exactly through pixel centres, with split (duplicated) vertices.
        let mut rng = SplitMix64(7);
        let n = 12;
        let size = 32.0;
        let mut grid = vec![DVec3::ZERO; (n + 1) * (n + 1)];
        for j in 0..=n {
            for i in 0..=n {
                let inner = i > 0 && j > 0 && i < n && j < n;
                let jitter =
                    |rng: &mut SplitMix64| if inner { (rng.uniform() * 5.0 - 2.5).round() * 0.25 } else { 0.0 };
                let (x, y) = (i as f64 * size / n as f64, j as f64 * size / n as f64);
                let quarter = |v: f64| (v * 4.0).round() / 4.0;
                grid[j * (n + 1) + i] = DVec3::new(quarter(x) + jitter(&mut rng), quarter(y) + jitter(&mut rng), 1.0);
            }
        }
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for j in 0..n {
            for i in 0..n {
                let at = |i: usize, j: usize| grid[j * (n + 1) + i];
                for t in [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]] {
                    let first = positions.len() as u32;
                    positions.extend(t);
                    triangles.push([first, first + 1, first + 2]);
                }
            }
        }
        let camera = flat_camera(32);
        let mut count = vec![0; 32 * 32];
        for t in &triangles {
            let raster = rasterize(&camera, &positions, &[*t]);
            (0..32 * 32).for_each(|p| count[p] += usize::from(raster.covered(p)));
        }
        let wrong = count.iter().filter(|&&c| c != 1).count();
        println!("pixels not covered exactly once: {wrong} of 1024");
        assert_eq!(wrong, 0);
    }

    #[test]
    fn weights_reproduce_the_point_and_its_depth_and_the_nearest_surface_wins() {
        let mesh = blob(30, 20);
        let camera = Camera::orbit(DVec3::ZERO, 3.0, 0.3, 0.4, 0.9, 90, 70);
        let raster = rasterize(&camera, &mesh.positions, &mesh.triangles);
        let (mut off, mut depth, mut covered) = (0.0f64, 0.0f64, 0);
        for pixel in (0..90 * 70).filter(|&p| raster.covered(p)) {
            let corners = mesh.triangles[raster.triangle[pixel] as usize].map(|v| mesh.positions[v as usize]);
            let b = raster.weights(pixel).map(f64::from);
            let point = corners[0] * b[0] + corners[1] * b[1] + corners[2] * b[2];
            let view = camera.to_view(point);
            let centre = DVec2::new((pixel % 90) as f64 + 0.5, (pixel / 90) as f64 + 0.5);
            off = off.max(camera.pixel_from_view(view).distance(centre));
            depth = depth.max((view.z - raster.depth(pixel).unwrap_or(0.0)).abs());
            assert!(view.z < 3.0, "the front of the blob is visible, not its back");
            covered += 1;
        }
        println!("{covered} pixels: worst offset {off:.1e} px, worst depth error {depth:.1e}");
        assert!(covered > 1000 && off < 1e-3 && depth < 1e-5);
    }

    #[test]
    fn threads_bands_and_odd_widths_give_the_same_bytes() {
        let mesh = blob(60, 40);
        for (w, h) in [(128, 128), (61, 97), (7, 3)] {
            let camera = Camera::orbit(DVec3::ZERO, 2.4, 0.3, 0.4, 0.9, w, h);
            let serial = rasterize(&camera, &mesh.positions, &mesh.triangles);
            assert!(serial == rasterize_parallel(&camera, &mesh.positions, &mesh.triangles), "{w}x{h}");
            assert!(serial.triangle.iter().any(|&t| t != NONE));
        }
    }

    #[test]
    fn triangles_that_cross_the_camera_plane_are_cut_and_those_behind_dropped() {
        let camera = Camera::orbit(DVec3::ZERO, 1.0, 0.0, 0.0, 1.0, 64, 64);
        // A floor from far in front to far behind the camera.
        let floor = [DVec3::new(-50.0, -0.3, -50.0), DVec3::new(50.0, -0.3, -50.0), DVec3::new(0.0, -0.3, 80.0)];
        let raster = rasterize(&camera, &floor, &[[0, 2, 1]]);
        let (mut worst, mut covered) = (0.0f64, 0);
        for pixel in (0..64 * 64).filter(|&p| raster.covered(p)) {
            let b = raster.weights(pixel).map(f64::from);
            let v = camera.to_view(floor[0] * b[0] + floor[2] * b[1] + floor[1] * b[2]);
            let centre = DVec2::new((pixel % 64) as f64 + 0.5, (pixel / 64) as f64 + 0.5);
            let off = camera.pixel_from_view(v).distance(centre);
            worst = worst.max(off);
            assert!(pixel / 64 >= 32, "the floor is below the horizon");
            covered += 1;
        }
        println!("{covered} pixels of floor, worst offset {worst:.1e} px");
        assert!(covered > 1500 && worst < 1e-2);
        let behind = floor.map(|p| p + DVec3::Z * 100.0);
        assert!(rasterize(&camera, &behind, &[[0, 2, 1]]).triangle.iter().all(|&t| t == NONE));
        let broken = [DVec3::NAN, DVec3::X, DVec3::Y];
        assert!(rasterize(&camera, &broken, &[[0, 1, 2], [0, 1, 9]]).triangle.iter().all(|&t| t == NONE));
    }
}
