//! Levenberg–Marquardt on SO(3)ᴶ × ℝ³ over many frames at once.
//!
//! Every frame contributes a dense block of normal equations; temporal smoothness couples it to its next two neighbours, so
//! the system is block-pentadiagonal in time and is solved by a block Cholesky factorisation (two frames a block).
//! Increments R ← R exp(δ); damping λ·diag(H), λ/5 on success, ×6 on failure.

use crate::normal::NormalEquations;
use crate::terms::{At, Context, Term};
use animimic_math::block_tridiagonal::{BlockTridiagonal, Factor};
use animimic_rig::{FramePose, Posed};
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::ops::Range;

pub use crate::smoothness::Smoothness;

/// A fitting problem over a range of frames.
pub struct Problem<'a> {
    /// Tree, camera, anchors.
    pub context: Context<'a>,
    /// All terms, priors included.
    pub terms: Vec<&'a dyn Term>,
    /// Smoothness over time.
    pub smoothness: Option<&'a Smoothness>,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Most iterations.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the energy by less than this share.
    pub tolerance: f64,
    /// First damping λ.
    pub damping: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_iterations: 40, tolerance: 1e-5, damping: 1e-2 }
    }
}

/// What a solve did.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Energy before and after each accepted step.
    pub energies: Vec<f64>,
    /// Steps whose energy was not a number: each was taken back and tried shorter.
    pub not_finite: usize,
}

const DAMPING_DOWN: f64 = 5.0;
const DAMPING_UP: f64 = 6.0;
const LEAST_DAMPING: f64 = 1e-7;
const MAX_REJECTIONS: usize = 8;
/// Steps whose energy is not a number after which a solve ends with the best so far: shortening does not help then.
const MAX_NOT_FINITE: usize = 3;
/// Added to every diagonal entry in the damping: parameters that nothing observes stay where they are.
const DIAGONAL_FLOOR: f64 = 1e-3;

/// Minimises the energy over the frames in `active`; poses outside it stay and hold their neighbours by smoothness.
/// Only descent is accepted, so an energy that is not a number is never arrived at; where it is none from the start, nothing moves.
pub fn solve(problem: &Problem, poses: &mut [FramePose], active: Range<usize>, options: &Options) -> Report {
    let mut posed = pose_all(problem, poses);
    let mut energy = total_energy(problem, poses, &posed, &active);
    let mut report = Report { energies: vec![energy], not_finite: usize::from(!energy.is_finite()) };
    if !energy.is_finite() {
        return report;
    }
    let mut damping = options.damping;
    for _ in 0..options.max_iterations {
        let model = linearize(problem, poses, &posed, &active);
        let mut accepted = None;
        for _ in 0..MAX_REJECTIONS {
            if let Some(step) = model.step(damping) {
                let trial = retract(problem, poses, &active, &step);
                let trial_posed: Vec<Posed> = pose_active(problem, &trial, &posed, &active);
                let trial_energy = total_energy(problem, &trial, &trial_posed, &active);
                if trial_energy < energy {
                    accepted = Some((trial, trial_posed, trial_energy));
                    break;
                }
                report.not_finite += usize::from(!trial_energy.is_finite());
                if report.not_finite >= MAX_NOT_FINITE {
                    return report;
                }
            }
            damping *= DAMPING_UP;
        }
        let Some((trial, trial_posed, trial_energy)) = accepted else { break };
        let gain = (energy - trial_energy) / energy.abs().max(1e-300);
        poses.clone_from_slice(&trial);
        (posed, energy) = (trial_posed, trial_energy);
        damping = (damping / DAMPING_DOWN).max(LEAST_DAMPING);
        report.energies.push(energy);
        if gain < options.tolerance {
            break;
        }
    }
    report
}

/// Energy of the active frames, with the smoothness that ties them to their neighbours.
pub fn total_energy(problem: &Problem, poses: &[FramePose], posed: &[Posed], active: &Range<usize>) -> f64 {
    let frames: Vec<f64> = active
        .clone()
        .into_par_iter()
        .map(|t| {
            let at = At { frame: t, pose: &poses[t], posed: &posed[t] };
            problem.terms.iter().map(|term| term.energy(&problem.context, &at)).sum::<f64>()
        })
        .collect();
    frames.iter().sum::<f64>() + problem.smoothness.map_or(0.0, |s| s.energy(posed, active))
}

/// Moves the active frames along a step \[frame · dimension\].
pub fn retract(problem: &Problem, poses: &[FramePose], active: &Range<usize>, step: &[f64]) -> Vec<FramePose> {
    let mut moved = poses.to_vec();
    let d = problem.context.kinematics.dimension;
    for (k, t) in active.clone().enumerate() {
        moved[t] = problem.context.kinematics.retract(&poses[t], &step[k * d..(k + 1) * d]);
    }
    moved
}

/// Forward kinematics of all frames.
pub(crate) fn pose_all(problem: &Problem, poses: &[FramePose]) -> Vec<Posed> {
    poses.iter().map(|p| problem.context.kinematics.pose(p)).collect()
}

/// The same where only the active frames have moved.
fn pose_active(problem: &Problem, poses: &[FramePose], old: &[Posed], active: &Range<usize>) -> Vec<Posed> {
    let mut posed = old.to_vec();
    for t in active.clone() {
        posed[t] = problem.context.kinematics.pose(&poses[t]);
    }
    posed
}

/// The Gauss–Newton model of the active frames.
pub struct Model {
    dimension: usize,
    /// Diagonal blocks, lower triangles valid.
    diagonal: Vec<Mat<f64>>,
    /// `next[t]` = block (t + 1, t); `after_next[t]` = block (t + 2, t).
    next: Vec<Mat<f64>>,
    after_next: Vec<Mat<f64>>,
    /// Half the energy's gradient, \[frame · dimension\].
    pub gradient: Vec<f64>,
}

/// Linearises all terms at the given poses.
pub fn linearize(problem: &Problem, poses: &[FramePose], posed: &[Posed], active: &Range<usize>) -> Model {
    let d = problem.context.kinematics.dimension;
    let normals: Vec<NormalEquations> = active
        .clone()
        .into_par_iter()
        .map(|t| {
            let at = At { frame: t, pose: &poses[t], posed: &posed[t] };
            let mut normal = NormalEquations::zeros(d);
            problem.terms.iter().for_each(|term| term.linearize(&problem.context, &at, &mut normal));
            normal
        })
        .collect();
    let n = normals.len();
    let mut model = Model {
        dimension: d,
        diagonal: normals.iter().map(|e| MatRef::from_row_major_slice(&e.hessian, d, d).to_owned()).collect(),
        next: vec![Mat::zeros(d, d); n.saturating_sub(1)],
        after_next: vec![Mat::zeros(d, d); n.saturating_sub(2)],
        gradient: normals.iter().flat_map(|e| e.gradient.iter().copied()).collect(),
    };
    if let Some(s) = problem.smoothness {
        s.linearize(problem.context.kinematics, posed, active, &mut model);
    }
    model
}

impl Model {
    /// The damped Gauss–Newton step, or `None` if the damped matrix is not positive definite.
    pub fn step(&self, damping: f64) -> Option<Vec<f64>> {
        let b: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        Some(self.factor(damping)?.solve(&b))
    }

    /// The factor of the damped Gauss–Newton matrix, or `None` if that is not positive definite.
    pub fn factor(&self, damping: f64) -> Option<Factor> {
        let (d, n) = (self.dimension, self.diagonal.len());
        let sizes: Vec<usize> = (0..n).step_by(2).map(|t| if t + 1 < n { 2 * d } else { d }).collect();
        let mut system = BlockTridiagonal::zeros(&sizes);
        for t in 0..n {
            let (block, offset) = (t / 2, (t % 2) * d);
            let mut target = system.diagonal[block].as_mut().submatrix_mut(offset, offset, d, d);
            target.copy_from(&self.diagonal[t]);
            for i in 0..d {
                target[(i, i)] += damping * (target[(i, i)] + DIAGONAL_FLOOR);
            }
            for (later, coupling) in [(t + 1, &self.next), (t + 2, &self.after_next)] {
                let Some(source) = coupling.get(t).filter(|_| later < n) else { continue };
                let (row, row_offset) = (later / 2, (later % 2) * d);
                let target = if row == block { &mut system.diagonal[block] } else { &mut system.below[block] };
                target.as_mut().submatrix_mut(row_offset, offset, d, d).copy_from(source);
            }
        }
        system.factored().ok()
    }

    /// Diagonal blocks of H⁻¹, one `dimension`² block per frame: how far each frame's parameters are from being determined,
    /// all others left free. `None` where H is not positive definite.
    pub fn spread(&self) -> Option<Vec<Mat<f64>>> {
        let d = self.dimension;
        let pairs = self.factor(LEAST_DAMPING)?.inverse_diagonal();
        let frame = |t: usize| pairs[t / 2].as_ref().submatrix((t % 2) * d, (t % 2) * d, d, d).to_owned();
        Some((0..self.diagonal.len()).map(frame).collect())
    }

    /// Blocks (t, t), (t + 1, t) and (t + 2, t) of H.
    pub(crate) fn bands(&mut self) -> [&mut [Mat<f64>]; 3] {
        [&mut self.diagonal, &mut self.next, &mut self.after_next]
    }

    /// Diagonal of H, \[frame · dimension\]: the information about each parameter taken alone.
    pub fn information(&self) -> Vec<f64> {
        self.diagonal.iter().flat_map(|m| (0..m.nrows()).map(|i| m[(i, i)])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};
    use animimic_rig::fixtures::creature;
    use animimic_rig::smoothness::pseudo_anchors;
    use animimic_rig::solve_tree::SolveTree;
    use animimic_rig::{Anchor, Kinematics};
    use animimic_scene::Camera;
    use glam::DVec3;

    const FRAMES: usize = 7;

    fn random_frames(tree: &Kinematics, seed: u64) -> Vec<FramePose> {
        let mut rng = SplitMix64(seed);
        let mut step = || -> Vec<f64> { (0..tree.dimension).map(|_| 0.3 * rng.normal()).collect() };
        (0..FRAMES).map(|_| tree.retract(&tree.rest(), &step())).collect()
    }

    fn camera() -> Camera {
        Camera::orbit(DVec3::new(1.0, 0.6, 0.5), 6.0, 0.4, 0.2, 0.8, 320, 240)
    }

    /// Calls `check` with smoothness alone, on all frames and on parts of them.
    fn each_range(check: impl Fn(&Problem, &[FramePose], &[Posed], Range<usize>)) {
        let (rig, mesh) = creature();
        let tree = SolveTree::new(&rig, &mesh);
        let smoothness = Smoothness {
            anchors: pseudo_anchors(&tree.vertex_anchors(&rig), tree.kinematics.len()),
            velocity: 3.0,
            acceleration: 7.0,
            basis: Smoothness::stretched_basis(DVec3::new(0.3, -0.4, 0.8), 5.0),
        };
        let camera = camera();
        let context = Context { kinematics: &tree.kinematics, camera: &camera, anchors: &[], columns: &[] };
        let problem = Problem { context, terms: Vec::new(), smoothness: Some(&smoothness) };
        let poses = random_frames(&tree.kinematics, 5);
        let posed: Vec<Posed> = poses.iter().map(|p| tree.kinematics.pose(p)).collect();
        for active in [0..FRAMES, 0..1, 1..2, 3..4, 2..6, 5..FRAMES] {
            check(&problem, &poses, &posed, active);
        }
    }

    #[test]
    fn smoothness_has_an_exact_gradient_on_all_and_on_some_frames() {
        each_range(|problem, poses, posed, active| {
            let model = linearize(problem, poses, posed, &active);
            let gradient: Vec<f64> = model.gradient.iter().map(|g| 2.0 * g).collect();
            let f = |step: &[f64]| {
                let moved = retract(problem, poses, &active, step);
                total_energy(problem, &moved, &pose_active(problem, &moved, posed, &active), &active)
            };
            let zero = vec![0.0; gradient.len()];
            let error = gradient_error(f, &zero, &gradient, 6, &[1e-3, 1e-4, 1e-5], 1);
            println!("frames {active:?}: relative error {error:.1e}");
            // Frame 0 alone touches no difference: everything is zero.
            assert!(error < 1e-6 || gradient.iter().all(|g| *g == 0.0));
        });
    }

    #[test]
    fn the_hessian_of_smoothness_is_that_of_its_jacobian() {
        each_range(|problem, poses, posed, active| {
            let smoothness = problem.smoothness.expect("set above");
            let kinematics = problem.context.kinematics;
            let model = linearize(problem, poses, posed, &active);
            let mut rng = SplitMix64(3);
            let n = active.len() * kinematics.dimension;
            let v: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
            // vᵀHv = Σ w ‖Σ c (J v)‖²_G: push v through the rows of every pseudo-anchor.
            let moving: Vec<Vec<DVec3>> = (0..active.end)
                .map(|t| match t.checked_sub(active.start) {
                    None => vec![DVec3::ZERO; smoothness.anchors.len()],
                    Some(s) => {
                        let part = &v[s * kinematics.dimension..][..kinematics.dimension];
                        smoothness.anchors.iter().map(|a| pushed(a, kinematics, &posed[t], part)).collect()
                    }
                })
                .collect();
            let along = |d: DVec3| smoothness.basis.iter().map(|b| b.dot(d).powi(2)).sum::<f64>();
            let mut expected = 0.0;
            for t in 0..active.end {
                for k in 0..smoothness.anchors.len() {
                    if t + 1 < active.end && t + 2 > active.start {
                        expected += smoothness.velocity * along(moving[t + 1][k] - moving[t][k]);
                    }
                    if t + 2 < active.end && t + 3 > active.start {
                        let bend = moving[t + 2][k] - moving[t + 1][k] * 2.0 + moving[t][k];
                        expected += smoothness.acceleration * along(bend);
                    }
                }
            }
            let found = quadratic_form(&model, &v);
            println!("frames {active:?}: {found} {expected}");
            assert!((found - expected).abs() <= 1e-10 * expected);
        });
    }

    #[test]
    fn one_thread_and_three_give_the_same_bytes() {
        each_range(|problem, poses, _, active| {
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
                let mut moved = poses.to_vec();
                let report = pool.install(|| solve(problem, &mut moved, active.clone(), &Options::default()));
                (moved, report.energies)
            };
            let (one, three) = (with(1), with(3));
            println!("frames {active:?}: energy {:?} after {} steps", one.1.last(), one.1.len() - 1);
            assert_eq!(one, three);
            assert!(one.1.last() < one.1.first() || one.1[0] == 0.0, "and it descends");
        });
    }

    /// Pulls towards other poses; its energy is not a number beyond a distance from rest, so that good steps look bad.
    struct Abyss {
        beyond_rad: f64,
    }

    impl Term for Abyss {
        fn name(&self) -> &'static str {
            "abyss"
        }
        fn energy(&self, context: &Context, at: &At) -> f64 {
            let v = context.kinematics.difference(&context.kinematics.rest(), at.pose);
            let far = v.iter().any(|x| x.abs() > self.beyond_rad);
            if far { f64::NAN } else { v.iter().map(|x| (x - 1.0).powi(2)).sum() }
        }
        fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations) {
            let v = context.kinematics.difference(&context.kinematics.rest(), at.pose);
            for (i, x) in v.iter().enumerate() {
                normal.hessian[i * v.len() + i] += 1.0;
                normal.gradient[i] += x - 1.0;
            }
        }
    }

    #[test]
    fn an_energy_that_is_not_a_number_is_rolled_back_and_told() {
        let (rig, mesh) = creature();
        let tree = SolveTree::new(&rig, &mesh);
        let camera = camera();
        let context = || Context { kinematics: &tree.kinematics, camera: &camera, anchors: &[], columns: &[] };
        for beyond_rad in [0.9, 0.3, -1.0] {
            let abyss = Abyss { beyond_rad };
            let problem = Problem { context: context(), terms: vec![&abyss], smoothness: None };
            let mut poses = vec![tree.kinematics.rest(); 2];
            let report = solve(&problem, &mut poses, 0..2, &Options::default());
            println!("beyond {beyond_rad}: {} not finite, energies {:?}", report.not_finite, report.energies);
            assert!((1..=MAX_NOT_FINITE).contains(&report.not_finite));
            if beyond_rad < 0.0 {
                assert_eq!(poses, vec![tree.kinematics.rest(); 2]);
                continue;
            }
            assert!(report.energies.iter().all(|e| e.is_finite()));
            assert!(total_energy(&problem, &poses, &pose_all(&problem, &poses), &(0..2)).is_finite());
        }
    }

    fn pushed(anchor: &Anchor, kinematics: &Kinematics, posed: &Posed, v: &[f64]) -> DVec3 {
        DVec3::from_array(DVec3::AXES.map(|axis| {
            let mut row = Vec::new();
            anchor.push_row(&anchor.columns(kinematics), kinematics, posed, axis, &mut row);
            row.iter().map(|&(i, x)| x * v[i]).sum()
        }))
    }

    fn quadratic_form(model: &Model, v: &[f64]) -> f64 {
        let d = model.dimension;
        let mut sum = 0.0;
        for (gap, blocks) in [&model.diagonal, &model.next, &model.after_next].into_iter().enumerate() {
            for (s, block) in blocks.iter().enumerate() {
                let (rows, columns) = (&v[(s + gap) * d..][..d], &v[s * d..][..d]);
                for i in 0..d {
                    for j in 0..if gap == 0 { i + 1 } else { d } {
                        let both = if gap == 0 && i == j { 1.0 } else { 2.0 };
                        sum += both * rows[i] * block[(i, j)] * columns[j];
                    }
                }
            }
        }
        sum
    }
}
