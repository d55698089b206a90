//! Soft tissue on the true joint motion of every case of the test data.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

#[path = "../examples/soft_cases/recorded.rs"]
mod recorded;

use animimic::scene::io::npz;
use animimic::scene::{Asset, Motion, Refined, TetMesh, Trajectory};
use animimic::sim::{Body, Elasticity, Model, Settings as StepSettings, State, gauss_newton};
use animimic::soften::yielding::give_way;
use animimic_fit::soft::clusters::by_joint;
use animimic_fit::soft::estimate::{Clip, Problem};
use animimic_fit::soft::evidence::Positions;
use animimic_fit::soft::learn::skinned;
use animimic_fit::soft::{Settings, Simulated, Stepping, Tissue, loosen};
use animimic_rig::helpers;
use glam::{DMat3, DVec3};

fn elasticity(tissue: &Tissue, youngs: f64) -> Elasticity {
    Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), youngs, 0.4, 1000.0)
}

fn simulate(tissue: &Tissue, motion: &Motion, youngs: f64) -> Simulated {
    tissue.simulate(&elasticity(tissue, youngs), &Stepping::default(), &motion.poses, motion.fps).unwrap()
}

/// Calls `work` with every case, or says that there are none.
fn each_case(work: impl Fn(&str, &Asset, &Motion)) {
    let Some(folder) = recorded::cases() else { return println!("skipped: ../shared/data/gt is absent") };
    for name in recorded::names(&folder) {
        let (asset, motion) = recorded::recorded(&folder.join(&name));
        work(&name, &asset, &motion);
    }
}

#[test]
fn every_case_keeps_its_tets_upright_and_its_volume_and_cuts_itself_no_more_than_skinning() {
    each_case(|name, asset, motion| {
        let tissue = Tissue::new(asset, &Settings::default()).unwrap();
        let simulated = simulate(&tissue, motion, 1e5);
        let skinned = skinned(asset, &motion.poses);
        let mut soft = simulated.surfaces(&tissue, &motion.poses);
        let still = soft[0].iter().zip(&asset.mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        let still = still / asset.mesh.diagonal();
        let yielded = give_way(&asset.mesh, &skinned, &mut soft);
        let r = &simulated.report;
        println!(
            "{name}: inverted {}, missed {}, {} steps a frame, volume {:.3}, rest {still:.1e}, crossing pairs {} of skinning, {} -> {} soft, {:.2} yielded",
            r.inverted,
            r.unconverged.len(),
            r.substeps,
            r.volume_change,
            yielded.skinned_pairs,
            yielded.soft_pairs,
            yielded.pairs,
            yielded.share
        );
        assert_eq!((r.inverted, r.unconverged.len()), (0, 0), "{name}");
        assert!(r.volume_change < 0.05, "{name}");
        assert!(yielded.pairs <= yielded.skinned_pairs, "{name}");
        // Where the recorded first pose is the file's own, as far as the file stores it.
        assert!(still < 1e-4, "{name}");
    });
}

#[test]
fn at_rest_the_surface_is_the_rest_surface() {
    each_case(|name, asset, _| {
        let tissue = Tissue::new(asset, &Settings { tets: 500, ..Settings::default() }).unwrap();
        let pose = animimic::scene::Pose { locals: asset.rig.skeleton.rest_locals() };
        let still = Motion { name: "still".into(), fps: 24.0, poses: vec![pose.clone(); 3] };
        let simulated = simulate(&tissue, &still, 1e4);
        let world = tissue.world(&pose);
        let moved = simulated.frames().map(|cage| {
            let surface = tissue.surface(cage, &world);
            surface.iter().zip(&asset.mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
        });
        let worst = moved.fold(0.0, f64::max) / asset.mesh.diagonal();
        println!("{name}: {worst:.1e} of the diagonal");
        assert!(worst < 1e-9, "{name}");
    });
}

/// A point of the cage by its tet and barycentric coordinates.
type Point = ([u32; 4], [f64; 4]);

/// The tet around a point in which a joint has most of the weight.
fn place(tissue: &Tissue, joint: usize, p: DVec3) -> Option<Point> {
    tissue.cage.mesh.tets.iter().find_map(|tet| {
        let x = tet.map(|v| tissue.cage.mesh.positions[v as usize]);
        let m = DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]).inverse() * (p - x[0]);
        let b = [1.0 - m.element_sum(), m.x, m.y, m.z];
        let own: f64 = tet.iter().zip(b).map(|(&v, b)| tissue.weights.rows[v as usize][joint] * b).sum();
        (b.iter().all(|v| *v > -1e-9) && own > 0.5).then_some((*tet, b))
    })
}

#[test]
fn with_stiff_flesh_bones_are_where_skinning_has_them() {
    each_case(|name, asset, motion| {
        let tissue = Tissue::new(asset, &Settings::default()).unwrap();
        let stiff = elasticity(&tissue, 1e8);
        let tissue = tissue.holding(&stiff);
        let simulated = simulate(&tissue, motion, 1e8);
        let mut squares = Vec::new();
        for bone in &tissue.bones {
            for share in [0.4, 0.5, 0.6] {
                let p = bone.ends[0].lerp(bone.ends[1], share);
                let Some((tet, b)) = place(&tissue, bone.joint, p) else { continue };
                for (pose, cage) in motion.poses.iter().zip(simulated.frames()) {
                    let t = tissue.displacements(&tissue.world(pose))[tissue.weights.joints[bone.joint]];
                    let there: DVec3 = tet.iter().zip(b).map(|(&v, b)| cage[v as usize] * b / tissue.scale).sum();
                    squares.push(there.distance_squared(t.transform_point3(p)));
                }
            }
        }
        squares.sort_by(f64::total_cmp);
        let percent = |s: f64| 100.0 * s.sqrt() / asset.mesh.diagonal();
        let rms = percent(squares.iter().sum::<f64>() / squares.len().max(1) as f64);
        let p95 = percent(squares[squares.len() * 95 / 100]);
        let worst = percent(squares[squares.len() - 1]);
        println!("{name}: bones off by {rms:.3} % of the diagonal rms, p95 {p95:.3} %, worst {worst:.2} %");
        assert_eq!((simulated.report.inverted, simulated.report.unconverged.len()), (0, 0), "{name}");
        // Worst of all is where two bones come nearer than flesh between them can follow.
        assert!(rms < 0.3 && p95 < 0.5, "{name}");
    });
}

#[test]
fn helper_bones_carry_every_softened_case_within_half_a_percent() {
    each_case(|name, asset, motion| {
        let tissue = Tissue::new(asset, &Settings::default()).unwrap();
        let simulated = simulate(&tissue, motion, 1e5);
        let skinned = skinned(asset, &motion.poses);
        let mut soft = simulated.surfaces(&tissue, &motion.poses);
        give_way(&asset.mesh, &skinned, &mut soft);
        let trajectory = Some(Trajectory { fps: motion.fps, frames: soft });
        let clip = Refined { motion: motion.clone(), trajectory };
        let helped = helpers::fit(&asset.rig, &asset.mesh, &[clip], &helpers::Settings::default()).unwrap();
        let percent = |share: f64| 100.0 * share;
        println!(
            "{name}: {} helpers, p99 {:.3} % of the diagonal, skinned {:.3} %",
            helped.helpers,
            percent(helped.residual.p99),
            percent(helped.skinned.p99)
        );
        assert!(helped.residual.p99 <= 0.005 && helped.helpers <= 32, "{name}");
        assert!(helped.rig.skin.influences.iter().all(|i| i.len() <= 4), "{name}");
    });
}

/// Root mean square distance from the truth over the soft region [% of the rest diagonal].
fn rms(truth: &[Vec<DVec3>], weights: &[f64], diagonal: f64, frame: impl Fn(usize) -> Vec<DVec3>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (t, truth) in truth.iter().enumerate() {
        for ((x, y), w) in frame(t).iter().zip(truth).zip(weights) {
            sum += w * x.distance_squared(*y);
            count += w;
        }
    }
    100.0 * (sum / count).sqrt() / diagonal
}

#[test]
fn stiffness_fitted_to_true_vertices_brings_the_soft_tails_back() {
    let Some(folder) = recorded::cases() else { return println!("skipped: ../shared/data/gt is absent") };
    for name in ["fox_fem_tail", "fox_sb_tail"] {
        let (asset, motion) = recorded::recorded(&folder.join(name));
        let truth = animimic::truth::read(&folder.join(name)).unwrap().vertices;
        let softness = npz::read(folder.join(name).join("soft.npz")).unwrap().need("softness").unwrap().to_f64();
        let weights: Vec<f64> = softness.iter().map(|s| f64::from(u8::from(*s > 0.01))).collect();
        let diagonal = asset.mesh.diagonal();
        let skinned = |t: usize| asset.rig.in_pose(&motion.poses[t]);
        let before = rms(&truth, &weights, diagonal, skinned);
        let joint = |n: &str| asset.rig.skeleton.joints.iter().position(|j| j.name.starts_with(n)).unwrap();
        let tail = ["b_Tail01", "b_Tail02", "b_Tail03"].map(joint);
        let all = vec![1.0; truth[0].len()];
        let evidence = Positions { frames: &truth, weights: &all };
        let clip = |evidence| [Clip { poses: &motion.poses, fps: motion.fps, evidence }];
        let clock = std::time::Instant::now();
        let loose = loosen::loose(&asset, &Settings::default(), &clip(&evidence), (0.4, 1000.0)).unwrap();
        println!(
            "{name}: loose {:?}, roots held {} in {:.1} s",
            loose.loose,
            loose.held_roots,
            clock.elapsed().as_secs_f64()
        );
        assert_eq!(loose.loose, tail, "{name}: the tail and nothing else is loose");
        let tissue = Tissue::new(&asset, &Settings { tets: 1600, ..loose }).unwrap();
        // The rest of the body, the first two thirds of the tail, its end: as the truth was made.
        let cluster = by_joint(&tissue, &tail).iter().map(|c| [0, 1, 1, 2][*c as usize]).collect();
        let prior =
            Elasticity { cluster, ln_youngs: [1e7f64, 1e5, 1e5].map(f64::ln).to_vec(), ..elasticity(&tissue, 1e5) };
        let evidence = Positions { frames: &truth, weights: &weights };
        let problem = Problem {
            tissue: &tissue,
            clips: &clip(&evidence),
            substeps: 2,
            prior_deviations: &[1e-3, 2.3, 2.3],
            groups: None,
            damping: true,
            pictures: false,
        };
        let found = problem.fit(&prior, None, 6).unwrap();
        let count: f64 = weights.iter().sum::<f64>() * truth.len() as f64;
        let after = (found.energies[found.energies.len() - 1] / count).sqrt() * 100.0 / diagonal;
        let youngs: Vec<f64> = found.elasticity.ln_youngs.iter().map(|l| l.exp()).collect();
        println!(
            "{name}: {before:.2} % -> {after:.2} % of the diagonal ({:.0} %), E {youngs:.0?} Pa, ln E ± {:.2?}, ratio of the tail's parts {:.2}, damping {:.2} /s",
            100.0 * after / before,
            found.deviations,
            youngs[1] / youngs[2],
            found.mass_damping
        );
        assert!(after < 0.6 * before, "{name}");
    }
}

#[test]
fn on_the_tets_of_the_truth_another_programs_moduli_come_back() {
    let Some(folder) = recorded::cases() else { return println!("skipped: ../shared/data/gt is absent") };
    let truth = npz::read(folder.join("fox_fem_tail/soft.npz")).unwrap();
    let numbers = |name: &str| truth.need(name).unwrap().to_f64();
    let scale = numbers("length_scale_m_per_unit")[0];
    let points = |name: &str| -> Vec<DVec3> {
        numbers(name).as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p) * scale).collect()
    };
    let (rest, moved, free) = (points("tet_verts_rest"), points("tet_verts"), numbers("vert_free"));
    let simulated = numbers("tet_simulated");
    let all: Vec<[u32; 4]> = numbers("tets").as_chunks::<4>().0.iter().map(|t| t.map(|v| v as u32)).collect();
    let kept: Vec<usize> = (0..all.len()).filter(|&t| simulated[t] > 0.0).collect();
    let mut used: Vec<u32> = kept.iter().flat_map(|&t| all[t]).collect();
    used.sort_unstable();
    used.dedup();
    let rank = |v: u32| used.binary_search(&v).unwrap() as u32;
    let mesh = TetMesh {
        positions: used.iter().map(|&v| rest[v as usize]).collect(),
        tets: kept.iter().map(|&t| all[t].map(rank)).collect(),
    };
    let driven: Vec<u32> = (0..used.len() as u32).filter(|&v| free[used[v as usize] as usize] == 0.0).collect();
    let frames: Vec<Vec<DVec3>> =
        moved.chunks(rest.len()).map(|frame| used.iter().map(|&v| frame[v as usize]).collect()).collect();
    let body = Body::new(&mesh, &driven).unwrap();
    let path: Vec<Vec<DVec3>> = frames[1..].iter().map(|x| driven.iter().map(|&v| x[v as usize]).collect()).collect();
    let youngs = numbers("tet_E");
    let one = Elasticity::uniform(Model::StableNeoHookean, mesh.tets.len(), 4e5, 0.4, 1000.0);
    let start = Elasticity {
        cluster: kept.iter().map(|&t| u32::from(youngs[t] < 4e5)).collect(),
        ln_youngs: vec![f64::ln(4e5); 2],
        ..one
    };
    let at_rest = State::at_rest(&frames[0]);
    // Backward Euler damps as stiffness-proportional damping of half a step does: the steps are small against that.
    let fitted = |stiffness_damping: f64| {
        let frame_time = 1.0 / 24.0;
        let settings =
            StepSettings { frame_time, substeps: 32, stiffness_damping, tolerance: 1e-4, ..StepSettings::default() };
        let (found, history) = gauss_newton(&body, &start, &settings, &at_rest, &path, &frames[1..], 20, 1e-3).unwrap();
        let youngs = [0, 1].map(|c: usize| found.ln_youngs[c].exp());
        let count = (path.len() * body.free.len()) as f64;
        let rms = 100.0 * (2.0 * history[history.len() - 1].loss / count).sqrt();
        println!(
            "damping {stiffness_damping} s: E {youngs:.0?} Pa, ratio {:.2}, off by {rms:.3} % of the diagonal",
            youngs[0] / youngs[1]
        );
        (rms, youngs)
    };
    let all = [0.0, 1e-4, 1e-3].map(fitted);
    let best = all.iter().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    assert!((best.1[0] / best.1[1] / 4.0).ln().abs() < f64::ln(1.5), "the ratio of the truth is 4");
    assert!((best.1[0] / 8e5).ln().abs() < f64::ln(1.5) && best.0 < 0.2);
}
