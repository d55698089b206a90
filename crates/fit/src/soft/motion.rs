//! A motion of the joints, simulated.
//!
//! The body starts at rest in the first pose. Where that is not the rest pose, the joints are led there from rest while the
//! body is in equilibrium at every step. Between frames joints are interpolated in their own local frames (slerp), so that
//! they stay connected; a step that leaves tets inverted or misses its tolerance makes the whole motion be simulated again
//! with twice the steps.

use super::Tissue;
use crate::FitError;
use animimic_scene::{Pose, Transform};
use animimic_sim::{Elasticity, Settings, Simulation, State, simulate};
use glam::{DAffine3, DVec3};
use rayon::prelude::*;

/// How a motion is simulated.
#[derive(Clone, Debug)]
pub struct Stepping {
    /// Steps per frame; more are taken where these do not do.
    pub substeps: usize,
    /// Most steps per frame.
    pub most_substeps: usize,
    /// Damping proportional to mass [1/s].
    pub mass_damping: f64,
    /// Newton's tolerance [m/s].
    pub tolerance: f64,
}

impl Default for Stepping {
    fn default() -> Self {
        Self { substeps: 1, most_substeps: 8, mass_damping: 0.0, tolerance: 1e-2 }
    }
}

/// Driven and held points nearer than this to their rest places are at rest [m].
const AT_REST: f64 = 1e-9;
/// Steps from rest to a first pose elsewhere, at first and at most.
const LEAD: [usize; 2] = [8, 64];
/// Length of such a step [s]: long against every oscillation, so that the body is in equilibrium.
const LEAD_STEP: f64 = 10.0;

/// What happened.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Steps per frame that were taken.
    pub substeps: usize,
    /// Most inverted tets in any step.
    pub inverted: usize,
    /// Steps that missed their tolerance, by frame, with the last speed [m/s].
    pub unconverged: Vec<(usize, f64)>,
    /// Largest |V/V(rest) − 1| of all tets together.
    pub volume_change: f64,
    /// Newton iterations.
    pub newton: usize,
}

/// A simulated motion.
pub struct Simulated {
    /// The simulation, one entry per step; its clock has `substeps` steps per frame.
    pub simulation: Simulation,
    /// With which settings.
    pub settings: Settings,
    /// Driven paths per step.
    pub path: Vec<Vec<DVec3>>,
    /// What happened.
    pub report: Report,
}

impl Simulated {
    /// Cage positions at each frame [m], the first pose included.
    pub fn frames(&self) -> impl Iterator<Item = &Vec<DVec3>> {
        let steps = self.simulation.steps.iter().skip(self.report.substeps - 1).step_by(self.report.substeps);
        std::iter::once(&self.simulation.start.positions).chain(steps)
    }

    /// Surfaces \[frame\]\[vertex\] [model unit] of the tissue and the poses that were simulated.
    pub fn surfaces(&self, tissue: &Tissue, poses: &[Pose]) -> Vec<Vec<DVec3>> {
        let cages: Vec<&Vec<DVec3>> = self.frames().collect();
        let frames = cages.par_iter().zip(poses);
        frames.map(|(cage, pose)| tissue.surface(cage, &tissue.world(pose))).collect()
    }
}

impl Tissue<'_> {
    /// Simulates poses at a rate of `fps`.
    ///
    /// # Errors
    /// No poses, or a material that does not fit the cage.
    pub fn simulate(
        &self,
        elasticity: &Elasticity,
        stepping: &Stepping,
        poses: &[Pose],
        fps: f64,
    ) -> Result<Simulated, FitError> {
        if poses.is_empty() || !(fps > 0.0 && fps.is_finite()) {
            return Err(FitError::Input(format!("{} poses at {fps} frames a second cannot be simulated", poses.len())));
        }
        let start = self.start(elasticity, stepping, &poses[0])?;
        let mut substeps = stepping.substeps.max(1);
        loop {
            let simulated = self.simulate_from(start.clone(), elasticity, stepping, poses, fps, substeps)?;
            let fine = simulated.report.inverted == 0 && simulated.report.unconverged.is_empty();
            if fine || 2 * substeps > stepping.most_substeps {
                return Ok(simulated);
            }
            substeps *= 2;
        }
    }

    /// Simulates with a given number of steps per frame.
    ///
    /// # Errors
    /// A material that does not fit the cage.
    pub fn simulate_from(
        &self,
        start: State,
        elasticity: &Elasticity,
        stepping: &Stepping,
        poses: &[Pose],
        fps: f64,
        substeps: usize,
    ) -> Result<Simulated, FitError> {
        let settings = Settings {
            frame_time: 1.0 / (fps * substeps as f64),
            tolerance: stepping.tolerance,
            mass_damping: stepping.mass_damping,
            upright: true,
            ..Settings::default()
        };
        let path = self.path(poses, substeps);
        let simulation = simulate(&self.body, elasticity, &settings, &start, &path)?;
        let report = self.report(&simulation, substeps);
        Ok(Simulated { simulation, settings, path, report })
    }

    /// Driven positions [m] at the end of every step, \[step\]\[driven\].
    pub fn path(&self, poses: &[Pose], substeps: usize) -> Vec<Vec<DVec3>> {
        let mut path = Vec::with_capacity(poses.len() * substeps);
        for pair in poses.windows(2) {
            for s in 1..=substeps {
                path.push(self.driven_at(&between(&pair[0], &pair[1], s as f64 / substeps as f64)));
            }
        }
        path
    }

    /// World transforms of the joints in a pose.
    pub fn world(&self, pose: &Pose) -> Vec<DAffine3> {
        self.asset.rig.skeleton.world_from_joint(&pose.locals)
    }

    fn driven_at(&self, pose: &Pose) -> Vec<DVec3> {
        self.driven_positions(&self.world(pose))
    }

    /// The body at rest in a pose.
    ///
    /// # Errors
    /// A material that does not fit the cage.
    pub fn start(&self, elasticity: &Elasticity, stepping: &Stepping, pose: &Pose) -> Result<State, FitError> {
        let rest = State::at_rest(&self.body.rest);
        let there = self.driven_at(pose);
        let still = self.driven_positions(&self.asset.rig.skeleton.rest_world());
        let away = still.iter().zip(&there).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        if away < AT_REST {
            return Ok(rest);
        }
        let from = Pose { locals: self.asset.rig.skeleton.rest_locals() };
        let settings =
            Settings { frame_time: LEAD_STEP, tolerance: stepping.tolerance, upright: true, ..Settings::default() };
        let mut steps = LEAD[0];
        loop {
            let mut state = rest.clone();
            let mut fine = true;
            for s in 1..=steps {
                let path = vec![self.driven_at(&between(&from, pose, s as f64 / steps as f64))];
                let step = simulate(&self.body, elasticity, &settings, &state, &path)?;
                fine &= step.reports.iter().all(|r| r.inverted == 0);
                state = State::at_rest(&step.steps[0]);
            }
            if fine || 2 * steps > LEAD[1] {
                return Ok(state);
            }
            steps *= 2;
        }
    }

    fn report(&self, simulation: &Simulation, substeps: usize) -> Report {
        let volume = |x: &[DVec3]| -> f64 {
            let one = |t: &[u32; 4]| {
                let [a, b, c, d] = t.map(|v| x[v as usize]);
                (b - a).cross(c - a).dot(d - a) / 6.0
            };
            self.body.tets.iter().map(one).sum()
        };
        let rest: f64 = self.body.volume.iter().sum();
        let all = std::iter::once(&simulation.start.positions).chain(&simulation.steps);
        let reports = simulation.reports.iter().enumerate();
        Report {
            substeps,
            inverted: simulation.reports.iter().map(|r| r.inverted).max().unwrap_or(0),
            unconverged: reports.filter(|(_, r)| !r.converged).map(|(n, r)| (n / substeps + 1, r.residual)).collect(),
            volume_change: all.map(|x| (volume(x) / rest - 1.0).abs()).fold(0.0, f64::max),
            newton: simulation.reports.iter().map(|r| r.newton).sum(),
        }
    }
}

/// A pose between two, each joint in its own local frame.
pub fn between(a: &Pose, b: &Pose, share: f64) -> Pose {
    let mix = |(a, b): (&Transform, &Transform)| Transform {
        translation: a.translation.lerp(b.translation, share),
        rotation: if a.rotation == b.rotation { a.rotation } else { a.rotation.slerp(b.rotation, share) },
        scale: a.scale.lerp(b.scale, share),
    };
    // The ends exactly: no rounding at frames.
    match share {
        0.0 => a.clone(),
        1.0 => b.clone(),
        _ => Pose { locals: a.locals.iter().zip(&b.locals).map(mix).collect() },
    }
}
