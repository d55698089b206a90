//! temporary
use animimic_fit::{robust::Robust, solver::*, terms::*};
use animimic_rig::{anchor::Share, smoothness::pseudo_anchors, *};
use glam::*;
fn main() {
    let b = std::fs::read("/tmp/jp/p.bin").unwrap();
    let d: Vec<f64> = b.chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect();
    let mut at = 0;
    let mut take = |n: usize| {
        let s = d[at..at + n].to_vec();
        at += n;
        s
    };
    let v3 = |s: &[f64]| -> Vec<DVec3> { s.chunks_exact(3).map(DVec3::from_slice).collect() };
    let (f, n, j, v) = (48, 300, 30, 1020);
    let av = v3(&take(n * 3));
    let aw = take(n * j);
    let tracks = take(f * n * 2);
    let vis = take(f * n);
    let depth = take(f * n);
    let truth = v3(&take(f * v * 3));
    let verts = v3(&take(v * 3));
    let si = take(v * 4);
    let sw = take(v * 4);
    let joints = v3(&take(j * 3));
    let parents = take(j);
    let r = take(9);
    let t = take(3);
    let fo = take(1)[0];
    let kin = Kinematics::new(
        parents.iter().map(|&p| (p >= 0.0).then_some(p as usize)).collect(),
        joints,
        vec![true; j],
        (0..j).map(|i| i == 0).collect(),
    );
    let mut anchors: Vec<Anchor> = (0..n)
        .map(|i| Anchor {
            shares: (0..j)
                .filter(|&k| aw[i * j + k] > 0.0)
                .map(|k| Share { joint: k, weight: aw[i * j + k], weighted_rest: av[i] * aw[i * j + k] })
                .collect(),
        })
        .collect();
    let va: Vec<Anchor> = (0..v)
        .map(|i| {
            let mut s: Vec<Share> = (0..4)
                .filter(|&k| sw[i * 4 + k] > 0.0)
                .map(|k| Share {
                    joint: si[i * 4 + k] as usize,
                    weight: sw[i * 4 + k],
                    weighted_rest: verts[i] * sw[i * 4 + k],
                })
                .collect();
            s.sort_by_key(|s| s.joint);
            Anchor { shares: s }
        })
        .collect();
    let columns: Vec<AnchorColumns> = anchors.iter().map(|a| a.columns(&kin)).collect();
    let rot = DMat3::from_cols_slice(&r).transpose();
    let cam = animimic_scene::Camera {
        width: 512,
        height: 512,
        fx: fo * 512.0,
        fy: fo * 512.0,
        cx: 256.0,
        cy: 256.0,
        view_from_world: DAffine3::from_mat3_translation(rot, DVec3::from_slice(&t)),
    };
    let c0 = std::time::Instant::now();
    let ps = pseudo_anchors(&va, j);
    println!("rank {} in {:?}", ps.len(), c0.elapsed());
    let smooth = Smoothness {
        columns: ps.iter().map(|a| a.columns(&kin)).collect(),
        anchors: ps,
        velocity: 2e2,
        acceleration: 2e3,
        basis: DVec3::AXES,
    };
    let pix = Pixels {
        targets: (0..f)
            .map(|t| {
                (0..n)
                    .filter(|&i| vis[t * n + i] > 0.0)
                    .map(|i| PixelTarget {
                        anchor: i as u32,
                        pixel: DVec2::new(tracks[(t * n + i) * 2], tracks[(t * n + i) * 2 + 1]),
                        weight: vis[t * n + i],
                        normal: None,
                    })
                    .collect()
            })
            .collect(),
        robust: Robust::Huber(2.0),
        weight: 1.0,
    };
    let dep = Depth {
        targets: (0..f)
            .map(|t| {
                (0..n)
                    .filter(|&i| vis[t * n + i] > 0.0)
                    .map(|i| DepthTarget { anchor: i as u32, depth: depth[t * n + i], weight: vis[t * n + i] })
                    .collect()
            })
            .collect(),
        sigma: 0.004,
        robust: Robust::Squared,
        weight: 1.0,
        affine: true,
    };
    let mut prior = vec![JointPrior { stiffness: 2.0, limit_rad: 1.2, limit_stiffness: 1e2, ..JointPrior::FREE }; j];
    prior[0] = JointPrior::FREE;
    let prior = JointPriors { joints: vec![prior] };
    let problem = Problem {
        context: Context { kinematics: &kin, camera: &cam, anchors: &anchors, columns: &columns },
        terms: vec![&pix, &dep, &prior],
        smoothness: Some(&smooth),
    };
    let mut poses = vec![kin.rest(); f];
    let report = solve(&problem, &mut poses, 0..f, &Options::default());
    println!("{:?} {:?}", c0.elapsed(), report.energies);
    let err: f64 = poses
        .iter()
        .enumerate()
        .map(|(t, p)| {
            let q = kin.pose(p);
            va.iter().enumerate().map(|(i, a)| a.position(&q).distance(truth[t * v + i])).sum::<f64>()
        })
        .sum::<f64>()
        / (f * v) as f64;
    println!("err mm {}", err * 1e3);
    let _ = &mut anchors;
}
