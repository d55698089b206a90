//! What a body must do whatever the numbers: keep momentum, lose energy, bend like a beam, rest at rest.

use animimic_math::gradcheck::SplitMix64;
use animimic_sim::fixtures::beam;
use animimic_sim::{Body, Elasticity, Model, Settings, State, Stepper, simulate};
use glam::DVec3;

fn random(rng: &mut SplitMix64) -> DVec3 {
    DVec3::new(rng.normal(), rng.normal(), rng.normal())
}

fn momentum(body: &Body, density: f64, state: &State) -> DVec3 {
    let pairs = body.lumped_volume.iter().zip(&state.velocities);
    pairs.map(|(v, u)| density * *v * *u).sum()
}

#[test]
fn a_free_body_keeps_its_linear_momentum() {
    let mesh = beam([6, 2, 2], [1.2, 0.4, 0.4]);
    let body = Body::new(&mesh, &[]).expect("a good mesh");
    for model in Model::ALL {
        let elasticity = Elasticity::uniform(model, mesh.tets.len(), 1e4, 0.4, 1000.0);
        let settings = Settings { tolerance: 1e-12, ..Settings::default() };
        let mut rng = SplitMix64(4);
        let mut start = State::at_rest(&mesh.positions);
        start.velocities.iter_mut().for_each(|v| *v = DVec3::new(1.0, -0.5, 0.25) + 0.5 * random(&mut rng));
        let before = momentum(&body, 1000.0, &start);
        let motion = simulate(&body, &elasticity, &settings, &start, &vec![vec![]; 20]).expect("good input");
        let after = momentum(&body, 1000.0, &motion.state(20, &settings));
        let error = (after - before).length() / before.length();
        println!("{}: momentum changed by {error:.1e} over 20 steps", model.name());
        assert!(error < 1e-12);
    }
}

/// Where a start puts a vertex, by its rest position.
type Map<'a> = &'a dyn Fn(DVec3) -> DVec3;

#[test]
fn energy_never_rises_without_driving() {
    // Kinetic + elastic energy of backward Euler at fixed boundaries, from stretched, twisted and thrown starts.
    let mesh = beam([6, 2, 2], [1.2, 0.4, 0.4]);
    let held: Vec<u32> = (0..9).collect();
    let twist = |p: DVec3| {
        let (s, c) = (1.5 * p.x).sin_cos();
        let (y, z) = (p.y - 0.2, p.z - 0.2);
        DVec3::new(p.x, 0.2 + c * y - s * z, 0.2 + s * y + c * z)
    };
    let starts: [(&str, Map, DVec3); 4] = [
        ("stretched", &|p| DVec3::new(1.5 * p.x, p.y, p.z), DVec3::ZERO),
        ("squashed", &|p| DVec3::new(0.6 * p.x, p.y, p.z), DVec3::ZERO),
        ("twisted", &twist, DVec3::ZERO),
        ("thrown", &|p| p, DVec3::new(0.0, 2.0, 0.0)),
    ];
    for driven in [vec![], held] {
        let body = Body::new(&mesh, &driven).expect("a good mesh");
        for model in Model::ALL {
            let elasticity = Elasticity::uniform(model, mesh.tets.len(), 2e4, 0.4, 1000.0);
            let settings = Settings { tolerance: 1e-8, ..Settings::default() };
            for (name, map, velocity) in &starts {
                let positions: Vec<DVec3> = mesh.positions.iter().map(|p| map(*p)).collect();
                let velocities = (0..positions.len() as u32)
                    .map(|v| if driven.contains(&v) { DVec3::ZERO } else { *velocity })
                    .collect();
                let mut state = State { positions, velocities };
                let path: Vec<DVec3> = driven.iter().map(|&v| state.positions[v as usize]).collect();
                let mut stepper = Stepper::new(&body, &elasticity, &settings).expect("good input");
                let mut energy = stepper.energy(&state).expect("good input");
                let first = energy;
                for n in 0..30 {
                    let (next, report) = stepper.step(&state, &path).expect("good input");
                    assert!(report.converged, "{} {name} step {n}: {report:?}", model.name());
                    let now = stepper.energy(&next).expect("good input");
                    assert!(now <= energy * (1.0 + 1e-9), "{} {name} step {n}: {energy} J -> {now} J", model.name());
                    (state, energy) = (next, now);
                }
                println!("{} {name}: {first:.1} J -> {energy:.3} J", model.name());
            }
        }
    }
}

/// Tip deflection [m] of a cantilever under gravity g, cut into n × n × 10n cells.
fn deflection(model: Model, n: usize, gravity: f64) -> f64 {
    let (length, width) = (1.0, 0.1);
    let mesh = beam([10 * n, n, n], [length, width, width]);
    let driven: Vec<u32> = (0..((n + 1) * (n + 1)) as u32).collect();
    let body = Body::new(&mesh, &driven).expect("a good mesh");
    // ν = 0: beam theory has no clamped-end Poisson effect to leave out.
    let elasticity = Elasticity::uniform(model, mesh.tets.len(), 1e6, 0.0, 1000.0);
    // Steps of 100 s are statics.
    let settings = Settings {
        frame_time: 100.0,
        tolerance: 1e-10,
        gravity: DVec3::new(0.0, -gravity, 0.0),
        ..Settings::default()
    };
    let path: Vec<DVec3> = driven.iter().map(|&v| mesh.positions[v as usize]).collect();
    let motion =
        simulate(&body, &elasticity, &settings, &State::at_rest(&mesh.positions), &vec![path; 3]).expect("good input");
    assert!(motion.unconverged().is_empty());
    let tip = mesh.positions.iter().enumerate().filter(|(_, p)| p.x > length - 1e-9);
    let (sum, count) = tip.fold((0.0, 0), |(s, c), (v, p)| (s + p.y - motion.steps[2][v].y, c + 1));
    sum / f64::from(count)
}

#[test]
fn a_cantilever_converges_to_beam_theory() {
    // Timoshenko: w = ρ g A L⁴ / (8 E I) + ρ g A L² / (2 κ G A), κ = 5/6, G = E/2 at ν = 0. Small load: small strain.
    let (e, rho, g, length, width) = (1e6, 1000.0, 0.01, 1.0f64, 0.1f64);
    let (area, inertia) = (width * width, width.powi(4) / 12.0);
    let theory =
        rho * g * area * length.powi(4) / (8.0 * e * inertia) + rho * g * length.powi(2) / (2.0 * 5.0 / 6.0 * e / 2.0);
    for model in [Model::FixedCorotated, Model::Linear] {
        let errors: Vec<f64> = [1, 2, 4, 8].map(|n| (deflection(model, n, g) - theory).abs() / theory).to_vec();
        println!("{}: relative errors {errors:.4?} at 1, 2, 4, 8 cells across (theory {theory:.4e} m)", model.name());
        assert!(errors.windows(2).all(|e| e[1] < 0.6 * e[0]));
        // Linear tets converge with h²: what Richardson extrapolation leaves is the distance to the theory itself.
        let limit = (4.0 * errors[3] - errors[2]) / 3.0;
        println!("extrapolated error {limit:.4}");
        assert!(errors[3] < 0.06 && limit.abs() < 0.02);
    }
}

#[test]
fn a_body_at_rest_stays_at_rest_and_a_translating_one_keeps_its_shape() {
    let mesh = beam([4, 2, 2], [1.0, 0.5, 0.5]);
    let body = Body::new(&mesh, &[]).expect("a good mesh");
    for model in Model::ALL {
        let elasticity = Elasticity::uniform(model, mesh.tets.len(), 1e5, 0.4, 1000.0);
        let settings = Settings::default();
        let mut start = State::at_rest(&mesh.positions);
        start.velocities.fill(DVec3::new(0.6, 0.0, 0.3));
        let motion = simulate(&body, &elasticity, &settings, &start, &vec![vec![]; 5]).expect("good input");
        let moved = 5.0 * settings.frame_time * start.velocities[0];
        let worst =
            motion.steps[4].iter().zip(&mesh.positions).fold(0.0f64, |m, (a, b)| m.max((*a - *b - moved).length()));
        println!("{}: shape error {worst:.1e} m", model.name());
        assert!(worst < 1e-13);
    }
}

#[test]
fn gravity_accelerates_and_mass_damping_brakes() {
    let mesh = beam([2, 1, 1], [1.0, 0.5, 0.5]);
    let body = Body::new(&mesh, &[]).expect("a good mesh");
    let elasticity = Elasticity::uniform(Model::FixedCorotated, mesh.tets.len(), 1e5, 0.4, 1000.0);
    let (g, alpha, h) = (-9.81, 2.0, 0.01);
    let settings =
        Settings { frame_time: h, gravity: DVec3::new(0.0, g, 0.0), mass_damping: alpha, ..Settings::default() };
    let motion = simulate(&body, &elasticity, &settings, &State::at_rest(&mesh.positions), &vec![vec![]; 50])
        .expect("good input");
    // v⁺ = (v + h g) / (1 + h α).
    let expected = (0..50).fold(0.0, |v, _| (v + h * g) / (1.0 + h * alpha));
    let got = motion.state(50, &settings).velocities[3].y;
    println!("velocity {got}, expected {expected}");
    assert!((got - expected).abs() < 1e-9);
}

#[test]
fn the_same_input_gives_the_same_bytes_for_any_number_of_threads() {
    let problem = animimic_sim::fixtures::driven_beam([28, 8, 8], 1e5, 1.0 / 30.0, 3);
    let body = Body::new(&problem.mesh, &problem.driven).expect("a good mesh");
    let elasticity = Elasticity::per_tet(Model::FixedCorotated, &problem.youngs, 0.4, 1000.0);
    let settings = Settings::default();
    let bytes = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let run = || {
            let start = State::at_rest(&problem.mesh.positions);
            let motion = simulate(&body, &elasticity, &settings, &start, &problem.path).expect("good input");
            let gradient =
                animimic_sim::simulate_vjp(&body, &elasticity, &settings, &motion, &motion.steps).expect("good input");
            let positions = motion.steps.iter().flatten().flat_map(|p| p.to_array());
            positions.chain(gradient.d_ln_youngs).map(f64::to_bits).collect::<Vec<u64>>()
        };
        pool.install(run)
    };
    let one = bytes(1);
    assert!(one == bytes(2) && one == bytes(5), "threads changed the bytes");
}
