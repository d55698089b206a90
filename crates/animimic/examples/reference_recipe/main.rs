//! Our solvers against the paper's recipe, on the same loss.
//!
//! `cargo run --release -p animimic --example reference_recipe -- [--frames N] CASE...`, a CASE being a folder with `static.glb`,
//! `video.mp4` and `camera.json`. Masks and tracks are the embedded ones and are made once, before any clock starts. For each
//! case prints the total loss L of the reference (`fit::reference`) at its full iteration count and its CPU seconds, then L along
//! two ways of ours, the CPU seconds at which each is first below that, and the ratio:
//! - `same loss`: Levenberg–Marquardt from the rest pose on L majorised by squares, all frames together, then L itself by L-BFGS in
//!   the metric of that Hessian;
//! - `default`: what `animate` does (tracking with several hypotheses, which does not read the tracks), refinement, polish.

mod majorised;
#[path = "../support/mod.rs"]
mod support;

use animimic_fit::quasi_newton::{Descent, Evaluation, Objective, minimise};
use animimic_fit::reference::{self, Loss, Parts, Schedule};
use animimic_fit::solver::{Options, linearize, solve};
use animimic_fit::stage1::solve::Stage;
use animimic_fit::stage1::subject::Subject;
use animimic_fit::stage1::{self, Input, Settings};
use animimic_math::block_tridiagonal::Factor;
use animimic_rig::{FramePose, Posed};
use animimic_video::cues::{TrackOptions, tracks};
use majorised::majorised;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;
use support::Case;

/// Rounds of majorising and solving, and steps in each.
const ROUNDS: (usize, usize) = (10, 2);
/// Factor on the contour in the first round, falling to 1.
const BOOST: f64 = 10.0;
/// Times that the metric is made anew while L itself is minimised, and steps of L-BFGS with each.
const CYCLES: (usize, usize) = (3, 10);
/// Damping of the metric.
const DAMPING: f64 = 1e-2;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let mut frames = usize::MAX;
    if arguments.peek().is_some_and(|a| a == "--frames") {
        arguments.next();
        frames = arguments.next().ok_or("--frames needs a number")?.parse()?;
    }
    for case in arguments {
        compare(Path::new(&case), frames)?;
    }
    Ok(())
}

fn compare(case: &Path, frames: usize) -> Result<(), Box<dyn Error>> {
    let case = Case::read(case, frames)?;
    let tracks = tracks(&case.video, &case.masks, &TrackOptions::default());
    let input = Input { tracks: Some(&tracks), ..case.input() };
    let subject = Subject::new(&case.asset)?;
    let light = stage1::first_light(&input, &subject)?;
    let tree = reference::free(&subject.tree.kinematics);
    let loss = Loss::new(&input, &subject, &tree, &light);
    let n = case.video.frames.len();
    let rest = vec![subject.tree.kinematics.rest(); n];
    println!(
        "{} ({n} frames, {}x{}): at rest {}",
        case.name,
        case.camera.width,
        case.camera.height,
        show(&loss.score(&rest))
    );

    let start = cpu_seconds();
    let run = reference::run(&loss, n, &Schedule::default(), &mut |_, _| ControlFlow::Continue(()))?;
    let spent = cpu_seconds() - start;
    let target = loss.score(&run.poses);
    println!("  reference  {spent:7.1} s  {}", show(&target));

    let mut race = Race {
        loss: &loss,
        target: target.total(),
        reference_seconds: spent,
        name: "same loss",
        spent: 0.0,
        first: None,
    };
    let stage = stage1::stage(&input, &subject, &light, Settings::default());
    let mut poses = rest.clone();
    for round in 0..ROUNDS.0 {
        let boost = BOOST.powf(1.0 - round as f64 / (ROUNDS.0 - 1) as f64);
        race.step(&mut poses, |poses| {
            let options = Options { max_iterations: ROUNDS.1, tolerance: 1e-4, damping: 1e-3 };
            let start = poses.clone();
            majorised(&stage, &start, boost, |problem| solve(problem, poses, 0..n, &options));
        });
    }
    let own = Loss::new(&input, &subject, &subject.tree.kinematics, &light);
    for _ in 0..CYCLES.0 {
        race.same_loss(&mut poses, &own, &stage)?;
    }
    race.end();

    let mut race = Race { name: "default", spent: 0.0, first: None, ..race };
    let stage = stage1::stage(&Input { tracks: None, ..input }, &subject, &light, Settings::default());
    let mut poses = rest;
    let mut failed = None;
    race.step(&mut poses, |poses| match stage.track(1.0, None, stage.at_rest(), &mut |_| Ok(())) {
        Ok(found) => *poses = found.expect("without a rival it goes on to the end").poses,
        Err(e) => failed = Some(e),
    });
    failed.map_or(Ok(()), Err)?;
    let rounds = stage.settings.batch_rounds;
    for round in 0..rounds {
        race.step(&mut poses, |poses| {
            stage.refine(poses, round, 1.0);
        });
    }
    let rounds = stage.settings.final_rounds;
    race.step(&mut poses, |poses| {
        (0..rounds / 2).for_each(|_| drop(stage.finish(poses)));
        stage.repeat(poses);
        stage.flip_limbs(poses);
    });
    race.step(&mut poses, |poses| {
        (rounds / 2..rounds).for_each(|_| drop(stage.finish(poses)));
    });
    race.step(&mut poses, |poses| {
        stage.polish(poses, animimic_fit::stage1::polish::SETTLED);
    });
    race.end();
    Ok(())
}

/// One of our ways against the reference's end.
struct Race<'a> {
    loss: &'a Loss<'a>,
    target: f64,
    reference_seconds: f64,
    name: &'static str,
    spent: f64,
    /// When the loss was first below the target [CPU s].
    first: Option<f64>,
}

impl Race<'_> {
    /// Times one step and scores where it leads; scoring is not timed.
    fn step(&mut self, poses: &mut Vec<FramePose>, work: impl FnOnce(&mut Vec<FramePose>)) {
        let start = cpu_seconds();
        work(poses);
        self.spent += cpu_seconds() - start;
        let parts = self.loss.score(poses);
        println!("  {:9}  {:7.1} s  {}", self.name, self.spent, show(&parts));
        if parts.total() < self.target && self.first.is_none() {
            self.first = Some(self.spent);
        }
    }

    /// Minimises L itself.
    fn same_loss(&mut self, poses: &mut Vec<FramePose>, loss: &Loss, stage: &Stage) -> Result<(), Box<dyn Error>> {
        let start = cpu_seconds();
        let metric = majorised(stage, poses, 1.0, |problem| {
            let posed: Vec<Posed> = poses.iter().map(|p| stage.subject.posed(p)).collect();
            linearize(problem, poses, &posed, &(0..poses.len())).factor(DAMPING)
        });
        let metric = metric.ok_or("the metric is not positive definite")?;
        // The normal matrix is half the Hessian of the energy, which is UNIT times L.
        let same = Same { loss, metric, scale: 0.5 * majorised::UNIT };
        let Descent { end, history, .. } = minimise(&same, std::mem::take(poses), CYCLES.1, 1e-4);
        *poses = end;
        let spent = cpu_seconds() - start;
        for (k, parts) in history.iter().enumerate().skip(1) {
            let at = self.spent + spent * k as f64 / (history.len() - 1) as f64;
            let total: f64 = parts.iter().sum();
            println!("  {:9}  {at:7.1} s  L {total:.5}", self.name);
            if total < self.target && self.first.is_none() {
                self.first = Some(at);
            }
        }
        self.spent += spent;
        println!("  {:9}  {:7.1} s  {}", self.name, self.spent, show(&self.loss.score(poses)));
        Ok(())
    }

    fn end(&self) {
        match self.first {
            Some(first) => {
                println!(
                    "  {} is below the reference after {first:.1} s: 1/{:.1}",
                    self.name,
                    self.reference_seconds / first
                );
            }
            None => println!("  {} does not get below the reference", self.name),
        }
    }
}

/// L on the solver's own tree.
struct Same<'a> {
    loss: &'a Loss<'a>,
    metric: Factor,
    scale: f64,
}

impl Objective for Same<'_> {
    type Point = Vec<FramePose>;

    fn evaluate(&self, poses: &Vec<FramePose>) -> Evaluation {
        let (parts, gradient) = self.loss.with_gradient(poses);
        Evaluation { parts: parts.named().map(|(_, v)| v).to_vec(), gradient: gradient.concat() }
    }

    fn precondition(&self, gradient: &[f64]) -> Vec<f64> {
        self.metric.solve(gradient).iter().map(|v| self.scale * v).collect()
    }

    fn retract(&self, poses: &Vec<FramePose>, step: &[f64]) -> Vec<FramePose> {
        let tree = self.loss.kinematics();
        poses.iter().zip(step.chunks_exact(tree.dimension)).map(|(p, s)| tree.retract(p, s)).collect()
    }
}

fn show(parts: &Parts) -> String {
    let named: Vec<String> = parts.named().iter().map(|(name, v)| format!("{name} {v:.5}")).collect();
    format!("L {:.5} = {}", parts.total(), named.join(" + "))
}

/// CPU seconds of this process, all threads.
fn cpu_seconds() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}
