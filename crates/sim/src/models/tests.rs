//! The family's tests: every model × every kind of state, through the assembled sums over tets.

use super::Model;
use crate::Elasticity;
use crate::assembly::{Medium, Scratch, contract, energy, gradient_and_product, hessian};
use crate::body::Body;
use crate::element::Lame;
use crate::filter::Eigenvalues;
use crate::fixtures::beam;
use animimic_math::gradcheck::{SplitMix64, gradient_error};
use animimic_math::sparse::BlockMatrix;
use glam::{DMat3, DVec3};

const STEPS: [f64; 4] = [1e-3, 1e-4, 1e-5, 1e-6];

struct Case {
    body: Body,
    lame: Lame,
    by_poisson: Lame,
    x: Vec<DVec3>,
}

fn lame_of(elasticity: &Elasticity, unit: [f64; 2]) -> Lame {
    let e: Vec<f64> = elasticity.cluster.iter().map(|&c| elasticity.ln_youngs[c as usize].exp()).collect();
    Lame { mu: e.iter().map(|e| e * unit[0]).collect(), lambda: e.iter().map(|e| e * unit[1]).collect() }
}

/// A small block of tets, mapped by `f` and a little noise; moduli differ from tet to tet.
fn case(model: Model, f: DMat3, noise: f64) -> Case {
    let mesh = beam([2, 1, 1], [1.0, 0.4, 0.5]);
    let mut rng = SplitMix64(12);
    let youngs: Vec<f64> = mesh.tets.iter().map(|_| 1.0 + rng.uniform()).collect();
    let elasticity = Elasticity::per_tet(model, &youngs, 0.3, 1.0);
    let x =
        mesh.positions.iter().map(|p| f * *p + noise * DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
    let (lame, by_poisson) =
        (lame_of(&elasticity, elasticity.unit_lame()), lame_of(&elasticity, elasticity.unit_lame_by_poisson()));
    Case { body: Body::new(&mesh, &[]).expect("a good mesh"), lame, by_poisson, x }
}

/// Kinds of state; all keep σ₁ + σ₂ above 0.1, where the rotation has a derivative.
fn states() -> [(&'static str, DMat3, f64); 5] {
    let turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_z(-1.1);
    let diagonal = |x, y, z| turn * DMat3::from_diagonal(DVec3::new(x, y, z)) * DMat3::from_rotation_x(0.4);
    [
        ("near rest", turn, 1e-3),
        ("generic", diagonal(1.3, 0.8, 1.1), 0.03),
        ("squashed", diagonal(1.2, 0.9, 0.15), 0.01),
        ("flat", diagonal(1.1, 0.9, 0.0), 0.0),
        ("inverted", diagonal(1.2, 0.9, -0.4), 0.01),
    ]
}

fn medium<'a>(model: Model, c: &'a Case) -> Medium<'a> {
    Medium { body: &c.body, model, lame: &c.lame, damper: None }
}

fn flat(x: &[DVec3]) -> Vec<f64> {
    x.iter().flat_map(|p| p.to_array()).collect()
}

fn points(x: &[f64]) -> Vec<DVec3> {
    x.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

fn random_field(n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = SplitMix64(seed);
    (0..n).map(|_| DVec3::new(rng.normal(), rng.normal(), rng.normal())).collect()
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn assembled(m: &Medium, x: &[DVec3], filter: Eigenvalues) -> (Vec<DVec3>, BlockMatrix) {
    let (mut gradient, mut matrix) = (vec![DVec3::ZERO; x.len()], BlockMatrix::zeros(m.body.pattern.clone()));
    hessian(m, x, filter, 1.0, &mut Scratch::default(), &mut gradient, &mut matrix);
    (gradient, matrix)
}

/// Matrix times a vertex field.
fn product(body: &Body, matrix: &BlockMatrix, u: &[DVec3]) -> Vec<DVec3> {
    let free: Vec<f64> = body.free.iter().flat_map(|&v| u[v as usize].to_array()).collect();
    let mut y = vec![0.0; free.len()];
    matrix.times(&free, &mut y);
    let mut out = vec![DVec3::ZERO; u.len()];
    body.free.iter().zip(y.as_chunks::<3>().0).for_each(|(&v, f)| out[v as usize] = DVec3::from_array(*f));
    out
}

#[test]
fn every_models_force_is_the_gradient_of_its_energy() {
    for model in Model::ALL {
        for (state, f, noise) in states() {
            let c = case(model, f, noise);
            let (gradient, _) = assembled(&medium(model, &c), &c.x, Eigenvalues::True);
            let value = |x: &[f64]| energy(&medium(model, &c), &points(x), &mut Scratch::default());
            let error = gradient_error(value, &flat(&c.x), &flat(&gradient), 6, &STEPS, 1);
            println!("{} {state}: force {error:.1e}", model.name());
            assert!(error < 1e-7);
        }
    }
}

#[test]
fn every_models_hessian_is_the_derivative_of_its_force() {
    for model in Model::ALL {
        for (state, f, noise) in states() {
            let c = case(model, f, noise);
            let m = medium(model, &c);
            let (_, matrix) = assembled(&m, &c.x, Eigenvalues::True);
            let (w, n) = (random_field(c.x.len(), 3), c.x.len());
            let value = |x: &[f64]| dot(&w, &assembled(&m, &points(x), Eigenvalues::True).0);
            let error = gradient_error(value, &flat(&c.x), &flat(&product(&c.body, &matrix, &w)), 6, &STEPS, 2);
            let (mut gradient, mut matrix_free) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
            gradient_and_product(&m, &c.x, &w, &mut Scratch::default(), &mut gradient, &mut matrix_free);
            let by_blocks = product(&c.body, &matrix, &w);
            let gap = by_blocks.iter().zip(&matrix_free).fold(0.0f64, |s, (a, b)| s.max((*a - *b).length()));
            println!("{} {state}: Hessian {error:.1e}, blocks against matrix-free {gap:.1e}", model.name());
            assert!(error < 1e-6 && gap < 1e-11);
        }
    }
}

#[test]
fn every_models_derivatives_to_modulus_and_poisson_are_exact() {
    for model in Model::ALL {
        for (state, f, noise) in states() {
            let c = case(model, f, noise);
            let a = random_field(c.x.len(), 5);
            let k = contract(&medium(model, &c), &c.by_poisson, &c.x, &a, &mut Scratch::default());
            let tets = c.body.tets.len();
            let mut rng = SplitMix64(12);
            let ln_e: Vec<f64> = (0..tets).map(|_| (1.0 + rng.uniform()).ln()).collect();
            let force = |p: &[f64]| {
                let youngs: Vec<f64> = p[..tets].iter().map(|l| l.exp()).collect();
                let elasticity = Elasticity::per_tet(model, &youngs, p[tets], 1.0);
                let lame = lame_of(&elasticity, elasticity.unit_lame());
                dot(&a, &assembled(&Medium { lame: &lame, ..medium(model, &c) }, &c.x, Eigenvalues::True).0)
            };
            let parameters: Vec<f64> = ln_e.into_iter().chain([0.3]).collect();
            let gradient: Vec<f64> = k.by_ln_youngs.iter().copied().chain([k.by_poisson]).collect();
            let error = gradient_error(force, &parameters, &gradient, 6, &STEPS, 2);
            println!("{} {state}: ln E and ν {error:.1e}", model.name());
            assert!(error < 1e-7);
        }
    }
}

#[test]
fn every_model_is_stress_free_at_rest_and_like_linear_elasticity_nearby() {
    for model in Model::ALL {
        let c = case(model, DMat3::IDENTITY, 0.0);
        let m = medium(model, &c);
        let (gradient, matrix) = assembled(&m, &c.x, Eigenvalues::True);
        let largest = gradient.iter().fold(0.0f64, |s, g| s.max(g.length()));
        let psi = energy(&m, &c.x, &mut Scratch::default());
        let linear = case(Model::Linear, DMat3::IDENTITY, 0.0);
        let (_, expected) = assembled(&medium(Model::Linear, &linear), &linear.x, Eigenvalues::True);
        let pairs = matrix.blocks.iter().flatten().zip(expected.blocks.iter().flatten());
        let gap = pairs.fold(0.0f64, |s, (a, b)| s.max((a - b).abs()));
        println!("{}: rest force {largest:.1e}, energy {psi:.1e}, stiffness against linear {gap:.1e}", model.name());
        assert!(largest < 1e-14 && psi.abs() < 1e-15 && gap < 1e-13);
    }
}

#[test]
fn linear_elasticity_has_the_textbook_stress() {
    // σ_xx = (λ + 2μ) ε, σ_yy = σ_zz = λ ε, σ_xy = 2μ ε_xy: uniaxial strain and shear of one tet.
    let mesh = beam([1, 1, 1], [1.0; 3]);
    let body = Body::new(&mesh, &[]).expect("a good mesh");
    let elasticity = Elasticity::uniform(Model::Linear, 6, 100.0, 0.25, 1.0);
    let lame = lame_of(&elasticity, elasticity.unit_lame());
    let m = Medium { body: &body, model: Model::Linear, lame: &lame, damper: None };
    let strain = DMat3::from_cols(DVec3::new(0.01, 0.02, 0.0), DVec3::new(0.02, 0.0, 0.0), DVec3::ZERO);
    let x: Vec<DVec3> = mesh.positions.iter().map(|p| *p + strain * *p).collect();
    let energy = energy(&m, &x, &mut Scratch::default());
    // μ = λ = 40 Pa: ψ = μ (0.01² + 2·0.02²) + λ/2 0.01².
    let expected = 40.0 * (1e-4 + 8e-4) + 20.0 * 1e-4;
    println!("energy {energy}, expected {expected}");
    assert!((energy - expected).abs() < 1e-15);
}

#[test]
fn filtered_hessians_are_semidefinite_and_true_ones_pass_through_the_filter_unchanged() {
    for model in Model::ALL.into_iter().filter(|m| *m != Model::Linear) {
        for (state, f, noise) in states() {
            let c = case(model, f, noise);
            let m = medium(model, &c);
            let mut rng = SplitMix64(8);
            let mut lowest = [f64::INFINITY; 3];
            for (n, filter) in [Eigenvalues::True, Eigenvalues::Clamped, Eigenvalues::Absolute].into_iter().enumerate()
            {
                let (_, matrix) = assembled(&m, &c.x, filter);
                // The lowest Rayleigh quotient over gradient-descent steps from random fields finds negative directions.
                for _ in 0..20 {
                    let mut u = random_field(c.x.len(), rng.next_u64());
                    for _ in 0..60 {
                        let au = product(&c.body, &matrix, &u);
                        let quotient = dot(&u, &au) / dot(&u, &u);
                        lowest[n] = lowest[n].min(quotient);
                        u.iter_mut().zip(&au).for_each(|(u, a)| *u -= 0.05 * *a);
                        let norm = dot(&u, &u).sqrt();
                        u.iter_mut().for_each(|u| *u /= norm);
                    }
                }
            }
            println!(
                "{} {state}: lowest quotients true {:.3}, clamped {:.1e}, absolute {:.1e}",
                model.name(),
                lowest[0],
                lowest[1],
                lowest[2]
            );
            assert!(lowest[1] > -1e-12 && lowest[2] > -1e-12);
            if state == "inverted" && model != Model::StableNeoHookean {
                assert!(lowest[0] < -1e-3, "the test state is indefinite, so the filter had something to do");
            }
        }
    }
}
