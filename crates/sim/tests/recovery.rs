//! The stiffness of a two-material beam from its motion, each modulus 100 times off at the start, in every combination.

use animimic_sim::fixtures::beam;
use animimic_sim::{Body, Elasticity, Model, Settings, State, gauss_newton, simulate};
use glam::DVec3;

#[test]
fn two_moduli_a_hundred_times_off_are_found_in_ten_iterations() {
    let mesh = beam([10, 2, 2], [1.0, 0.2, 0.2]);
    let held: Vec<u32> = (0..9).collect();
    let body = Body::new(&mesh, &held).expect("a good mesh");
    let centre = |t: &[u32; 4]| t.iter().map(|&v| mesh.positions[v as usize].x).sum::<f64>() / 4.0;
    let cluster: Vec<u32> = mesh.tets.iter().map(|t| u32::from(centre(t) > 0.5)).collect();
    let truth = [1e5f64, 3e4];
    let shake = |n: usize| DVec3::new(0.0, 0.05 * (0.6 * n as f64).sin(), 0.03 * (0.9 * n as f64).cos() - 0.03);
    let frame = |n| held.iter().map(|&v| mesh.positions[v as usize] + shake(n)).collect();
    let path: Vec<Vec<DVec3>> = (1..=16).map(frame).collect();
    let start = State::at_rest(&mesh.positions);
    let plain = Settings { tolerance: 1e-8, ..Settings::default() };
    let damped = Settings { mass_damping: 0.5, stiffness_damping: 0.005, ..plain.clone() };
    let cases = [(Model::FixedCorotated, &plain), (Model::StableNeoHookean, &plain), (Model::FixedCorotated, &damped)];
    for (model, settings) in cases {
        let material = |youngs: [f64; 2]| Elasticity {
            model,
            cluster: cluster.clone(),
            ln_youngs: youngs.map(f64::ln).to_vec(),
            poisson: 0.4,
            density: 1000.0,
        };
        let motion = simulate(&body, &material(truth), settings, &start, &path).expect("good input");
        let seen: Vec<Vec<DVec3>> = motion.frames().cloned().collect();
        for off in [[100.0, 100.0], [0.01, 0.01], [100.0, 0.01], [0.01, 100.0]] {
            let guess = material([truth[0] * off[0], truth[1] * off[1]]);
            let (fitted, history) =
                gauss_newton(&body, &guess, settings, &start, &path, &seen, 10, 1e-5).expect("good input");
            let error = fitted.ln_youngs.iter().zip(truth).map(|(l, e)| (l.exp() / e - 1.0).abs()).fold(0.0, f64::max);
            let damping = settings.stiffness_damping;
            println!(
                "{}, β {damping} s, off by {off:?}: error {error:.1e} after {} iterations",
                model.name(),
                history.len()
            );
            assert!(error < 0.01);
        }
    }
}
