//! Every rendered loss × the rig driver, through the whole chain from the picture to the joints.

use super::*;
use animimic_math::gradcheck::SplitMix64;
use animimic_render::{rasterize_surface, shade};
use animimic_rig::Share;
use animimic_scene::{Image, Look, Mask, Mesh, Part};
use glam::DVec2;
use std::f64::consts::{PI, TAU};

const SIZE: usize = 96;
/// Samples a pixel and axis of the reference picture.
const SUPERSAMPLES: usize = 16;
/// Sub-pixel shifts an axis, for our gradient and for the reference.
const SHIFTS: (usize, usize) = (8, 4);
const BEHIND: [u8; 3] = [215; 3];

fn levels() -> Levels {
    Levels { count: 3, softness: 0.3 }
}

fn losses() -> Vec<Box<dyn PictureLoss>> {
    vec![Box::new(RgbLoss(levels())), Box::new(MaskLoss(levels()))]
}

struct Stand {
    kinematics: Kinematics,
    vertices: Vec<Anchor>,
    surface: Surface,
    camera: Camera,
    light: Light,
}

impl Stand {
    fn new(kinematics: Kinematics, vertices: Vec<Anchor>, mut mesh: Mesh, camera: Camera, unlit: bool) -> Self {
        // Linear over the surface, so that colours have no kinks between triangles.
        let color = |p: &DVec3| [0.5 + 0.2 * p.x, 0.4 + 0.15 * p.y + 0.1 * p.z, 0.5 - 0.1 * p.x + 0.2 * p.z];
        mesh.colors = mesh.positions.iter().map(|p| color(p).map(|c| c as f32)).collect();
        let whole = Part { vertices: 0..mesh.positions.len(), triangles: 0..mesh.triangles.len(), ..Part::default() };
        mesh.parts = vec![whole];
        let look = Look { double_sided: true, unlit, ..Look::default() };
        let surface = Surface::new(&mesh, &[look]).expect("the test made it so");
        Self { kinematics, vertices, surface, camera, light: Light::ambient(1.0) }
    }

    /// A closed, tapered body with a chain of three joints, the first of which slides too.
    fn body() -> Self {
        let (around, along) = (28, 28);
        let mut mesh = Mesh::default();
        for k in 0..(along + 1) * around {
            let (a, u) = (TAU * (k % around) as f64 / around as f64, (k / around) as f64 / along as f64);
            let b = PI * (0.002 + 0.996 * u);
            let r = b.sin() * (0.55 + 0.1 * b.cos());
            mesh.positions.push(DVec3::new(-1.3 * b.cos(), r * a.cos(), r * a.sin()));
        }
        for k in 0..along * around {
            let (row, i) = (k / around * around, k % around);
            let at = |r: usize, i: usize| (r + i % around) as u32;
            let below = row + around;
            mesh.triangles.push([at(row, i), at(row, i + 1), at(below, i + 1)]);
            mesh.triangles.push([at(row, i), at(below, i + 1), at(below, i)]);
        }
        let pivots = [-0.7, 0.0, 0.6].map(|x| DVec3::X * x).to_vec();
        let kinematics = Kinematics::new(vec![None, Some(0), Some(1)], pivots, vec![true; 3], vec![true, false, false]);
        let vertices = mesh.positions.iter().map(|x| chained(*x, &[-0.2, 0.5])).collect();
        let camera = Camera::orbit(DVec3::ZERO, 4.5, 0.4, 0.2, 0.65, SIZE as u32, SIZE as u32);
        Self::new(kinematics, vertices, mesh, camera, false)
    }

    fn shifted(&self, shift: DVec2) -> Camera {
        Camera { cx: self.camera.cx + shift.x, cy: self.camera.cy + shift.y, ..self.camera }
    }

    fn model<'a>(&'a self, camera: &'a Camera) -> Model<'a> {
        Model { kinematics: &self.kinematics, vertices: &self.vertices, surface: &self.surface, camera }
    }

    fn pose(&self, amount: f64, seed: u64) -> FramePose {
        let mut rng = SplitMix64(seed);
        let step: Vec<f64> = (0..self.kinematics.dimension).map(|_| amount * rng.normal()).collect();
        self.kinematics.retract(&self.kinematics.rest(), &step)
    }

    /// Supersampled picture over the plain background, and coverage, averaged over pixels.
    fn fine(&self, camera: &Camera, pose: &FramePose) -> (Vec<[f32; 3]>, Vec<f32>) {
        let posed = self.kinematics.pose(pose);
        let positions: Vec<DVec3> = self.vertices.iter().map(|a| a.position(&posed)).collect();
        let side = SIZE * SUPERSAMPLES;
        let fine = camera.resized(side as u32, side as u32);
        let raster = rasterize_surface(&fine, &self.surface, &positions, true);
        let behind = BEHIND.map(|c| f32::from(c) / 255.0);
        let rgb = shade(&fine, &self.surface, &positions, &raster, &self.light, behind, true);
        let (mut color, mut coverage) = (vec![[0.0; 3]; SIZE * SIZE], vec![0.0; SIZE * SIZE]);
        let share = 1.0 / (SUPERSAMPLES * SUPERSAMPLES) as f32;
        for p in 0..side * side {
            let cell = p / side / SUPERSAMPLES * SIZE + p % side / SUPERSAMPLES;
            (0..3).for_each(|c| color[cell][c] += share * rgb[p][c]);
            coverage[cell] += if raster.covered(p) { share } else { 0.0 };
        }
        (color, coverage)
    }

    /// The frame that shows a pose, as a video would hold it.
    fn frame(&self, camera: &Camera, pose: &FramePose) -> (Image, Mask) {
        let (color, coverage) = self.fine(camera, pose);
        let byte = |v: f32| (255.0 * v + 0.5) as u8;
        let rgb = color.iter().map(|c| c.map(byte)).collect();
        let mask = Mask { width: SIZE, height: SIZE, coverage: coverage.into_iter().map(byte).collect() };
        (Image { width: SIZE, height: SIZE, rgb }, mask)
    }

    /// The loss of the supersampled picture, by the definition: cells of its pixel means.
    fn reference(&self, name: &str, camera: &Camera, pose: &FramePose, seen: &Observed) -> f64 {
        let (color, coverage) = self.fine(camera, pose);
        let all = Window { x0: 0, y0: 0, width: SIZE, height: SIZE };
        let levels = levels();
        match name {
            "mask" => {
                let m = |p: usize| f32::from(seen.mask.coverage[p]) / 255.0;
                let residual: Vec<f32> = coverage.iter().enumerate().map(|(p, c)| c - m(p)).collect();
                levels.loss(&residual, all, 1, seen.divisor_px, false).0
            }
            "rgb" => {
                // What is neither drawn nor observed counts nothing: the frame and the background are equal there.
                let t = |p: usize, c: usize| f32::from(seen.image.rgb[p][c]) / 255.0;
                let residual: Vec<f32> =
                    (0..color.len()).flat_map(|p| [0, 1, 2].map(|c| color[p][c] - t(p, c))).collect();
                levels.loss(&residual, all, 3, seen.divisor_px, false).0
            }
            _ => unreachable!("{name} has no reference here"),
        }
    }
}

fn shifts(count: usize) -> Vec<DVec2> {
    let step = |k: usize| (k as f64 + 0.5) / count as f64 - 0.5;
    (0..count * count).map(|k| DVec2::new(step(k % count), step(k / count)) * 2.0).collect()
}

#[test]
fn every_rendered_loss_has_the_right_gradient_to_the_joints() {
    let stand = Stand::body();
    let (pose, truth) = (stand.pose(0.2, 3), stand.pose(0.2, 4));
    let background = Image::filled(SIZE, SIZE, BEHIND);
    let observe = |shift: &DVec2| {
        let camera = stand.shifted(*shift);
        let (image, mask) = stand.frame(&camera, &truth);
        (camera, image, mask)
    };
    let ours: Vec<_> = shifts(SHIFTS.0).iter().map(observe).collect();
    let theirs: Vec<_> = shifts(SHIFTS.1).iter().map(observe).collect();
    for (name, loss) in NAMES.iter().zip(losses()) {
        assert_eq!(loss.name(), *name);
        let losses = [Weighted { loss: loss.as_ref(), weight: 1.0 }];
        let mut gradient = vec![0.0; stand.kinematics.dimension];
        for (camera, image, mask) in &ours {
            let seen = Observed { image, background: &background, mask: mask.clone(), divisor_px: 900.0 };
            let g = stand.model(camera).evaluate(&losses, &seen, &stand.light, &pose, true).gradient;
            gradient.iter_mut().zip(g).for_each(|(a, b)| *a += b / ours.len() as f64);
        }
        let mut rng = SplitMix64(8);
        let pairs: Vec<(f64, f64)> = (0..3)
            .map(|_| {
                let direction: Vec<f64> = gradient.iter().map(|_| rng.normal()).collect();
                let along: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
                let h = 0.004;
                let at = |s: f64| -> f64 {
                    let step: Vec<f64> = direction.iter().map(|d| s * d).collect();
                    let moved = stand.kinematics.retract(&pose, &step);
                    let one = |(camera, image, mask): &(Camera, Image, Mask)| {
                        let seen = Observed { image, background: &background, mask: mask.clone(), divisor_px: 900.0 };
                        stand.reference(name, camera, &moved, &seen)
                    };
                    theirs.iter().map(one).sum::<f64>() / theirs.len() as f64
                };
                (along, (at(h) - at(-h)) / (2.0 * h))
            })
            .collect();
        let rms = (pairs.iter().map(|(_, n)| n * n).sum::<f64>() / pairs.len() as f64).sqrt();
        let worst = pairs.iter().map(|(a, n)| (a - n).abs() / n.abs().max(rms)).fold(0.0, f64::max);
        println!("{name} x rig: relative error {worst:.1e} of {pairs:.3?}");
        assert!(worst < 3e-2);
    }
}

/// An anchor that passes from joint to joint along x, half way at each of the places given.
fn chained(x: DVec3, places: &[f64]) -> Anchor {
    let passed = |k: usize| places.get(k).map_or(0.0, |p| 0.5 + 0.5 * (2.0 * (x.x - p)).tanh());
    let weight = |k: usize| if k == 0 { 1.0 } else { passed(k - 1) };
    let shares = (0..=places.len()).map(|k| (k, weight(k) * (1.0 - passed(k)))).scan(1.0, |left, (joint, w)| {
        let w = if joint == places.len() { *left } else { w.min(*left) };
        *left -= w;
        Some(Share { joint, weight: w, weighted_rest: x * w })
    });
    Anchor { shares: shares.collect() }
}

/// A sheet larger than the picture, bent by two joints with smooth weights.
fn sheet() -> Stand {
    let mut mesh = Mesh::default();
    let n = 64;
    for k in 0..(n + 1) * (n + 1) {
        let (u, v) = ((k % (n + 1)) as f64 / n as f64, (k / (n + 1)) as f64 / n as f64);
        mesh.positions.push(DVec3::new(4.0 * u - 2.0, 4.0 * v - 2.0, 0.0));
    }
    for k in 0..n * n {
        let a = (k / n * (n + 1) + k % n) as u32;
        let below = a + n as u32 + 1;
        mesh.triangles.extend([[a, a + 1, below + 1], [a, below + 1, below]]);
    }
    let kinematics =
        Kinematics::new(vec![None, Some(0)], vec![DVec3::ZERO, DVec3::X * 0.2], vec![true; 2], vec![true, false]);
    let vertices = mesh.positions.iter().map(|x| chained(*x, &[0.2])).collect();
    let camera = Camera::orbit(DVec3::ZERO, 3.0, 0.2, 0.1, 0.5, SIZE as u32, SIZE as u32);
    Stand::new(kinematics, vertices, mesh, camera, true)
}

#[test]
fn inside_the_surface_the_gradient_is_exact() {
    let stand = sheet();
    let (pose, truth) = (stand.pose(0.1, 5), stand.pose(0.1, 6));
    let background = Image::filled(SIZE, SIZE, BEHIND);
    let loss = RgbLoss(levels());
    let losses = [Weighted { loss: &loss, weight: 1.0 }];
    // Where a pixel's centre passes from triangle to triangle there is a small kink: shifts average it out.
    let frames: Vec<_> = shifts(4)
        .iter()
        .map(|shift| {
            let camera = stand.shifted(*shift);
            let (image, mask) = stand.frame(&camera, &truth);
            assert!(mask.coverage.iter().all(|&c| c == 255), "the sheet fills the picture");
            (camera, image, mask)
        })
        .collect();
    let evaluate = |pose: &FramePose, gradient: bool| -> (f64, Vec<f64>) {
        let mut sum = (0.0, vec![0.0; stand.kinematics.dimension]);
        for (camera, image, mask) in &frames {
            let seen = Observed { image, background: &background, mask: mask.clone(), divisor_px: 900.0 };
            let value = stand.model(camera).evaluate(&losses, &seen, &stand.light, pose, gradient);
            sum.0 += value.losses[0] / frames.len() as f64;
            sum.1.iter_mut().zip(value.gradient).for_each(|(a, b)| *a += b / frames.len() as f64);
        }
        sum
    };
    let gradient = evaluate(&pose, true).1;
    let scale = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let mut rng = SplitMix64(8);
    for _ in 0..4 {
        let direction: Vec<f64> = gradient.iter().map(|_| rng.normal()).collect();
        let along: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let at = |s: f64| {
            let step: Vec<f64> = direction.iter().map(|d| s * d).collect();
            evaluate(&stand.kinematics.retract(&pose, &step), false).0
        };
        // Fourth-order differences: steps large against single precision, small against the curve.
        let difference = |h: f64| (at(h) - at(-h)) / (2.0 * h);
        let numeric = (4.0 * difference(0.02) - difference(0.04)) / 3.0;
        let error = (along - numeric).abs() / numeric.abs().max(scale);
        println!("{along:.8} {numeric:.8}: relative error {error:.1e}");
        assert!(error < 1e-5);
    }
}
