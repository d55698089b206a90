//! Compares the solver with the reference trajectories and gradients of an independent implementation, and times it on
//! the same problems: `cargo run --release -p animimic-sim --example reference -- DIR`, one JSON line per reference file.
//!
//! Accuracy at tolerance 1e-8 m/s on the stored problems; timing at 1e-3 m/s on the generated ones. CPU seconds are the
//! process's (all threads); `RAYON_NUM_THREADS` sets the threads.

use animimic_scene::TetMesh;
use animimic_scene::io::npz;
use animimic_sim::fixtures::{BEAM_DENSITY, BEAM_POISSON, driven_beam};
use animimic_sim::{Body, Elasticity, Model, Settings, State, simulate, simulate_vjp};
use glam::DVec3;
use std::error::Error;
use std::path::Path;

/// Reference file, cells of the generated problem, its E₀ [Pa], steps timed.
const PROBLEMS: [(&str, [usize; 3], f64, usize); 3] =
    [("1k_E1e5", [20, 3, 3], 1e5, 60), ("10k_E1e6", [28, 8, 8], 1e6, 30), ("50k_E1e6", [52, 13, 13], 1e5, 8)];

fn main() -> Result<(), Box<dyn Error>> {
    let dir = std::env::args().nth(1).ok_or("usage: reference DIR (the folder with ref_*.npz)")?;
    for (name, cells, e0, steps) in PROBLEMS {
        let [dx, d_ln_e, d_driven] = accuracy(Path::new(&dir), name)?;
        let t = timing(cells, e0, steps)?;
        println!(
            "{{\"problem\": \"{name}\", \"max_dx_m\": {dx:.3e}, \"dlogE_rel\": {d_ln_e:.3e}, \"ddriven_rel\": {d_driven:.3e}, \
             \"fwd_cpu_s_per_step\": {:.6}, \"bwd_cpu_s_per_step\": {:.6}, \"newton_mean\": {:.2}, \
             \"factorizations_mean\": {:.2}, \"cg_mean\": {:.2}, \"fwd_wall_s_per_step\": {:.6}, \
             \"bwd_wall_s_per_step\": {:.6}, \"threads\": {}}}",
            t.forward[0],
            t.backward[0],
            t.newton,
            t.factorizations,
            t.conjugate_gradients,
            t.forward[1],
            t.backward[1],
            std::thread::available_parallelism()?.get().min(threads()),
        );
    }
    Ok(())
}

fn threads() -> usize {
    std::env::var("RAYON_NUM_THREADS").ok().and_then(|v| v.parse().ok()).filter(|n| *n > 0).unwrap_or(usize::MAX)
}

fn points(flat: &[f64]) -> Vec<DVec3> {
    flat.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

/// Cuts a flat (steps, points, 3) array into steps.
fn frames(flat: &[f64], steps: usize) -> Vec<Vec<DVec3>> {
    flat.chunks(flat.len() / steps).map(points).collect()
}

fn relative(a: impl Iterator<Item = f64>, b: &[f64]) -> f64 {
    let difference: f64 = a.zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (difference / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}

/// Largest position error [m], relative errors of ∂L/∂ln E and ∂L/∂(driven path).
fn accuracy(dir: &Path, name: &str) -> Result<[f64; 3], Box<dyn Error>> {
    let problem = npz::read(dir.join(format!("ref_{name}.npz")))?;
    let gradients = npz::read(dir.join(format!("ref_{name}_grad.npz")))?;
    let numbers = |name: &str| -> Result<Vec<f64>, Box<dyn Error>> { Ok(problem.need(name)?.to_f64()) };
    let as_index = |v: Vec<f64>| -> Vec<u32> { v.into_iter().map(|v| v as u32).collect() };
    let steps = numbers("steps")?[0] as usize;
    let tets = as_index(numbers("T")?).as_chunks::<4>().0.to_vec();
    let mesh = TetMesh { positions: points(&numbers("X")?), tets };
    let elasticity = Elasticity::per_tet(Model::FixedCorotated, &numbers("E")?, numbers("nu")?[0], numbers("rho")?[0]);
    let body = Body::new(&mesh, &as_index(numbers("driven")?))?;
    let settings = Settings { frame_time: numbers("h")?[0], tolerance: 1e-8, ..Settings::default() };
    let path = frames(&numbers("traj")?, steps);
    let motion = simulate(&body, &elasticity, &settings, &State::at_rest(&mesh.positions), &path)?;
    let expected = frames(&numbers("xs")?, steps + 1);
    let pairs = motion.steps.iter().zip(&expected[1..]).flat_map(|(a, b)| a.iter().zip(b));
    let dx = pairs.fold(0.0f64, |m, (a, b)| m.max((*a - *b).abs().max_element()));
    // L = ½ Σ |x − target|² over all frames and vertices.
    let target = frames(&gradients.need("target")?.to_f64(), steps + 1);
    let difference = |(x, t): (&Vec<DVec3>, &Vec<DVec3>)| x.iter().zip(t).map(|(x, t)| *x - *t).collect();
    let d_frames: Vec<Vec<DVec3>> = motion.steps.iter().zip(&target[1..]).map(difference).collect();
    let gradient = simulate_vjp(&body, &elasticity, &settings, &motion, &d_frames)?;
    let d_ln_e = relative(gradient.d_ln_youngs.iter().copied(), &gradients.need("dlogE")?.to_f64());
    let flat = gradient.d_path.iter().flatten().flat_map(|d| d.to_array());
    Ok([dx, d_ln_e, relative(flat, &gradients.need("ddriven")?.to_f64())])
}

/// Seconds per step, CPU and wall, and what the steps did on average.
struct Timing {
    forward: [f64; 2],
    backward: [f64; 2],
    newton: f64,
    factorizations: f64,
    conjugate_gradients: f64,
}

fn timing(cells: [usize; 3], e0: f64, steps: usize) -> Result<Timing, Box<dyn Error>> {
    let problem = driven_beam(cells, e0, 1.0 / 30.0, steps);
    let body = Body::new(&problem.mesh, &problem.driven)?;
    let elasticity = Elasticity::per_tet(Model::FixedCorotated, &problem.youngs, BEAM_POISSON, BEAM_DENSITY);
    let settings = Settings { factor_memory: FACTOR_MEMORY, ..Settings::default() };
    let start = State::at_rest(&problem.mesh.positions);
    let clock = Clock::start()?;
    let motion = simulate(&body, &elasticity, &settings, &start, &problem.path)?;
    let forward = clock.per(steps)?;
    let clock = Clock::start()?;
    let gradient = simulate_vjp(&body, &elasticity, &settings, &motion, &motion.steps)?;
    let backward = clock.per(steps)?;
    if !gradient.indefinite_steps.is_empty() || !motion.unconverged().is_empty() {
        eprintln!("indefinite {:?}, unconverged {:?}", gradient.indefinite_steps, motion.unconverged());
    }
    let mean =
        |f: fn(&animimic_sim::StepReport) -> usize| motion.reports.iter().map(f).sum::<usize>() as f64 / steps as f64;
    Ok(Timing {
        forward,
        backward,
        newton: mean(|r| r.newton),
        factorizations: mean(|r| r.factorizations),
        conjugate_gradients: mean(|r| r.conjugate_gradients),
    })
}

/// Bytes of factors kept between forward and backward: none, so that the times hold for motions of any length.
const FACTOR_MEMORY: usize = 0;

/// CPU time of all threads and wall time.
struct Clock {
    cpu: f64,
    wall: std::time::Instant,
}

impl Clock {
    fn start() -> Result<Self, Box<dyn Error>> {
        Ok(Self { cpu: cpu_seconds()?, wall: std::time::Instant::now() })
    }

    fn per(&self, steps: usize) -> Result<[f64; 2], Box<dyn Error>> {
        let n = steps as f64;
        Ok([(cpu_seconds()? - self.cpu) / n, self.wall.elapsed().as_secs_f64() / n])
    }
}

/// CPU seconds of every thread of this process, in nanosecond resolution (Linux).
fn cpu_seconds() -> Result<f64, Box<dyn Error>> {
    let mut total = 0.0;
    for task in std::fs::read_dir("/proc/self/task")? {
        let text = std::fs::read_to_string(task?.path().join("schedstat"))?;
        total += text.split_whitespace().next().ok_or("empty schedstat")?.parse::<f64>()? * 1e-9;
    }
    Ok(total)
}
