//! Recovers the stiffness of a two-material beam from its motion: both moduli start 100 times off, Gauss–Newton on forward
//! sensitivities finds them. `cargo run --release -p animimic-sim --example beam_stiffness`

use animimic_sim::fixtures::beam;
use animimic_sim::{Body, Elasticity, Model, Settings, SimError, State, gauss_newton, simulate};
use glam::DVec3;

fn main() -> Result<(), SimError> {
    let mesh = beam([12, 2, 2], [1.2, 0.2, 0.2]);
    let held: Vec<u32> = (0..9).collect();
    let body = Body::new(&mesh, &held)?;
    // Cluster 0 is the half near the wall, cluster 1 the free half.
    let centre = |t: &[u32; 4]| t.iter().map(|&v| mesh.positions[v as usize].x).sum::<f64>() / 4.0;
    let cluster: Vec<u32> = mesh.tets.iter().map(|t| u32::from(centre(t) > 0.6)).collect();
    let truth = [2e5f64, 4e4];
    let material = |youngs: [f64; 2]| Elasticity {
        model: Model::FixedCorotated,
        cluster: cluster.clone(),
        ln_youngs: youngs.map(f64::ln).to_vec(),
        poisson: 0.4,
        density: 1000.0,
    };
    // The wall shakes; what the camera of a real case would see are the positions of every frame.
    let settings = Settings { tolerance: 1e-8, ..Settings::default() };
    let shake = |n: usize| DVec3::new(0.0, 0.05 * (0.6 * n as f64).sin(), 0.03 * (0.9 * n as f64).cos() - 0.03);
    let path: Vec<Vec<DVec3>> =
        (1..=24).map(|n| held.iter().map(|&v| mesh.positions[v as usize] + shake(n)).collect()).collect();
    let start = State::at_rest(&mesh.positions);
    let seen: Vec<Vec<DVec3>> =
        simulate(&body, &material(truth), &settings, &start, &path)?.frames().cloned().collect();

    let guess = material([truth[0] * 100.0, truth[1] / 100.0]);
    let (fitted, history) = gauss_newton(&body, &guess, &settings, &start, &path, &seen, 10, 1e-6)?;
    for (n, step) in history.iter().enumerate() {
        let youngs: Vec<String> = step.ln_youngs.iter().map(|l| format!("{:.1}", l.exp())).collect();
        println!(
            "iteration {n}: {} frames, loss before {:.3e} m², E = {} Pa",
            step.frames,
            step.loss,
            youngs.join(", ")
        );
    }
    let error = fitted.ln_youngs.iter().zip(truth).map(|(l, e)| (l.exp() / e - 1.0).abs()).fold(0.0, f64::max);
    println!("largest error of a modulus: {:.2e} after {} iterations", error, history.len());
    assert!(error < 0.01 && history.len() <= 10, "the moduli were not recovered");
    Ok(())
}
