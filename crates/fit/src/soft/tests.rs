//! Stiffness from what is seen, on a creature whose truth is known.

use super::clusters::Groups;
use super::estimate::{Clip, Problem};
use super::evidence::{Evidence, Residual};
use super::fixtures::{ARM_JOINTS, camera, shaken, three_arms};
use super::seen::Seen;
use super::{Settings, Stepping, Tissue};
use crate::rendered::{Levels, MaskLoss, Observed, RgbLoss, View, Weighted, Window};
use crate::stage1::sight::{Sight, Studio};
use crate::stage1::subject::Subject;
use crate::stage1::{Input, stage};
use animimic_render::{Light, Surface, rasterize_surface};
use animimic_scene::{Asset, Camera, DepthKind, Image, Mask, Motion, Tracks};
use animimic_sim::{Elasticity, Model, simulate_vjp};
use glam::DVec3;

const SIZE: usize = 160;
const FPS: f64 = 24.0;
/// Moduli of the arms [Pa], and where the fit begins.
const TRUTH: [f64; 3] = [6e4, 2e5, 8e5];
const PRIOR: f64 = 1e5;

fn tissue(asset: &Asset) -> Tissue<'_> {
    let settings = Settings { tets: 700, loose: ARM_JOINTS.to_vec(), ..Settings::default() };
    Tissue::new(asset, &settings).expect("a closed surface")
}

/// Everything has one modulus, in groups.
fn prior(tissue: &Tissue, groups: &Groups) -> Elasticity {
    let one = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), PRIOR, 0.4, 1000.0);
    Elasticity { cluster: groups.of_tets(tissue), ln_youngs: vec![PRIOR.ln(); groups.parents.len()], ..one }
}

fn truth(tissue: &Tissue, groups: &Groups) -> Elasticity {
    let mut material = prior(tissue, groups);
    for (joint, young) in ARM_JOINTS.iter().zip(TRUTH) {
        material.ln_youngs[groups.of_joint[*joint] as usize] = young.ln();
    }
    material
}

/// Surfaces of a material \[frame\]\[vertex\].
fn surfaces(tissue: &Tissue, material: &Elasticity, motion: &Motion) -> Vec<Vec<DVec3>> {
    let stepping = Stepping { tolerance: 1e-4, ..Stepping::default() };
    let start = tissue.start(material, &stepping, &motion.poses[0]).expect("a sound material");
    let simulated =
        tissue.simulate_from(start, material, &stepping, &motion.poses, motion.fps, 1).expect("a sound material");
    simulated.surfaces(tissue, &motion.poses)
}

/// Calls `work` with evidence of true tracks, and with pictures of the truth, in frames of `SIZE` pixels.
fn with_evidence(asset: &Asset, truth: &[Vec<DVec3>], contour: f64, work: impl FnOnce(&Seen)) {
    let subject = Subject::new(asset).expect("can be drawn");
    let (camera, light, blank) = (camera(SIZE as u32), Light::ambient(1.0), Image::filled(SIZE, SIZE, [240; 3]));
    let studio = Studio { camera: &camera, light: &light };
    let rest = subject.tree.kinematics.rest();
    let draw = |x: &Vec<DVec3>| Sight::draw_surface(&subject, &studio, &blank, subject.posed(&rest), x.clone());
    let sights: Vec<Sight> = truth.iter().map(draw).collect();
    let frames: Vec<Image> = sights.iter().map(|s| s.image.clone()).collect();
    let masks: Vec<Mask> = sights.iter().map(|s| s.raster.mask()).collect();
    let at: Vec<usize> = (0..SIZE * SIZE).step_by(11).filter(|&p| sights[0].raster.covered(p)).collect();
    let points: Vec<_> = at.iter().map(|&p| sights[0].point(&subject, p)).collect();
    let pixels = |x: &Vec<DVec3>| {
        points.iter().map(|p| camera.project(p.position(x)).to_array().map(|v| v as f32)).collect::<Vec<_>>()
    };
    let tracks = Tracks {
        pixels: truth.iter().map(pixels).collect(),
        confidence: vec![vec![1.0; points.len()]; truth.len()],
        query_frame: vec![0; points.len()],
    };
    let flow = |a: &Image, _: &Image| vec![[0.0; 2]; a.width * a.height];
    let input = Input {
        asset,
        camera: &camera,
        frames: &frames,
        masks: &masks,
        backgrounds: std::slice::from_ref(&blank),
        flow: &flow,
        tracks: Some(&tracks),
        depth: &[],
        depth_kind: DepthKind::Metric,
    };
    let settings = crate::stage1::Settings { contour, ..Default::default() };
    let stage = stage(&input, &subject, &light, settings);
    let still = vec![asset.mesh.positions.clone(); truth.len()];
    work(&Seen::new(&stage, &still, 5.0));
}

#[test]
fn true_tracks_tell_the_stiffness_of_every_arm_and_not_that_of_the_body() {
    let asset = three_arms();
    let tissue = tissue(&asset);
    let groups = Groups::new(&tissue, 16);
    let motion = shaken(&asset, 25, FPS);
    let real = surfaces(&tissue, &truth(&tissue, &groups), &motion);
    with_evidence(&asset, &real, 0.0, |seen| {
        let problem = Problem {
            tissue: &tissue,
            clips: &[Clip { poses: &motion.poses, fps: FPS, evidence: seen }],
            substeps: 1,
            prior_deviations: &vec![2.3; groups.parents.len()],
            groups: Some(&groups),
            damping: false,
            pictures: false,
        };
        let found = problem.fit(&prior(&tissue, &groups), None, 14).expect("there is evidence");
        println!("energies {:.3?}, clusters {:?}", found.energies, found.clusters);
        for (joint, young) in ARM_JOINTS.iter().zip(TRUTH) {
            let group = groups.of_joint[*joint] as usize;
            let fitted = found.elasticity.ln_youngs[group].exp();
            println!("arm {joint}: E {fitted:.0} Pa, truth {young:.0}, ln E ± {:.3}", found.deviations[group]);
            assert!((fitted / young - 1.0).abs() < 0.05 && found.deviations[group] < 0.1);
        }
    });
}

#[test]
fn the_gradient_of_ln_e_is_that_of_the_adjoint_and_of_differences() {
    let asset = three_arms();
    let tissue = tissue(&asset);
    let groups = Groups::new(&tissue, 16);
    let motion = shaken(&asset, 9, FPS);
    let real = surfaces(&tissue, &truth(&tissue, &groups), &motion);
    let material = prior(&tissue, &groups);
    with_evidence(&asset, &real, 150.0, |seen| {
        let clip = Clip { poses: &motion.poses, fps: FPS, evidence: seen };
        let problem = |pictures: bool| Problem {
            tissue: &tissue,
            clips: std::slice::from_ref(&clip),
            substeps: 1,
            prior_deviations: &[1.0; 4],
            groups: Some(&groups),
            damping: false,
            pictures,
        };
        // Sensitivities forwards against the adjoint backwards, with pictures and residuals.
        let forward = problem(true).gradient(&material, 0.0).expect("a sound material");
        let stepping = Stepping { tolerance: 1e-3, ..Stepping::default() };
        let start = tissue.start(&material, &stepping, &motion.poses[0]).expect("a sound material");
        let s = tissue.simulate_from(start, &material, &stepping, &motion.poses, FPS, 1).expect("a sound material");
        let d_frames: Vec<Vec<DVec3>> = s
            .frames()
            .enumerate()
            .skip(1)
            .map(|(t, cage)| {
                let surface = tissue.surface(cage, &tissue.world(&motion.poses[t]));
                let mut d = seen.rendered(t, &surface, true).1;
                for r in seen.residuals(t, &surface) {
                    let pull = 2.0 * r.weight * r.robust.weight(r.value.abs()) * r.value;
                    r.gradient.iter().for_each(|(v, g)| d[*v as usize] += *g * pull);
                }
                tissue.surface_vjp(&d)
            })
            .collect();
        let backward = simulate_vjp(&tissue.body, &material, &s.settings, &s.simulation, &d_frames)
            .expect("a sound simulation")
            .d_ln_youngs;
        let size = forward.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        let apart = forward.iter().zip(&backward).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / size;
        println!("forward {forward:.6?}, adjoint {backward:.6?}: {apart:.1e}");
        assert!(apart < 1e-5);
        // Residuals of tracks and contours are smooth: differences of the whole chain.
        let exact = problem(false).gradient(&material, 0.0).expect("a sound material");
        for (g, along) in exact.iter().enumerate() {
            let numeric = difference(&problem(false), &material, g, 0.02);
            println!("group {g}: {along:.6} {numeric:.6}");
            assert!((along - numeric).abs() < 1e-3 * size);
        }
    });
}

/// ∂(energy)/∂ln E of a group by differences over `h` and twice that.
fn difference(problem: &Problem, material: &Elasticity, group: usize, h: f64) -> f64 {
    let at = |h: f64| {
        let mut moved = material.clone();
        moved.ln_youngs[group] += h;
        problem.energy(&moved, 0.0).expect("a sound material")
    };
    let over = |h: f64| (at(h) - at(-h)) / (2.0 * h);
    (4.0 * over(h) - over(2.0 * h)) / 3.0
}

/// How far the gradient of what pictures say is off differences, at most, as a share of its largest part.
fn gradient_error(
    tissue: &Tissue,
    groups: &Groups,
    motion: &Motion,
    material: &Elasticity,
    evidence: &dyn Evidence,
) -> f64 {
    let problem = Problem {
        tissue,
        clips: &[Clip { poses: &motion.poses, fps: FPS, evidence }],
        substeps: 1,
        prior_deviations: &[1.0; 4],
        groups: Some(groups),
        damping: false,
        pictures: true,
    };
    let gradient = problem.gradient(material, 0.0).expect("a sound material");
    let size = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    let error = |(g, along): (usize, &f64)| {
        let numeric = difference(&problem, material, g, 0.05);
        let error = (along - numeric).abs() / size;
        println!("group {g}: {along:.7} {numeric:.7}, off by {error:.1e} of the largest");
        error
    };
    let errors: Vec<f64> = gradient.iter().enumerate().map(error).collect();
    assert!(errors.iter().all(|e| e.is_finite()));
    errors.into_iter().fold(0.0, f64::max)
}

/// A camera shifted evenly over two pixels, `count` times along each axis.
fn shifted(base: Camera, count: usize) -> Vec<Camera> {
    let step = |k: usize| 2.0 * ((k as f64 + 0.5) / count as f64 - 0.5);
    let one = |k: usize| Camera { cx: base.cx + step(k % count), cy: base.cy + step(k / count), ..base };
    (0..count * count).map(one).collect()
}

/// The picture of one frame, close up: all of it shows the inside of an arm. Averaged over sub-pixel shifts, because there is a small kink
/// where a pixel's centre passes from triangle to triangle.
struct CloseUp<'a> {
    frame: usize,
    surface: &'a Surface,
    light: Light,
    background: &'a Image,
    /// Cameras with the frames that they saw.
    shots: Vec<(Camera, Image, Mask)>,
}

impl Evidence for CloseUp<'_> {
    fn residuals(&self, _: usize, _: &[DVec3]) -> Vec<Residual> {
        Vec::new()
    }

    fn rendered(&self, frame: usize, surface: &[DVec3], gradient: bool) -> (f64, Vec<DVec3>) {
        let mut sum = (0.0, vec![DVec3::ZERO; surface.len()]);
        let rgb = RgbLoss(Levels { count: 3, softness: 0.3 });
        let losses = [Weighted { loss: &rgb, weight: 1.0 / self.shots.len() as f64 }];
        for (camera, image, mask) in self.shots.iter().filter(|_| frame == self.frame) {
            let view = View { surface: self.surface, camera };
            let seen = Observed { image, background: self.background, mask: mask.clone(), divisor_px: 900.0 };
            let (values, forces) = view.evaluate(&losses, &seen, &self.light, surface, gradient);
            sum.0 += losses[0].weight * values[0];
            sum.1.iter_mut().zip(forces).for_each(|(a, b)| *a += b);
        }
        sum
    }

    fn observations(&self) -> f64 {
        1.0
    }
}

#[test]
fn a_picture_has_the_right_gradient_to_ln_e_through_renderer_embedding_and_simulation() {
    const PX: usize = 64;
    const FRAME: usize = 8;
    let asset = three_arms();
    let tissue = tissue(&asset);
    let groups = Groups::new(&tissue, 16);
    let motion = shaken(&asset, FRAME + 1, FPS);
    let material = prior(&tissue, &groups);
    let (real, now) = (surfaces(&tissue, &truth(&tissue, &groups), &motion), surfaces(&tissue, &material, &motion));
    let subject = Subject::new(&asset).expect("can be drawn");
    // Half way along the first arm, on the side that looks at the camera.
    let place = DVec3::new(0.1, 0.5, 0.2);
    let nearest = (0..now[0].len())
        .min_by(|&a, &b| asset.mesh.positions[a].distance(place).total_cmp(&asset.mesh.positions[b].distance(place)))
        .expect("there are vertices");
    let background = Image::filled(PX, PX, [240; 3]);
    let near = Camera::orbit(now[FRAME][nearest], 2.0, 0.0, 0.0, 0.02, PX as u32, PX as u32);
    let shots = shifted(near, 4)
        .into_iter()
        .map(|camera| {
            let light = Light::ambient(1.0);
            let studio = Studio { camera: &camera, light: &light };
            let posed = subject.posed(&subject.tree.kinematics.rest());
            let sight = Sight::draw_surface(&subject, &studio, &background, posed, real[FRAME].clone());
            let mask = sight.raster.mask();
            assert!(mask.coverage.iter().all(|c| *c == 255), "the arm fills the picture");
            (camera, sight.image, mask)
        })
        .collect();
    let evidence =
        CloseUp { frame: FRAME, surface: &subject.surface, light: Light::ambient(1.0), background: &background, shots };
    assert!(gradient_error(&tissue, &groups, &motion, &material, &evidence) < 1e-3);
}

/// The silhouette of one frame. Its gradient is the renderer's, averaged over sub-pixel shifts as in the renderer's own check; its value is
/// that of the coverage of finer pictures, which an outline does not cross in steps.
struct Outline<'a> {
    frame: usize,
    surface: &'a Surface,
    background: &'a Image,
    /// Cameras with the masks that they saw: for the gradient, and for the value.
    shots: [Vec<(Camera, Mask)>; 2],
}

impl Outline<'_> {
    const PX: usize = 256;
    const FINER: usize = 8;
    const LEVELS: Levels = Levels { count: 3, softness: 0.3 };
    const DIVISOR_PX: f64 = 900.0;

    /// Share of every pixel that a surface covers.
    fn coverage(camera: &Camera, surface: &Surface, positions: &[DVec3]) -> Vec<f32> {
        let side = Self::PX * Self::FINER;
        let raster = rasterize_surface(&camera.resized(side as u32, side as u32), surface, positions, true);
        let mut covered = vec![0u16; Self::PX * Self::PX];
        for p in (0..side * side).filter(|&p| raster.covered(p)) {
            covered[p / side / Self::FINER * Self::PX + p % side / Self::FINER] += 1;
        }
        covered.iter().map(|c| f32::from(*c) / (Self::FINER * Self::FINER) as f32).collect()
    }
}

impl Evidence for Outline<'_> {
    fn residuals(&self, _: usize, _: &[DVec3]) -> Vec<Residual> {
        Vec::new()
    }

    fn rendered(&self, frame: usize, surface: &[DVec3], gradient: bool) -> (f64, Vec<DVec3>) {
        let (mut sum, mut forces) = (0.0, vec![DVec3::ZERO; surface.len()]);
        let shots = &self.shots[usize::from(!gradient)];
        for (camera, mask) in shots.iter().filter(|_| frame == self.frame) {
            let share = 1.0 / shots.len() as f64;
            if !gradient {
                let window = Window { x0: 0, y0: 0, width: Self::PX, height: Self::PX };
                let coverage = Self::coverage(camera, self.surface, surface);
                let residual: Vec<f32> =
                    coverage.iter().zip(&mask.coverage).map(|(c, m)| c - f32::from(*m) / 255.0).collect();
                sum += share * Self::LEVELS.loss(&residual, window, 1, Self::DIVISOR_PX, false).0;
                continue;
            }
            let (view, loss) = (View { surface: self.surface, camera }, MaskLoss(Self::LEVELS));
            let seen = Observed {
                image: self.background,
                background: self.background,
                mask: mask.clone(),
                divisor_px: Self::DIVISOR_PX,
            };
            let losses = [Weighted { loss: &loss, weight: share }];
            let (_, pull) = view.evaluate(&losses, &seen, &Light::ambient(1.0), surface, true);
            forces.iter_mut().zip(pull).for_each(|(a, b)| *a += b);
        }
        (sum, forces)
    }

    fn observations(&self) -> f64 {
        1.0
    }
}

#[test]
fn a_silhouette_has_the_gradient_to_ln_e_that_finer_pictures_have() {
    const FRAME: usize = 8;
    let asset = three_arms();
    let tissue = tissue(&asset);
    let groups = Groups::new(&tissue, 16);
    let motion = shaken(&asset, FRAME + 1, FPS);
    let material = prior(&tissue, &groups);
    let real = surfaces(&tissue, &truth(&tissue, &groups), &motion);
    let subject = Subject::new(&asset).expect("can be drawn");
    let background = Image::filled(Outline::PX, Outline::PX, [240; 3]);
    let shot = |camera: Camera| {
        let coverage = Outline::coverage(&camera, &subject.surface, &real[FRAME]);
        let coverage = coverage.iter().map(|c| (255.0 * c + 0.5) as u8).collect();
        (camera, Mask { width: Outline::PX, height: Outline::PX, coverage })
    };
    let shots = [8, 4].map(|count| shifted(camera(Outline::PX as u32), count).into_iter().map(shot).collect());
    let evidence = Outline { frame: FRAME, surface: &subject.surface, background: &background, shots };
    assert!(gradient_error(&tissue, &groups, &motion, &material, &evidence) < 3e-2);
}
