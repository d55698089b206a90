//! dev
#[path = "soft_cases/recorded.rs"]
mod recorded;
use animimic::scene::io::npz;
use animimic::sim::{Elasticity, Model};
use animimic_fit::soft::estimate::{Positions, Problem};
use animimic_fit::soft::{Settings, Tissue, clusters};
fn main() {
    let folder = recorded::cases().unwrap();
    let sub: usize = std::env::args().nth(1).map_or(1, |v| v.parse().unwrap());
    let tets: usize = std::env::args().nth(2).map_or(1000, |v| v.parse().unwrap());
    for name in ["fox_fem_tail", "fox_sb_tail"] {
        let (asset, motion) = recorded::recorded(&folder.join(name));
        let truth = animimic::truth::read(&folder.join(name)).unwrap();
        let soft = npz::read(folder.join(name).join("soft.npz")).unwrap();
        let softness = soft.need("softness").unwrap().to_f64();
        let weights: Vec<f64> = softness.iter().map(|s| f64::from(u8::from(*s > 0.01))).collect();
        let d = asset.mesh.diagonal();
        let rms = |f: &dyn Fn(usize) -> Vec<glam::DVec3>| {
            let mut s = 0.0;
            let mut n = 0.0;
            for t in 0..truth.vertices.len() {
                for (v, x) in f(t).iter().enumerate() {
                    if weights[v] > 0.0 { s += x.distance_squared(truth.vertices[t][v]); n += 1.0; }
                }
            }
            100.0 * (s / n as f64).sqrt() / d
        };
        let skin = rms(&|t| asset.rig.skinned(&asset.rig.skeleton.world_from_joint(&motion.poses[t].locals)));
        println!("{name}: skinning {skin:.3} % over {} soft vertices", weights.iter().sum::<f64>());
        let joint = |n: &str| asset.rig.skeleton.joints.iter().position(|j| j.name.starts_with(n)).unwrap();
        let tail = ["b_Tail01", "b_Tail02", "b_Tail03"].map(joint);
        for loose in [tail[1..].to_vec(), tail.to_vec()] {
            let tissue = Tissue::new(&asset, &Settings { loose: loose.clone(), tets, ..Settings::default() }).unwrap();
            let mut cluster = clusters::by_joint(&tissue, &tail);
            cluster.iter_mut().for_each(|c| *c = [0, 1, 1, 2][*c as usize]);
            let prior = Elasticity { cluster, ln_youngs: vec![1e5f64.ln(); 3], ..Elasticity::uniform(Model::GuardedCorotated, 0, 1e5, 0.4, 1000.0) };
            let evidence = Positions { frames: &truth.vertices, weights: &weights };
            let problem = Problem { tissue: &tissue, poses: &motion.poses, fps: motion.fps, evidence: &evidence, substeps: sub, prior_deviation: 2.3 };
            let clock = std::time::Instant::now();
            let e = problem.fit(&prior, 10).unwrap();
            let youngs: Vec<f64> = e.elasticity.ln_youngs.iter().map(|l| l.exp()).collect();
            println!("  loose {}: rms {:?} ({:.0} % of skinning) E {youngs:.0?} dev {:.2?} damping {:.1} {:.1} s", loose.len(), e.rms.iter().map(|r| 100.0 * r * 3f64.sqrt() / d).collect::<Vec<_>>(), 100.0 * e.rms.last().unwrap() * 3f64.sqrt() / d * 100.0 / skin, e.deviations, e.mass_damping, clock.elapsed().as_secs_f64());
        }
    }
}
