//! Stationary points that are not minima: a straight column squeezed far beyond buckling.

use animimic_math::gradcheck::{SplitMix64, gradient_error};
use animimic_sim::fixtures::column;
use animimic_sim::{Body, Elasticity, Filter, Gradient, Model, Settings, Simulation, State, simulate, simulate_vjp};
use glam::DVec3;

const FRAMES: usize = 4;
const CELLS: usize = 8;
const WIDTH: f64 = 0.125;
const STEPS: [f64; 4] = [1e-2, 1e-3, 1e-4, 1e-5];

/// What the squeeze depends on; none of it pushes the column to a side.
#[derive(Clone)]
struct Squeeze {
    elasticity: Elasticity,
    settings: Settings,
    /// Shortening at the last frame [m].
    shortening: f64,
    /// Speed at which the column's middle swells along its axis at the start [m/s].
    swell: f64,
}

struct Column {
    body: Body,
    weights: Vec<Vec<DVec3>>,
}

fn squeeze(filter: Filter, tolerance: f64) -> (Column, Squeeze) {
    let (mesh, ends) = column(CELLS, WIDTH);
    let cluster = mesh.tets.iter().map(|t| u32::from(mesh.positions[t[0] as usize].x > 0.5)).collect();
    let ln_youngs = [1e5f64, 1.4e5].map(f64::ln).to_vec();
    let elasticity = Elasticity { model: Model::FixedCorotated, cluster, ln_youngs, poisson: 0.3, density: 1000.0 };
    let settings = Settings {
        frame_time: 0.1,
        tolerance,
        filter,
        mass_damping: 0.4,
        stiffness_damping: 0.02,
        ..Settings::default()
    };
    let mut rng = SplitMix64(3);
    let mut random = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
    let weights = (0..FRAMES).map(|_| mesh.positions.iter().map(|_| random()).collect()).collect();
    let body = Body::new(&mesh, &ends).expect("a good mesh");
    (Column { body, weights }, Squeeze { elasticity, settings, shortening: 0.22, swell: 0.05 })
}

/// Axial velocity of a unit swell.
fn swelling(rest: DVec3) -> DVec3 {
    DVec3::X * (std::f64::consts::TAU * rest.x).sin()
}

fn run(c: &Column, s: &Squeeze) -> Simulation {
    let shift = |n: usize, p: DVec3| s.shortening * (0.5 - p.x) * (n + 1) as f64 / FRAMES as f64 * DVec3::X;
    let place = |n: usize, v: u32| c.body.rest[v as usize] + shift(n, c.body.rest[v as usize]);
    let path: Vec<Vec<DVec3>> = (0..FRAMES).map(|n| c.body.driven.iter().map(|&v| place(n, v)).collect()).collect();
    let velocities = c.body.rest.iter().map(|p| s.swell * swelling(*p)).collect();
    let start = State { positions: c.body.rest.clone(), velocities };
    let motion = simulate(&c.body, &s.elasticity, &s.settings, &start, &path).expect("good input");
    assert!(motion.unconverged().is_empty(), "{:?}", motion.reports);
    motion
}

fn loss(c: &Column, motion: &Simulation) -> f64 {
    motion.frames().zip(&c.weights).flat_map(|(x, w)| x.iter().zip(w)).map(|(x, w)| x.dot(*w)).sum()
}

/// Largest distance of a vertex from where the straight column has it, across the axis, in units of the width.
fn bow(c: &Column, motion: &Simulation) -> f64 {
    let axis = |p: &DVec3| p.y + p.z - WIDTH;
    let end = motion.steps.last().expect("several steps");
    let middle =
        (0..end.len()).filter(|&v| (c.body.rest[v] - DVec3::new(0.5, WIDTH / 2.0, WIDTH / 2.0)).length() < 1e-9);
    middle.map(|v| axis(&end[v]).abs() / WIDTH).fold(0.0, f64::max)
}

fn gradient(c: &Column, s: &Squeeze, motion: &Simulation) -> Gradient {
    simulate_vjp(&c.body, &s.elasticity, &s.settings, motion, &c.weights).expect("good input")
}

#[test]
fn gradients_through_indefinite_steps_are_exact_and_the_steps_are_named() {
    // Element-wise clamping finds a stationary point of the energy but cannot tell it from a minimum, and nothing pushes
    // the column aside: it stays straight, and the adjoint's true Hessian is indefinite.
    let (c, s) = squeeze(Filter::Clamp, 1e-11);
    let motion = run(&c, &s);
    let g = gradient(&c, &s, &motion);
    println!("bowed by {:.1e}, indefinite steps {:?}", bow(&c, &motion), g.indefinite_steps);
    assert!(bow(&c, &motion) < 1e-9);
    assert!(g.indefinite_steps.len() >= 2 && g.indefinite_steps.iter().all(|n| *n < FRAMES));
    assert!(g.unsolved_steps.is_empty());

    let by_shortening: f64 = (0..FRAMES)
        .flat_map(|n| c.body.driven.iter().zip(&g.d_path[n]).map(move |(&v, d)| (n, v, d)))
        .map(|(n, v, d)| d.x * (0.5 - c.body.rest[v as usize].x) * (n + 1) as f64 / FRAMES as f64)
        .sum();
    let swell = g.d_start.velocities.iter().zip(&c.body.rest);
    let by_swell: f64 = swell.map(|(d, p)| d.dot(swelling(*p))).sum();
    type Put = fn(&mut Squeeze, &[f64]);
    let m = &s.elasticity;
    let (alpha, beta) = (s.settings.mass_damping, s.settings.stiffness_damping);
    let parameters: [(&str, Vec<f64>, Vec<f64>, Put); 7] = [
        ("ln E", m.ln_youngs.clone(), g.d_ln_youngs.clone(), |s, p| s.elasticity.ln_youngs = p.to_vec()),
        ("ν", vec![m.poisson], vec![g.d_poisson], |s, p| s.elasticity.poisson = p[0]),
        ("ln ρ", vec![m.density.ln()], vec![g.d_density * m.density], |s, p| s.elasticity.density = p[0].exp()),
        ("driven path", vec![s.shortening], vec![by_shortening], |s, p| s.shortening = p[0]),
        ("initial velocities", vec![s.swell], vec![by_swell], |s, p| s.swell = p[0]),
        ("ln α", vec![alpha.ln()], vec![g.d_mass_damping * alpha], |s, p| s.settings.mass_damping = p[0].exp()),
        ("ln β", vec![beta.ln()], vec![g.d_stiffness_damping * beta], |s, p| {
            s.settings.stiffness_damping = p[0].exp()
        }),
    ];
    for (name, value, analytic, put) in parameters {
        let perturbed = |p: &[f64]| {
            let mut s = s.clone();
            put(&mut s, p);
            loss(&c, &run(&c, &s))
        };
        let error = gradient_error(perturbed, &value, &analytic, 2, &STEPS, 4);
        println!("{name}: {error:.1e}");
        assert!(error < 1e-6);
    }
}

#[test]
fn the_default_step_leaves_a_saddle_for_a_minimum_and_reports_it() {
    let (c, s) = squeeze(Filter::OnDemand, 1e-5);
    let motion = run(&c, &s);
    let g = gradient(&c, &s, &motion);
    let escapes: Vec<usize> = motion.reports.iter().map(|r| r.saddle_escapes).collect();
    println!("bowed by {:.2} widths, escapes {escapes:?}, indefinite steps {:?}", bow(&c, &motion), g.indefinite_steps);
    assert!(escapes.iter().sum::<usize>() > 0 && motion.reports.iter().all(|r| !r.saddle));
    assert!(bow(&c, &motion) > 0.3 && g.indefinite_steps.is_empty());
    // The bowed column stores less than the straight one.
    let (_, straight) = squeeze(Filter::Clamp, 1e-11);
    let mut stepper = animimic_sim::Stepper::new(&c.body, &s.elasticity, &s.settings).expect("good input");
    let mut energy = |motion: &Simulation| {
        let at_rest = State::at_rest(motion.steps.last().expect("several steps"));
        stepper.energy(&at_rest).expect("good input")
    };
    let (bowed, straight) = (energy(&motion), energy(&run(&c, &straight)));
    println!("energy bowed {bowed:.2} J, straight {straight:.2} J");
    assert!(bowed < 0.9 * straight);
}
