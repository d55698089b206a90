//! Soft tissue on the true joint motion of every case: what the simulation keeps, and what it costs.
//! `cargo run --release -p animimic --example soft_cases [CASE…]`

mod recorded;

use animimic::sim::{Elasticity, Model};
use animimic_fit::soft::{Stepping, Settings, Tissue};
use std::time::Instant;

fn main() {
    let Some(folder) = recorded::cases() else { return println!("the test data is absent") };
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let youngs: f64 = std::env::var("YOUNG").ok().and_then(|v| v.parse().ok()).unwrap_or(1e5);
    for name in recorded::names(&folder).iter().filter(|n| wanted.is_empty() || wanted.contains(n)) {
        let (asset, motion) = recorded::recorded(&folder.join(name));
        let clock = Instant::now();
        let tissue = Tissue::new(&asset, &Settings::default()).unwrap();
        let built = clock.elapsed().as_secs_f64();
        let elasticity = Elasticity::uniform(Model::GuardedCorotated, tissue.body.tets.len(), youngs, 0.4, 1000.0);
        let clock = Instant::now();
        let simulated = tissue.simulate(&elasticity, &Stepping::default(), &motion.poses, motion.fps).unwrap();
        let spent = clock.elapsed().as_secs_f64();
        let posed = |pose| tissue.world(pose);
        let skinned: Vec<_> = motion.poses.iter().map(|p| asset.rig.skinned(&posed(p))).collect();
        let mut soft: Vec<_> = simulated.frames().zip(&motion.poses).map(|(c, p)| tissue.surface(c, &posed(p))).collect();
        let clock = Instant::now();
        let yielded = animimic::soften::yielding::give_way(&asset.mesh, &skinned, &mut soft);
        let gave = clock.elapsed().as_secs_f64();
        if let Ok(out) = std::env::var("OUT") {
            sheet(&tissue, &motion.poses, &simulated, &folder.join(name), &format!("{out}/{name}_{youngs:.0e}.png"));
        }
        let d = asset.mesh.diagonal();
        let away: Vec<f64> = motion.poses.iter().zip(simulated.frames()).flat_map(|(pose, cage)| {
            let world = tissue.world(pose);
            let (skin, soft) = (asset.rig.skinned(&world), tissue.surface(cage, &world));
            skin.iter().zip(soft).map(|(a, b)| 100.0 * a.distance(b) / d).collect::<Vec<_>>()
        }).collect();
        let mut sorted = away.clone();
        sorted.sort_by(f64::total_cmp);
        let q = |p: f64| sorted[((sorted.len() - 1) as f64 * p) as usize];
        println!("    from skinning [% diagonal]: median {:.2} p90 {:.2} p99 {:.2} max {:.2}", q(0.5), q(0.9), q(0.99), q(1.0));
        if std::env::var("BONES").is_ok() {
            for (b, bone) in tissue.bones.iter().enumerate() {
                let joint = tissue.weights.joints[bone.joint];
                let driven = tissue.holds.iter().filter(|h| h.joint as usize == bone.joint).count();
                let mut worst = 0.0f64;
                let mut found = 0;
                for s in [0.4, 0.5, 0.6] {
                    let p = bone.ends[0].lerp(bone.ends[1], s);
                    let place = tissue.cage.mesh.tets.iter().find_map(|tet| {
                        let x = tet.map(|v| tissue.cage.mesh.positions[v as usize]);
                        let m = glam::DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]).inverse() * (p - x[0]);
                        let b = [1.0 - m.element_sum(), m.x, m.y, m.z];
                        let own = tet.iter().zip(b).map(|(&v, b)| tissue.weights.rows[v as usize][bone.joint] * b).sum::<f64>();
                        (b.iter().all(|v| *v > -1e-9) && own > 0.5).then_some((*tet, b))
                    });
                    let Some((tet, c)) = place else { continue };
                    found += 1;
                    for (pose, cage) in motion.poses.iter().zip(simulated.frames()) {
                        let t = tissue.displacements(&tissue.world(pose))[joint];
                        let there: glam::DVec3 = tet.iter().zip(c).map(|(&v, b)| cage[v as usize] * b / tissue.scale).sum();
                        worst = worst.max(100.0 * there.distance(t.transform_point3(p)) / d);
                    }
                }
                if worst > 0.25 { println!("   bone {b} of {} driven {driven} found {found} length {:.2} cells: worst {worst:.2} %", asset.rig.skeleton.joints[joint].name, bone.ends[0].distance(bone.ends[1]) / tissue.cage.spacing); }
            }
        }
        if std::env::var("WHERE").is_ok() {
            let mut shown = std::collections::BTreeMap::new();
            for (n, x) in simulated.simulation.steps.iter().enumerate() {
                for (t, tet) in tissue.body.tets.iter().enumerate() {
                    let [a, b, c, e] = tet.map(|v| x[v as usize]);
                    if (b - a).cross(c - a).dot(e - a) <= 0.0 { shown.entry(t).or_insert((n, 0)).1 += 1; }
                }
            }
            for (t, (n, count)) in shown {
                let names: Vec<String> = tissue.body.tets[t].iter().map(|&v| {
                    let d = tissue.driver[v as usize];
                    let (m, w) = tissue.weights.main(v as usize);
                    let name = &asset.rig.skeleton.joints[tissue.weights.joints[m]].name;
                    format!("{}{name}:{w:.2}", if d == u32::MAX { "" } else { "*" })
                }).collect();
                println!("   tet {t} first at step {n}, {count} steps: {names:?}");
            }
            println!("   unconverged {:?}", r_unconverged(&simulated));
        }
        let r = &simulated.report;
        println!(
            "{name:18} tets {:5} verts {:5} holds {:.0} built {built:.2} s, {} frames {spent:.2} s x{} newton {} inverted {} unconverged {} volume {:.3} {yielded:?} {gave:.1} s E {youngs:.0e}",
            tissue.body.tets.len(), tissue.body.rest.len(), tissue.holds.len() as f64, motion.poses.len(), r.substeps, r.newton, r.inverted, r.unconverged.len(), r.volume_change,
        );
    }
}

/// Six frames: skinning above, soft below.
fn sheet(tissue: &Tissue, poses: &[animimic::scene::Pose], simulated: &animimic_fit::soft::Simulated, case: &std::path::Path, out: &str) {
    let camera = animimic::scene::io::camera_json::read(case.join("camera.json")).unwrap().main.resized(400, 400);
    let studio = animimic::pictures::Studio::with_light(tissue.asset, Default::default()).unwrap();
    let frames: Vec<_> = simulated.frames().collect();
    let mut sheet = animimic::scene::Image::filled(2400, 800, [226, 228, 230]);
    for k in 0..6 {
        let t = k * (poses.len() - 1) / 5;
        let world = tissue.world(&poses[t]);
        for (row, x) in [tissue.asset.rig.skinned(&world), tissue.surface(frames[t], &world)].iter().enumerate() {
            let picture = studio.draw(&camera, x, [226, 228, 230]).0;
            animimic_render::overlay::paste(&mut sheet, &picture, 400 * k, 400 * row);
        }
    }
    animimic_video::write_png(std::path::Path::new(out), &sheet).unwrap();
}

fn r_unconverged(s: &animimic_fit::soft::Simulated) -> &Vec<(usize, f64)> { &s.report.unconverged }
