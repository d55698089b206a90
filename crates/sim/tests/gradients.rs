//! The gradient of whole trajectories against central differences of whole simulations:
//! every model × {near rest, squashed, inverted} × {E, ν, density, driven motion, initial state, gravity, damping}.

use animimic_math::gradcheck::{SplitMix64, gradient_error};
use animimic_sim::fixtures::beam;
use animimic_sim::{
    Body, Elasticity, Gradient, Model, Sensitivities, Settings, Simulation, State, Tether, sensitivities, simulate,
    simulate_vjp,
};
use glam::{DMat3, DVec3};

const FRAMES: usize = 3;
const STEPS: [f64; 5] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// Everything a trajectory depends on.
#[derive(Clone)]
struct Inputs {
    elasticity: Elasticity,
    settings: Settings,
    start: State,
    path: Vec<Vec<DVec3>>,
}

struct Case {
    body: Body,
    inputs: Inputs,
    /// Loss weights: L = Σ w·x + ½ Σ |x|².
    weights: Vec<Vec<DVec3>>,
}

fn random(rng: &mut SplitMix64) -> DVec3 {
    DVec3::new(rng.normal(), rng.normal(), rng.normal())
}

/// A small beam held at x = 0 and, on two springs, inside, whose start is mapped by `f`; moduli, velocities, path and loss are random.
fn case(model: Model, f: DMat3, damped: bool) -> Case {
    let mesh = beam([3, 1, 1], [0.9, 0.3, 0.3]);
    let driven = [0u32, 1, 2, 3];
    let mut rng = SplitMix64(21);
    let cluster: Vec<u32> = (0..mesh.tets.len() as u32).map(|t| t % 3).collect();
    let ln_youngs = (0..3).map(|_| (2e3 * (1.0 + rng.uniform())).ln()).collect();
    let elasticity = Elasticity { model, cluster, ln_youngs, poisson: 0.3, density: 900.0 };
    let positions: Vec<DVec3> = mesh.positions.iter().map(|p| f * *p + 0.004 * random(&mut rng)).collect();
    let velocities = mesh.positions.iter().map(|_| 0.3 * random(&mut rng)).collect();
    let tether = |tet, barycentric| Tether { tet, barycentric, stiffness: 0.2 };
    let tethers = vec![tether(0, [0.1, 0.2, 0.3, 0.4]), tether(mesh.tets.len() as u32 - 2, [0.4, 0.1, 0.3, 0.2])];
    let body = Body::new(&mesh, &driven).expect("a good mesh").tethered(tethers).expect("good tethers");
    let mut held: Vec<DVec3> = driven.iter().map(|&v| positions[v as usize]).collect();
    held.extend(body.tethered_points(&positions));
    let path =
        (0..FRAMES).map(|n| held.iter().map(|p| *p + 0.01 * (n + 1) as f64 * random(&mut rng)).collect()).collect();
    let mut settings = Settings { frame_time: 0.02, substeps: 2, tolerance: 1e-11, ..Settings::default() };
    if damped {
        settings.gravity = DVec3::new(0.3, -2.0, 0.5);
        settings.mass_damping = 1.5;
        settings.stiffness_damping = 0.1;
    }
    let weights = (0..FRAMES).map(|_| mesh.positions.iter().map(|_| random(&mut rng)).collect()).collect();
    Case { body, inputs: Inputs { elasticity, settings, start: State { positions, velocities }, path }, weights }
}

fn run(body: &Body, i: &Inputs) -> Simulation {
    let motion = simulate(body, &i.elasticity, &i.settings, &i.start, &i.path).expect("good input");
    assert!(motion.unconverged().is_empty(), "unconverged {:?}", motion.reports);
    motion
}

fn loss(c: &Case, motion: &Simulation) -> f64 {
    let pairs = motion.frames().zip(&c.weights).flat_map(|(x, w)| x.iter().zip(w));
    pairs.map(|(x, w)| x.dot(*w) + 0.5 * x.length_squared()).sum()
}

fn gradient(c: &Case, motion: &Simulation) -> Gradient {
    let d: Vec<Vec<DVec3>> =
        motion.frames().zip(&c.weights).map(|(x, w)| x.iter().zip(w).map(|(x, w)| *x + *w).collect()).collect();
    simulate_vjp(&c.body, &c.inputs.elasticity, &c.inputs.settings, motion, &d).expect("good input")
}

fn flat(x: &[DVec3]) -> Vec<f64> {
    x.iter().flat_map(|p| p.to_array()).collect()
}

fn points(x: &[f64]) -> Vec<DVec3> {
    x.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

/// A named parameter: its value, its gradient, and how to put another value in its place.
type Parameter = (&'static str, Vec<f64>, Vec<f64>, fn(&mut Inputs, &[f64]));

fn parameters(i: &Inputs, g: &Gradient, damped: bool) -> Vec<Parameter> {
    let mut list: Vec<Parameter> = vec![
        ("ln E", i.elasticity.ln_youngs.clone(), g.d_ln_youngs.clone(), |i, p| i.elasticity.ln_youngs = p.to_vec()),
        ("ν", vec![i.elasticity.poisson], vec![g.d_poisson], |i, p| i.elasticity.poisson = p[0]),
        ("ln ρ", vec![i.elasticity.density.ln()], vec![g.d_density * i.elasticity.density], |i, p| {
            i.elasticity.density = p[0].exp();
        }),
        ("driven path", flat(&i.path.concat()), flat(&g.d_path.concat()), |i, p| {
            i.path = points(p).chunks(i.path[0].len()).map(<[_]>::to_vec).collect();
        }),
        ("initial positions", flat(&i.start.positions), flat(&g.d_start.positions), |i, p| {
            i.start.positions = points(p)
        }),
        ("initial velocities", flat(&i.start.velocities), flat(&g.d_start.velocities), |i, p| {
            i.start.velocities = points(p);
        }),
    ];
    if damped {
        list.push(("gravity", i.settings.gravity.to_array().to_vec(), g.d_gravity.to_array().to_vec(), |i, p| {
            i.settings.gravity = DVec3::from_slice(p);
        }));
        let (alpha, beta) = (i.settings.mass_damping, i.settings.stiffness_damping);
        list.push(("ln α", vec![alpha.ln()], vec![g.d_mass_damping * alpha], |i, p| {
            i.settings.mass_damping = p[0].exp()
        }));
        list.push(("ln β", vec![beta.ln()], vec![g.d_stiffness_damping * beta], |i, p| {
            i.settings.stiffness_damping = p[0].exp();
        }));
    }
    list
}

fn states() -> [(&'static str, DMat3); 3] {
    [
        ("near rest", DMat3::IDENTITY),
        ("squashed", DMat3::from_diagonal(DVec3::new(1.0, 0.45, 1.1))),
        ("inverted", DMat3::from_diagonal(DVec3::new(1.0, 1.0, -0.5))),
    ]
}

fn check(model: Model, state: &str, f: DMat3, damped: bool) -> f64 {
    let c = case(model, f, damped);
    let motion = run(&c.body, &c.inputs);
    let inverted = motion.reports.iter().filter(|r| r.inverted > 0).count();
    assert_eq!(inverted > 0, state == "inverted", "{inverted} steps end with inverted tets");
    let g = gradient(&c, &motion);
    let mut worst = 0.0f64;
    for (name, value, analytic, put) in parameters(&c.inputs, &g, damped) {
        let perturbed = |p: &[f64]| {
            let mut inputs = c.inputs.clone();
            put(&mut inputs, p);
            loss(&c, &run(&c.body, &inputs))
        };
        let error = gradient_error(perturbed, &value, &analytic, 3, &STEPS, 4);
        println!("{} {state}{}: {name} {error:.1e}", model.name(), if damped { " damped" } else { "" });
        worst = worst.max(error);
    }
    worst
}

#[test]
fn trajectory_gradients_of_every_model_and_state_are_exact() {
    for model in Model::ALL {
        for (state, f) in states() {
            assert!(check(model, state, f, false) < 1e-6);
        }
    }
}

#[test]
fn trajectory_gradients_with_gravity_and_damping_are_exact() {
    for model in Model::ALL {
        for (state, f) in states() {
            assert!(check(model, state, f, true) < 1e-6);
        }
    }
}

#[test]
fn forward_sensitivities_agree_with_the_adjoint_and_with_differences() {
    for model in Model::ALL {
        for (state, f) in states() {
            for damped in [false, true] {
                let c = case(model, f, damped);
                let motion = run(&c.body, &c.inputs);
                let s = sensitivities(&c.body, &c.inputs.elasticity, &c.inputs.settings, &motion).expect("good input");
                assert!(s.indefinite_steps.is_empty() && s.unsolved_steps.is_empty());
                let adjoint = gradient(&c, &motion).d_ln_youngs;
                let forward: Vec<f64> =
                    (0..adjoint.len()).map(|cluster| loss_change(&c, &motion, &s, cluster)).collect();
                let gap = forward.iter().zip(&adjoint).fold(0.0f64, |m, (a, b)| m.max((a - b).abs() / b.abs()));
                let perturbed = |p: &[f64]| {
                    let mut inputs = c.inputs.clone();
                    inputs.elasticity.ln_youngs = p.to_vec();
                    loss(&c, &run(&c.body, &inputs))
                };
                let error = gradient_error(perturbed, &c.inputs.elasticity.ln_youngs, &forward, 3, &STEPS, 4);
                let damping = if damped { " damped" } else { "" };
                println!("{} {state}{damping}: against adjoint {gap:.1e}, differences {error:.1e}", model.name());
                assert!(gap < 1e-8 && error < 1e-6);
            }
        }
    }
}

/// ∂L/∂ln E of one cluster by the chain rule through the forward sensitivities.
fn loss_change(c: &Case, motion: &Simulation, s: &Sensitivities, cluster: usize) -> f64 {
    let at = |(n, x): (usize, &Vec<DVec3>)| -> f64 {
        let change = s.frames[n][cluster].as_chunks::<3>().0;
        let pairs = c.body.free.iter().zip(change);
        pairs.map(|(&v, d)| DVec3::from_array(*d).dot(x[v as usize] + c.weights[n][v as usize])).sum()
    };
    motion.frames().enumerate().map(at).sum()
}

#[test]
fn factors_kept_within_a_memory_bound_give_the_same_gradient() {
    for model in Model::ALL {
        let mut c = case(model, DMat3::IDENTITY, true);
        let expected = gradient(&c, &run(&c.body, &c.inputs)).d_ln_youngs;
        let one = c.body.factor_bytes();
        for (bound, kept) in [(one - 1, 0), (3 * one + one / 2, 3), (100 * one, 6)] {
            c.inputs.settings.factor_memory = bound;
            let motion = run(&c.body, &c.inputs);
            let got = gradient(&c, &motion).d_ln_youngs;
            let gap = expected.iter().zip(&got).fold(0.0f64, |m, (a, b)| m.max(((a - b) / a).abs()));
            println!(
                "{}: {} of {bound} bytes kept, gradients differ by {gap:.1e}",
                model.name(),
                motion.factor_bytes()
            );
            assert!(motion.factor_bytes() <= bound && motion.factor_bytes() <= kept * one && gap < 1e-9);
            assert!(kept != 3 || motion.factor_bytes() == 3 * one, "the memory is used");
        }
    }
}
