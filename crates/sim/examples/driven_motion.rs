//! Solves for driven motion: which path of its held end makes the soft beam's free end follow a wanted curve? The gradient
//! to the path comes from the adjoint; plain L-BFGS does the rest.
//! `cargo run --release -p animimic-sim --example driven_motion`

use animimic_sim::fixtures::beam;
use animimic_sim::{Body, Elasticity, Model, Settings, SimError, State, simulate, simulate_vjp};
use glam::DVec3;

const FRAMES: usize = 20;
/// Pull of the path towards smoothness, per squared second difference.
const SMOOTHNESS: f64 = 1e-3;
/// Curvature pairs L-BFGS remembers.
const MEMORY: usize = 12;

fn main() -> Result<(), SimError> {
    let mesh = beam([8, 1, 1], [0.8, 0.1, 0.1]);
    let held: Vec<u32> = (0..4).collect();
    let tip: Vec<usize> = (32..36).collect();
    let body = Body::new(&mesh, &held)?;
    let elasticity = Elasticity::uniform(Model::FixedCorotated, mesh.tets.len(), 1e5, 0.4, 1000.0);
    let settings = Settings { tolerance: 1e-9, ..Settings::default() };
    let start = State::at_rest(&mesh.positions);
    // The tip shall describe half a circle of 10 cm.
    let wanted = |n: usize| {
        let angle = std::f64::consts::PI * n as f64 / FRAMES as f64;
        DVec3::new(0.0, 0.05 * (1.0 - angle.cos()), 0.05 * angle.sin())
    };
    // Unknown: one translation of the held end per frame.
    let run = |shift: &[DVec3]| -> Result<(f64, Vec<DVec3>), SimError> {
        let frame = |s: &DVec3| held.iter().map(|&v| mesh.positions[v as usize] + *s).collect();
        let path: Vec<Vec<DVec3>> = shift.iter().map(frame).collect();
        let motion = simulate(&body, &elasticity, &settings, &start, &path)?;
        let mut loss = 0.0;
        let mut d_frames = vec![vec![DVec3::ZERO; mesh.positions.len()]; FRAMES];
        for (n, x) in motion.frames().enumerate() {
            for &v in &tip {
                let miss = x[v] - mesh.positions[v] - wanted(n + 1);
                loss += 0.5 * miss.length_squared();
                d_frames[n][v] = miss;
            }
        }
        let gradient = simulate_vjp(&body, &elasticity, &settings, &motion, &d_frames)?;
        let mut d_shift: Vec<DVec3> = gradient.d_path.iter().map(|d| d.iter().sum()).collect();
        let at = |n: isize| if n < 0 { DVec3::ZERO } else { shift[n as usize] };
        for n in 0..FRAMES as isize {
            let bend = at(n) - 2.0 * at(n - 1) + at(n - 2);
            loss += 0.5 * SMOOTHNESS * bend.length_squared();
            for (offset, weight) in [(0, 1.0), (1, -2.0), (2, 1.0)] {
                if n >= offset {
                    d_shift[(n - offset) as usize] += SMOOTHNESS * weight * bend;
                }
            }
        }
        Ok((loss, d_shift))
    };
    let (first, last) = minimise(run, vec![DVec3::ZERO; FRAMES], 60)?;
    println!("loss {first:.3e} -> {last:.3e} m²");
    assert!(last < 1e-2 * first, "the path was not found");
    Ok(())
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

/// L-BFGS (Nocedal & Wright 2006, algorithm 7.4) with step halving; first and last loss.
fn minimise(
    f: impl Fn(&[DVec3]) -> Result<(f64, Vec<DVec3>), SimError>,
    mut x: Vec<DVec3>,
    iterations: usize,
) -> Result<(f64, f64), SimError> {
    let (mut loss, mut gradient) = f(&x)?;
    let first = loss;
    let mut pairs: Vec<(Vec<DVec3>, Vec<DVec3>)> = vec![];
    for iteration in 0..iterations {
        let mut d: Vec<DVec3> = gradient.iter().map(|g| -*g).collect();
        let mut alphas = vec![];
        for (s, y) in pairs.iter().rev() {
            let alpha = dot(s, &d) / dot(s, y);
            d.iter_mut().zip(y).for_each(|(d, y)| *d -= alpha * *y);
            alphas.push(alpha);
        }
        if let Some((s, y)) = pairs.last() {
            let scale = dot(s, y) / dot(y, y);
            d.iter_mut().for_each(|d| *d *= scale);
        }
        for ((s, y), alpha) in pairs.iter().zip(alphas.iter().rev()) {
            let beta = dot(y, &d) / dot(s, y);
            d.iter_mut().zip(s).for_each(|(d, s)| *d += (alpha - beta) * *s);
        }
        let slope = dot(&gradient, &d);
        let mut a = 1.0;
        let (moved, value, next) = loop {
            let trial: Vec<DVec3> = x.iter().zip(&d).map(|(x, d)| *x + a * *d).collect();
            let (value, next) = f(&trial)?;
            if value <= loss + 1e-4 * a * slope || a < 1e-6 {
                break (trial, value, next);
            }
            a *= 0.5;
        };
        let s: Vec<DVec3> = moved.iter().zip(&x).map(|(a, b)| *a - *b).collect();
        let y: Vec<DVec3> = next.iter().zip(&gradient).map(|(a, b)| *a - *b).collect();
        if dot(&s, &y) > 0.0 {
            pairs.push((s, y));
            pairs.drain(..pairs.len().saturating_sub(MEMORY));
        }
        (x, loss, gradient) = (moved, value, next);
        if iteration % 10 == 9 {
            println!("iteration {}: loss {loss:.3e} m²", iteration + 1);
        }
    }
    Ok((first, loss))
}
