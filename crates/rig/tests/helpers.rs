//! Helper bones on animated models whose soft motion is known, and on the same models shaken by code.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use animimic_rig::helpers::{Settings, fit};
use animimic_rig::residual::Residual;
use animimic_scene::io::{self, npz};
use animimic_scene::{Asset, Motion, Pose, Refined, Trajectory, Transform};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The largest residual that an encoding with helpers may leave [share of the diagonal].
const GOAL: f64 = 0.005;
const FPS: f64 = 24.0;

fn cases() -> Vec<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/gt"));
    let Ok(entries) = std::fs::read_dir(folder) else {
        println!("skipped: no test data in {}", folder.display());
        return Vec::new();
    };
    let mut cases: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).filter(|p| p.join("gt.npz").is_file()).collect();
    cases.sort();
    cases
}

/// The rigged model, and its true joints with its true vertices.
fn truth(case: &Path) -> (Asset, Refined) {
    let asset = io::read(case.join("static.glb")).unwrap();
    let gt = npz::read(case.join("gt.npz")).unwrap();
    let array = |name: &str| gt.need(name).unwrap();
    let (unique, map) = (array("verts_unique"), array("vert_to_unique").to_f64());
    let points: Vec<DVec3> = unique.to_f64().chunks_exact(3).map(DVec3::from_slice).collect();
    let frames = points.chunks_exact(unique.shape[1]).map(|f| map.iter().map(|&i| f[i as usize]).collect()).collect();
    let nodes = array("joint_node").to_f64();
    let pose = |trs: &[f64]| {
        let mut locals = asset.rig.skeleton.rest_locals();
        for (node, t) in nodes.iter().zip(trs.chunks_exact(10)) {
            let joint = asset.rig.skeleton.joints.iter().position(|j| j.node == Some(*node as usize));
            let Some(joint) = joint else { continue };
            locals[joint] = Transform {
                translation: DVec3::from_slice(&t[..3]),
                rotation: DQuat::from_slice(&t[3..7]).normalize(),
                scale: DVec3::from_slice(&t[7..]),
            };
        }
        Pose { locals }
    };
    let poses = array("joint_local_trs").to_f64().chunks_exact(nodes.len() * 10).map(pose).collect();
    let motion = Motion { name: "truth".into(), fps: FPS, poses };
    (asset, Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames }) })
}

fn skinned(asset: &Asset, motion: &Motion) -> Vec<Vec<DVec3>> {
    motion.poses.iter().map(|p| asset.rig.in_pose(p)).collect()
}

fn frames(clip: &Refined) -> &[Vec<DVec3>] {
    &clip.trajectory.as_ref().unwrap().frames
}

fn percent(r: &Residual) -> String {
    format!("rms {:.3} p99 {:.3} max {:.3}", 100.0 * r.rms, 100.0 * r.p99, 100.0 * r.largest)
}

/// Distances of the vertices that skinning leaves behind only.
fn of_soft(asset: &Asset, clip: &Refined, rig: &animimic_scene::Rig, motion: &Motion) -> Residual {
    let diagonal = asset.mesh.diagonal();
    let base = skinned(asset, &clip.motion);
    let soft: Vec<usize> = (0..asset.mesh.positions.len())
        .filter(|&v| base.iter().zip(frames(clip)).any(|(a, b)| a[v].distance(b[v]) > 2e-4 * diagonal))
        .collect();
    let mut distances = Vec::new();
    for (pose, frame) in motion.poses.iter().zip(frames(clip)) {
        let posed = rig.in_pose(pose);
        distances.extend(soft.iter().map(|&v| posed[v].distance(frame[v])));
    }
    Residual::of_distances(distances, diagonal)
}

fn report(name: &str, asset: &Asset, clip: &Refined) -> (f64, usize) {
    let start = Instant::now();
    let out = fit(&asset.rig, &asset.mesh, std::slice::from_ref(clip), &Settings::default()).unwrap();
    let secs = start.elapsed().as_secs_f64();
    let soft = of_soft(asset, clip, &out.rig, &out.motions[0]);
    println!(
        "{name}: {} helpers, skinned {}, with helpers {}; soft vertices {}; rest {:.1e}; {secs:.2} s",
        out.helpers,
        percent(&out.skinned),
        percent(&out.residual),
        percent(&soft),
        out.rest
    );
    for (given, kept) in clip.motion.poses.iter().zip(&out.motions[0].poses) {
        assert_eq!(given.locals[..], kept.locals[..given.locals.len()], "the given keys are kept");
    }
    assert!(
        out.rig
            .skin
            .influences
            .iter()
            .all(|l| l.len() <= 4 && (l.iter().map(|i| i.weight).sum::<f64>() - 1.0).abs() < 1e-9)
    );
    (soft.p99, out.helpers)
}

#[test]
fn soft_tails_of_the_true_cases_are_carried_by_helpers_within_half_a_percent() {
    for case in cases() {
        let (asset, clip) = truth(&case);
        let (p99, helpers) = report(&case.file_name().unwrap().to_string_lossy(), &asset, &clip);
        assert!(p99 <= GOAL && helpers <= 32);
        let soft = case.join("soft.npz").is_file();
        assert_eq!(helpers > 0, soft, "helpers only where skinning is not the truth");
    }
}

/// Every vertex on a damped spring of its own, looser away from the joints: x″ + 2ζω x′ + ω² x = −softness · acceleration.
fn shaken(asset: &Asset, clip: &Refined) -> Refined {
    let mut motion = clip.motion.clone();
    let diagonal = asset.mesh.diagonal();
    let world = asset.rig.skeleton.rest_world();
    let softness: Vec<f64> = asset
        .mesh
        .positions
        .iter()
        .map(|p| {
            let near = world.iter().map(|w| w.translation.distance(*p)).fold(f64::MAX, f64::min);
            (near / (0.12 * diagonal)).min(1.0).powi(2)
        })
        .collect();
    let base = skinned(asset, &motion);
    let (dt, omega, zeta) = (1.0 / FPS, 2.0 * std::f64::consts::PI * 3.0, 0.15);
    let n = base[0].len();
    let (mut x, mut v) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
    let mut frames = vec![base[0].clone()];
    for f in 1..base.len() {
        let before = &base[f.saturating_sub(2)];
        for i in 0..n {
            let a = (base[f][i] - base[f - 1][i] * 2.0 + before[i]) / (dt * dt);
            for _ in 0..8 {
                let force = -a * softness[i] - x[i] * (omega * omega) - v[i] * (2.0 * zeta * omega);
                v[i] += force * (dt / 8.0);
                x[i] += v[i] * (dt / 8.0);
            }
        }
        frames.push(base[f].iter().zip(&x).map(|(b, x)| *b + *x).collect());
    }
    motion.name = "shaken".into();
    Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames }) }
}

#[test]
fn every_creature_shaken_all_over_is_carried_within_half_a_percent() {
    for case in cases() {
        let (asset, clip) = truth(&case);
        let (p99, helpers) = report(&case.file_name().unwrap().to_string_lossy(), &asset, &shaken(&asset, &clip));
        assert!(p99 <= GOAL && helpers <= 32);
    }
}

/// A snake of `vertices` in a wave, its flesh swinging about the skin in waves of its own.
fn dense(vertices: usize, frames: usize) -> (Asset, Refined) {
    let around = ((vertices as f64).sqrt() / 2.0) as usize;
    let rings = vertices / around;
    let mut asset = Asset::default();
    let joints = 12usize;
    for j in 0..joints {
        let translation = if j == 0 { DVec3::ZERO } else { DVec3::X };
        asset.rig.skeleton.joints.push(animimic_scene::Joint {
            name: format!("j{j}"),
            parent: j.checked_sub(1),
            rest: Transform { translation, ..Transform::IDENTITY },
            node: None,
        });
        let inverse_bind = glam::DAffine3::from_translation(-DVec3::X * j as f64);
        asset.rig.skin.slots.push(animimic_scene::Slot { joint: j, inverse_bind });
    }
    for r in 0..rings {
        for a in 0..around {
            let (x, angle) = (11.0 * r as f64 / (rings - 1) as f64, a as f64 / around as f64 * std::f64::consts::TAU);
            asset.mesh.positions.push(DVec3::new(x, angle.cos(), angle.sin()));
            let j = (x as usize).min(joints - 2);
            let u = x - j as f64;
            let pair = [(j, 1.0 - u), (j + 1, u)];
            let list = pair.map(|(j, weight)| animimic_scene::Influence { slot: j as u32, weight });
            asset.rig.skin.influences.push(list.into_iter().filter(|i| i.weight > 0.0).collect());
        }
    }
    let n = asset.mesh.positions.len();
    asset.rig.skin.bind_positions = asset.mesh.positions.clone();
    asset.mesh.welded = (0..n as u32).collect();
    asset.mesh.welded_count = n;
    asset.mesh.parts = vec![animimic_scene::Part { vertices: 0..n, ..Default::default() }];
    let pose = |f: usize| {
        let mut locals = asset.rig.skeleton.rest_locals();
        for (j, local) in locals.iter_mut().enumerate() {
            local.rotation =
                DQuat::from_rotation_z(0.15 * (0.4 * f as f64 + 0.7 * j as f64).sin() * (f.min(10) as f64) / 10.0);
        }
        Pose { locals }
    };
    let motion = Motion { name: "wave".into(), fps: FPS, poses: (0..frames).map(pose).collect() };
    let mut posed = skinned(&asset, &motion);
    for (f, frame) in posed.iter_mut().enumerate().skip(1) {
        for (p, x) in frame.iter_mut().zip(&asset.mesh.positions) {
            let t = f as f64;
            let swing = |k: f64, s: f64| 0.35 * (k * x.x + s * t).sin() * (t.min(10.0) / 10.0);
            *p += DVec3::new(swing(1.7, 0.5) * x.y, swing(2.3, 0.8) * (1.0 + x.z), swing(1.1, 0.9) * (1.0 + x.y));
        }
    }
    (asset, Refined { motion, trajectory: Some(Trajectory { fps: FPS, frames: posed }) })
}

#[test]
fn sixteen_thousand_vertices_take_seconds_and_dense_meshes_no_more_than_half_a_minute() {
    for (vertices, secs) in [(16_000, 15.0), (150_000, 60.0)] {
        let (asset, clip) = dense(vertices, 48);
        let start = Instant::now();
        let (_, helpers) = report(&format!("{} vertices", asset.mesh.positions.len()), &asset, &clip);
        let taken = start.elapsed().as_secs_f64();
        println!("{helpers} helpers in {taken:.1} s");
        // Twice and more what a quiet machine with two cores takes.
        assert!(taken < secs);
    }
}

#[test]
fn two_clips_share_one_set_of_weights_and_any_number_of_threads_gives_the_same_bytes() {
    let (asset, clip) = dense(600, 24);
    let half = |range: std::ops::Range<usize>| Refined {
        motion: Motion { poses: clip.motion.poses[range.clone()].to_vec(), ..clip.motion.clone() },
        trajectory: Some(Trajectory { fps: FPS, frames: frames(&clip)[range].to_vec() }),
    };
    let clips = [half(0..10), half(10..24)];
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fit(&asset.rig, &asset.mesh, &clips, &Settings { most: 6, goal: 1e-4 }).unwrap())
    };
    let (one, three) = (run(1), run(3));
    println!("{} helpers, {} to {}", one.helpers, percent(&one.skinned), percent(&one.residual));
    assert_eq!((one.helpers, one.motions.len(), one.motions[1].poses.len()), (6, 2, 14));
    assert!(one.residual.rms < 0.4 * one.skinned.rms);
    assert_eq!(one.rig.skin.influences, three.rig.skin.influences);
    for (a, b) in one.motions.iter().zip(&three.motions) {
        assert_eq!(a.poses, b.poses);
    }
}

#[test]
fn eight_influences_become_the_best_four_where_a_helper_moves_the_part_and_stay_elsewhere() {
    let (mut asset, mut clip) = dense(600, 12);
    let n = asset.mesh.positions.len();
    for list in &mut asset.rig.skin.influences {
        let first = list[0].slot;
        list.iter_mut().for_each(|i| i.weight *= 0.4);
        list.extend((1..=6).map(|k| animimic_scene::Influence { slot: (first + 2 + k) % 12, weight: 0.1 }));
        let sum: f64 = list.iter().map(|i| i.weight).sum();
        list.iter_mut().for_each(|i| i.weight /= sum);
    }
    // Two parts; only the second is soft.
    let part = |range| animimic_scene::Part { vertices: range, ..Default::default() };
    asset.mesh.parts = vec![part(0..n / 2), part(n / 2..n)];
    let base = skinned(&asset, &clip.motion);
    for (frame, base) in clip.trajectory.as_mut().unwrap().frames.iter_mut().zip(&base) {
        frame[..n / 2].copy_from_slice(&base[..n / 2]);
    }
    let out = fit(&asset.rig, &asset.mesh, &[clip], &Settings::default()).unwrap();
    println!("{} helpers, {} to {}", out.helpers, percent(&out.skinned), percent(&out.residual));
    assert!(out.helpers > 0);
    assert_eq!(out.rig.skin.influences[..n / 2], asset.rig.skin.influences[..n / 2]);
    assert!(out.rig.skin.influences[n / 2..].iter().all(|l| l.len() <= 4));
}

#[test]
fn trajectories_that_do_not_belong_to_the_mesh_are_refused_in_words() {
    let (asset, clip) = dense(600, 4);
    let wrong = |change: &dyn Fn(&mut Refined)| {
        let mut clip = clip.clone();
        change(&mut clip);
        fit(&asset.rig, &asset.mesh, &[clip], &Settings::default()).unwrap_err().to_string()
    };
    let told = [
        wrong(&|c| c.trajectory.as_mut().unwrap().frames.truncate(3)),
        wrong(&|c| c.trajectory.as_mut().unwrap().frames[1].truncate(9)),
        wrong(&|c| c.motion.poses[2].locals.truncate(11)),
        wrong(&|c| c.trajectory.as_mut().unwrap().frames[3][7].x = f64::NAN),
    ];
    println!("{told:?}");
    assert!(told[0].contains("4 poses and 3 frames") && told[1].contains("vertices"));
    assert!(told[2].contains("11 joints") && told[3].contains("frame 3 is not finite"));
}
