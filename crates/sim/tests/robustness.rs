//! Collapsed, inverted and overstretched starts recover; a wide grid of materials and steps converges.

use animimic_math::gradcheck::SplitMix64;
use animimic_scene::TetMesh;
use animimic_sim::fixtures::{beam, driven_beam};
use animimic_sim::{Body, Elasticity, Filter, Model, Settings, State, Stepper, simulate};
use glam::DVec3;

fn random(rng: &mut SplitMix64) -> DVec3 {
    DVec3::new(rng.normal(), rng.normal(), rng.normal())
}

/// Where a start puts a vertex, by its number and rest position.
type Start<'a> = &'a dyn Fn(usize, DVec3) -> DVec3;

#[test]
fn a_body_recovers_from_any_collapsed_start() {
    let mesh = beam([6, 2, 2], [1.2, 0.4, 0.4]);
    let mut rng = SplitMix64(17);
    let noise: Vec<DVec3> = mesh.positions.iter().map(|_| random(&mut rng)).collect();
    let starts: [(&str, Start); 8] = [
        ("point", &|_, _| DVec3::new(0.3, 0.2, 0.2)),
        ("blurred point", &|v, _| DVec3::new(0.3, 0.2, 0.2) + 1e-3 * noise[v]),
        ("plane", &|_, p| DVec3::new(p.x, p.y, 0.2)),
        ("line", &|_, p| DVec3::new(p.x, 0.2, 0.2)),
        ("stretched by 200 %", &|_, p| DVec3::new(3.0 * p.x, p.y, p.z)),
        ("inverted", &|_, p| DVec3::new(p.x, 0.4 - p.y, p.z)),
        ("inverted through its end", &|_, p| DVec3::new(-p.x, p.y, p.z)),
        ("random", &|v, _| 0.5 * noise[v]),
    ];
    // Linear elasticity has no inversion to recover from; its step is one solve.
    for model in [Model::FixedCorotated, Model::StableNeoHookean, Model::CorotatedLinear] {
        for held in [vec![], (0..9).collect()] {
            for (name, map) in starts {
                let positions: Vec<DVec3> = mesh.positions.iter().enumerate().map(|(v, p)| map(v, *p)).collect();
                let end = relax(&mesh, model, &held, &positions);
                println!(
                    "{} {name}, {} held: energy left {:.1e}, {} inverted, {} steps missed, wound around {:?}",
                    model.name(),
                    held.len(),
                    end.energy,
                    end.inverted,
                    end.missed,
                    end.wound
                );
                assert_eq!(end.inverted, 0);
                // Corotated linear elasticity has kinks where R jumps: the first step out of a point may stop at one.
                assert!(end.missed <= usize::from(model == Model::CorotatedLinear));
                let excused = WOUND.contains(&(model, held.is_empty(), name)) && !end.wound.is_empty();
                assert!(end.energy < if excused { 0.5 } else { 1e-4 });
            }
        }
    }
}

/// Starts (model, free, name) out of which tets end wound around an edge twice: held by a face that the body must pass
/// through, or out of the kinks of corotated linear elasticity. These are equilibria with every tet upright, which no motion
/// of upright tets undoes; the edges are named. Nothing else has such an excuse.
const WOUND: [(Model, bool, &str); 7] = [
    (Model::FixedCorotated, false, "point"),
    (Model::FixedCorotated, false, "blurred point"),
    (Model::FixedCorotated, false, "inverted through its end"),
    (Model::StableNeoHookean, false, "point"),
    (Model::StableNeoHookean, false, "blurred point"),
    (Model::StableNeoHookean, false, "inverted through its end"),
    (Model::CorotatedLinear, true, "blurred point"),
];

/// How a body ended that was left alone for 5 s.
struct Relaxed {
    /// Share of the energy that is left.
    energy: f64,
    inverted: usize,
    /// Steps short of the tolerance.
    missed: usize,
    wound: Vec<[u32; 2]>,
}

fn relax(mesh: &TetMesh, model: Model, held: &[u32], positions: &[DVec3]) -> Relaxed {
    let body = Body::new(mesh, held).expect("a good mesh");
    let path: Vec<DVec3> = held.iter().map(|&v| mesh.positions[v as usize]).collect();
    let elasticity = Elasticity::uniform(model, mesh.tets.len(), 1e5, 0.4, 1000.0);
    let settings = Settings { max_newton: 100, mass_damping: 1.0, ..Settings::default() };
    let mut stepper = Stepper::new(&body, &elasticity, &settings).expect("good input");
    let mut state = State::at_rest(positions);
    let first = stepper.energy(&state).expect("good input");
    let (mut inverted, mut missed) = (0, 0);
    for _ in 0..150 {
        let (next, report) = stepper.step(&state, &path).expect("good input");
        missed += usize::from(!report.converged);
        (state, inverted) = (next, report.inverted);
    }
    let energy = stepper.energy(&state).expect("good input") / first;
    Relaxed { energy, inverted, missed, wound: body.wound_edges(&state.positions) }
}

#[test]
fn at_least_99_percent_of_a_grid_of_materials_and_steps_converges() {
    let (mut total, mut failed) = (0, vec![]);
    for model in Model::ALL {
        for youngs in [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9] {
            for poisson in [0.0, 0.3, 0.45, 0.49] {
                for h in [1e-3, 5e-3, 1.0 / 60.0, 1.0 / 24.0] {
                    let problem = driven_beam([12, 3, 3], youngs, h, 12);
                    let body = Body::new(&problem.mesh, &problem.driven).expect("a good mesh");
                    let elasticity = Elasticity::per_tet(model, &problem.youngs, poisson, 1000.0);
                    let settings = Settings { frame_time: h, ..Settings::default() };
                    let start = State::at_rest(&problem.mesh.positions);
                    let motion = simulate(&body, &elasticity, &settings, &start, &problem.path).expect("good input");
                    total += motion.reports.len();
                    for n in motion.unconverged() {
                        failed.push(format!(
                            "{} E {youngs:e} ν {poisson} h {h:.4} step {n}: {:?}",
                            model.name(),
                            motion.reports[n]
                        ));
                    }
                }
            }
        }
    }
    failed.iter().for_each(|f| println!("{f}"));
    println!("{} of {total} steps converged", total - failed.len());
    assert!(failed.len() * 100 <= total);
}

#[test]
fn without_a_filter_an_indefinite_step_is_reported_and_not_hidden() {
    let mesh = beam([4, 2, 2], [1.0, 0.5, 0.5]);
    let body = Body::new(&mesh, &[]).expect("a good mesh");
    let elasticity = Elasticity::uniform(Model::FixedCorotated, mesh.tets.len(), 1e7, 0.4, 1000.0);
    let settings = Settings { filter: Filter::None, ..Settings::default() };
    let squashed: Vec<DVec3> = mesh.positions.iter().map(|p| DVec3::new(0.3 * p.x, p.y, p.z)).collect();
    let motion = simulate(&body, &elasticity, &settings, &State::at_rest(&squashed), &[vec![]]).expect("good input");
    println!("{:?}", motion.reports[0]);
    assert!(!motion.reports[0].converged && motion.reports[0].indefinite > 0);
    assert_eq!(motion.unconverged(), [0]);
}
