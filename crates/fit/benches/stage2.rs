//! Stage 2 alone: 49 frames, 3 000 tets, forward, and sixteen moduli fitted to what is seen of the surface.
//!
//! `cargo bench -p animimic-fit --bench stage2`. A creature made by code is shaken; its arms and body have moduli of their own. Two threads;
//! seconds of CPU of both together.

mod support;

use animimic_fit::soft::estimate::{Clip, Problem};
use animimic_fit::soft::evidence::Positions;
use animimic_fit::soft::fixtures::{ARM_JOINTS, shaken, three_arms};
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_sim::{Elasticity, Model};
use glam::DVec3;
use std::time::Instant;
use support::cpu_seconds;

const THREADS: usize = 2;
const TETS: usize = 3000;
const FRAMES: usize = 49;
const FPS: f64 = 24.0;
const CLUSTERS: usize = 16;
const STEPS: usize = 6;

fn main() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("a pool");
    pool.install(run);
}

fn run() {
    let asset = three_arms();
    let settings = Settings { tets: TETS, loose: ARM_JOINTS.to_vec(), ..Settings::default() };
    let tissue = Tissue::new(&asset, &settings).expect("a closed surface");
    let motion = shaken(&asset, FRAMES, FPS);
    let mut truth = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), 1e5, 0.4, 1000.0);
    truth.cluster = clusters(&tissue);
    truth.ln_youngs = (0..CLUSTERS).map(|c| 1e5f64.ln() + (1.7 * c as f64).sin()).collect();
    let (cpu, wall) = (cpu_seconds(), Instant::now());
    let simulated = tissue.simulate(&truth, &Stepping::default(), &motion.poses, FPS).expect("a sound material");
    println!(
        "{} tets, {FRAMES} frames forward: wall {:.2} s, CPU {:.2} s, {} Newton iterations",
        tissue.body.tets.len(),
        wall.elapsed().as_secs_f64(),
        cpu_seconds() - cpu,
        simulated.report.newton
    );
    let seen = simulated.surfaces(&tissue, &motion.poses);
    let evidence = Positions { frames: &seen, weights: &vec![1.0; asset.mesh.positions.len()] };
    let problem = Problem {
        tissue: &tissue,
        clips: &[Clip { poses: &motion.poses, fps: FPS, evidence: &evidence }],
        substeps: 1,
        prior_deviations: &[2.3; CLUSTERS],
        groups: None,
        damping: false,
        pictures: false,
    };
    let prior = Elasticity { ln_youngs: vec![1e5f64.ln(); CLUSTERS], ..truth.clone() };
    let (cpu, wall) = (cpu_seconds(), Instant::now());
    let found = problem.fit(&prior, None, STEPS).expect("there is evidence");
    let off = found.elasticity.ln_youngs.iter().zip(&truth.ln_youngs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    println!(
        "{CLUSTERS} moduli, {} steps: wall {:.1} s, CPU {:.1} s; ln E off by {off:.3} at most",
        found.energies.len() - 1,
        wall.elapsed().as_secs_f64(),
        cpu_seconds() - cpu
    );
}

/// Slices of the body along its longest axis, as many tets in each.
fn clusters(tissue: &Tissue) -> Vec<u32> {
    let center = |t: &[u32; 4]| t.iter().map(|&v| tissue.body.rest[v as usize]).sum::<DVec3>().element_sum();
    let mut order: Vec<usize> = (0..tissue.body.tets.len()).collect();
    order.sort_by(|&a, &b| center(&tissue.body.tets[a]).total_cmp(&center(&tissue.body.tets[b])).then(a.cmp(&b)));
    let mut out = vec![0; order.len()];
    order.iter().enumerate().for_each(|(k, &t)| out[t] = (k * CLUSTERS / order.len()) as u32);
    out
}
