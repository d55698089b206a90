//! Whole motions: simulate forwards, then pull a loss on any frames back through every step.

use crate::adjoint::Gradient;
use crate::body::Body;
use crate::elasticity::Elasticity;
use crate::error::{SimError, check_len};
use crate::settings::{Settings, State, StepReport};
use crate::stepper::Stepper;
use animimic_math::sparse::Factor;
use glam::DVec3;
use std::sync::Arc;

/// A simulated motion with what its adjoint needs: 24 bytes a vertex and step, and kept factors if asked for.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// Initial state.
    pub start: State,
    /// Positions [m] after every step (substeps included), \[step\]\[vertex\].
    pub steps: Vec<Vec<DVec3>>,
    /// Ends of the tethers [m] at every step, \[step\]\[tether\].
    pub ends: Vec<Vec<DVec3>>,
    /// Steps per frame.
    pub substeps: usize,
    /// One report per step.
    pub reports: Vec<StepReport>,
    /// Factors kept for the adjoint, per step, within `Settings::factor_memory`.
    pub(crate) factors: Vec<Option<Arc<Factor>>>,
}

impl Simulation {
    /// Positions [m] at the end of each frame, \[frame\]\[vertex\].
    pub fn frames(&self) -> impl Iterator<Item = &Vec<DVec3>> {
        self.steps.iter().skip(self.substeps - 1).step_by(self.substeps)
    }

    /// State after `n` steps (0: the initial state).
    pub fn state(&self, n: usize, settings: &Settings) -> State {
        if n == 0 {
            return self.start.clone();
        }
        let before = if n == 1 { &self.start.positions } else { &self.steps[n - 2] };
        let h = settings.step_time();
        let velocities = self.steps[n - 1].iter().zip(before).map(|(a, b)| (*a - *b) / h).collect();
        State { positions: self.steps[n - 1].clone(), velocities }
    }

    /// Bytes of the factors kept for the adjoint, at most `Settings::factor_memory`.
    pub fn factor_bytes(&self) -> usize {
        let kept = self.factors.iter().flatten();
        // Steps that shared one factor are neighbours.
        let mut last: Option<&Arc<Factor>> = None;
        kept.filter(|f| !last.replace(f).is_some_and(|l| Arc::ptr_eq(l, f))).map(|f| f.bytes()).sum()
    }

    /// Keeps a step's factor while there is `memory` left for it, of which it takes its bytes.
    fn keep(&mut self, factor: Option<Arc<Factor>>, memory: &mut usize) {
        let last = self.factors.last().and_then(Option::as_ref);
        let cost = |f: &Arc<Factor>| if last.is_some_and(|l| Arc::ptr_eq(l, f)) { 0 } else { f.bytes() };
        let kept = factor.map(|f| (cost(&f), f)).filter(|(cost, _)| cost <= memory);
        *memory -= kept.as_ref().map_or(0, |k| k.0);
        self.factors.push(kept.map(|k| k.1));
    }

    /// Steps that did not reach the tolerance.
    pub fn unconverged(&self) -> Vec<usize> {
        (0..self.reports.len()).filter(|&n| !self.reports[n].converged).collect()
    }
}

/// Driven positions at the end of each substep of one frame: linear between the frame's ends.
pub(crate) fn substep_path(from: &[DVec3], to: &[DVec3], substeps: usize) -> Vec<Vec<DVec3>> {
    let at = |s: usize| {
        let share = s as f64 / substeps as f64;
        // The last one exactly: no rounding at frame ends.
        if s == substeps { to.to_vec() } else { from.iter().zip(to).map(|(a, b)| a.lerp(*b, share)).collect() }
    };
    (1..=substeps).map(at).collect()
}

/// Simulates one frame per entry of `path`: the driven vertices' positions [m] at each frame's end, then those of the
/// tethers' ends, \[frame\]\[driven, tether\].
pub fn simulate(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    start: &State,
    path: &[Vec<DVec3>],
) -> Result<Simulation, SimError> {
    let mut stepper = Stepper::new(body, elasticity, settings)?;
    let mut result = Simulation {
        start: start.clone(),
        steps: vec![],
        ends: vec![],
        substeps: settings.substeps,
        reports: vec![],
        factors: vec![],
    };
    check_len("positions", start.positions.len(), body.rest.len())?;
    let mut state = start.clone();
    let mut driven: Vec<DVec3> = body.driven.iter().map(|&v| start.positions[v as usize]).collect();
    driven.extend(body.tethered_points(&start.positions));
    let mut memory = settings.factor_memory;
    for frame in path {
        check_len("driven positions", frame.len(), body.driven.len() + body.tethers.len())?;
        for target in substep_path(&driven, frame, settings.substeps) {
            let (next, report) = stepper.step(&state, &target)?;
            result.keep(stepper.factor.clone(), &mut memory);
            result.steps.push(next.positions.clone());
            result.ends.push(target[body.driven.len()..].to_vec());
            result.reports.push(report);
            state = next;
        }
        driven.clone_from(frame);
    }
    Ok(result)
}

/// Gradient of a loss on frames' positions: `d_frames` is ∂L/∂x per frame and vertex (frames() order).
pub fn simulate_vjp(
    body: &Body,
    elasticity: &Elasticity,
    settings: &Settings,
    simulation: &Simulation,
    d_frames: &[Vec<DVec3>],
) -> Result<Gradient, SimError> {
    let (steps, substeps) = (simulation.steps.len(), settings.substeps);
    check_len("frames of the loss", d_frames.len(), steps / substeps)?;
    let n = body.rest.len();
    let mut stepper = Stepper::new(body, elasticity, settings)?;
    let mut total = Gradient::zeros(body, elasticity, d_frames.len());
    let mut d_next = State::at_rest(&vec![DVec3::ZERO; n]);
    for step in (0..steps).rev() {
        if (step + 1) % substeps == 0 {
            let frame = &d_frames[step / substeps];
            check_len("vertices of the loss", frame.len(), n)?;
            d_next.positions.iter_mut().zip(frame).for_each(|(d, f)| *d += *f);
        }
        let before = simulation.state(step, settings);
        // At a saddle no factor of a neighbouring matrix would do: MINRES needs one of a shifted matrix.
        let kept = simulation.factors[step].as_ref().filter(|_| !simulation.reports[step].saddle);
        if let Some(kept) = kept {
            stepper.factor = Some(kept.clone());
            stepper.factor_is_near = true;
        }
        let part = stepper.step_vjp(&before, &simulation.steps[step], &simulation.ends[step], &d_next)?;
        total.add_step(&part, step, substeps);
        d_next = part.d_start;
    }
    total.finish(body, d_next);
    Ok(total)
}
