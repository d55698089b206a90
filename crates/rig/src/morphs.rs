//! Morph targets: refined motion as a few shapes that are added before the skin.
//!
//! With L_v,f = Σ w M_k,f the linear part of vertex v's skinning in frame f, δ_v,f = L_v,f⁻¹ (y_v,f − skinned_v,f) is what has to be added to
//! its stored position. The matrix A \[frame\]\[3 vertex\] of all δ has the best rank-K approximation U Uᵀ A, U the first K eigenvectors of A Aᵀ
//! (principal components without mean: no offset must stay no offset). Importers clamp weights to \[0, 1\]: u is brought there by
//! (u − lo)/(hi − lo), and one more target of constant weight 1 carries Σ lo_k S_k.

use crate::helpers::{HelperError, check, surface};
use crate::residual::{Residual, distances};
use animimic_scene::{Mesh, Motion, Refined, Rig};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Rounds of the subspace iteration; the spectrum of motion falls fast.
const ROUNDS: usize = 100;
/// Skinning that shrinks volumes below this share cannot be undone by an offset before it.
const LEAST_VOLUME: f64 = 1e-3;
/// Residuals up to this share of the diagonal are rounding.
const NEGLIGIBLE: f64 = 1e-6;

/// How far to go.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Most targets, the constant one among them.
    pub most: usize,
    /// 99th percentile of the residual that is good enough [share of the rest diagonal].
    pub goal: f64,
}

impl Default for Settings {
    /// Eight targets, which every engine plays; half a percent of the diagonal.
    fn default() -> Self {
        Self { most: 8, goal: 0.005 }
    }
}

/// Shapes and how much of each the clips' frames show.
#[derive(Clone, Debug, Default)]
pub struct Morphed {
    /// Offsets of stored positions \[target\]\[vertex\].
    pub offsets: Vec<Vec<DVec3>>,
    /// Weights in \[0, 1\] \[clip\]\[frame\]\[target\].
    pub weights: Vec<Vec<Vec<f64>>>,
    /// What skinning alone leaves.
    pub skinned: Residual,
    /// What is left with the targets.
    pub residual: Residual,
}

/// Finds as few targets as reach the goal.
///
/// # Errors
/// Those of [`crate::helpers::fit`].
pub fn fit(rig: &Rig, mesh: &Mesh, clips: &[Refined], settings: &Settings) -> Result<Morphed, HelperError> {
    clips.iter().try_for_each(|c| check(rig, mesh, c))?;
    let diagonal = mesh.diagonal();
    let wanted: Vec<Vec<DVec3>> = clips.iter().flat_map(|c| offsets(rig, mesh, c, NEGLIGIBLE * diagonal)).collect();
    let weights = clips.iter().map(|c| vec![Vec::new(); c.motion.poses.len()]).collect();
    let none = Morphed { weights, ..Morphed::default() };
    let skinned = measure(rig, diagonal, clips, &none);
    let none = Morphed { skinned, residual: skinned, ..none };
    if skinned.largest <= NEGLIGIBLE || settings.most == 0 {
        return Ok(none);
    }
    let basis = components(&wanted, settings.most);
    let mut best = none;
    for count in 1..=basis.len() {
        let mut morphed = ranged(&wanted, &basis[..count], clips);
        if morphed.offsets.len() > settings.most {
            break;
        }
        morphed.skinned = skinned;
        morphed.residual = measure(rig, diagonal, clips, &morphed);
        best = morphed;
        if best.residual.p99 <= settings.goal {
            break;
        }
    }
    Ok(best)
}

/// δ \[frame\]\[vertex\] of a clip.
fn offsets(rig: &Rig, mesh: &Mesh, clip: &Refined, negligible: f64) -> Vec<Vec<DVec3>> {
    let target = surface(rig, clip);
    let frame = |f: usize| {
        let world = rig.skeleton.world_from_joint(&clip.motion.poses[f].locals);
        let slots: Vec<_> = rig.skin.slots.iter().map(|s| world[s.joint] * s.inverse_bind).collect();
        let vertex = |v: usize| {
            let (mut place, mut linear, mut volume) = (DVec3::ZERO, DMat3::ZERO, 0.0);
            for i in &rig.skin.influences[v] {
                let map = &slots[i.slot as usize];
                place += map.transform_point3(rig.skin.bind_positions[v]) * i.weight;
                linear += map.matrix3 * i.weight;
                volume += map.matrix3.determinant().abs() * i.weight;
            }
            let missing = target.frames[f][v] - place;
            let sound = linear.determinant().abs() > LEAST_VOLUME * volume;
            if missing.length() <= negligible || !sound { DVec3::ZERO } else { linear.inverse() * missing }
        };
        (0..mesh.positions.len()).map(vertex).collect()
    };
    (0..clip.motion.poses.len()).into_par_iter().map(frame).collect()
}

/// The first eigenvectors of A Aᵀ by subspace iteration, \[component\]\[frame\].
fn components(wanted: &[Vec<DVec3>], most: usize) -> Vec<Vec<f64>> {
    let n = wanted.len();
    let product = |i: usize| -> Vec<f64> {
        (0..n).map(|j| wanted[i].iter().zip(&wanted[j]).map(|(a, b)| a.dot(*b)).sum()).collect()
    };
    let gram: Vec<Vec<f64>> = (0..n).into_par_iter().map(product).collect();
    let trace: f64 = (0..n).map(|i| gram[i][i]).sum();
    // Columns of the Gram matrix with the most motion are a start that misses no direction.
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| gram[b][b].total_cmp(&gram[a][a]).then(a.cmp(&b)));
    let mut basis: Vec<Vec<f64>> = order.iter().take(most.min(n)).map(|&i| gram[i].clone()).collect();
    for _ in 0..ROUNDS {
        orthonormalise(&mut basis, 1e-12 * trace);
        basis =
            basis.iter().map(|u| (0..n).map(|i| gram[i].iter().zip(u).map(|(g, u)| g * u).sum()).collect()).collect();
    }
    basis.sort_by(|a, b| norm(b).total_cmp(&norm(a)));
    orthonormalise(&mut basis, 1e-12 * trace);
    basis
}

fn norm(u: &[f64]) -> f64 {
    u.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Gram–Schmidt, twice; directions that vanish are dropped.
fn orthonormalise(basis: &mut Vec<Vec<f64>>, least: f64) {
    let mut out: Vec<Vec<f64>> = Vec::new();
    for mut u in std::mem::take(basis) {
        let before = norm(&u);
        for v in out.iter().chain(out.iter()) {
            let d: f64 = u.iter().zip(v).map(|(a, b)| a * b).sum();
            u.iter_mut().zip(v).for_each(|(a, b)| *a -= d * b);
        }
        let after = norm(&u);
        if after > least && after > 1e-10 * before {
            u.iter_mut().for_each(|x| *x /= after);
            out.push(u);
        }
    }
    *basis = out;
}

/// Shapes S_k = u_kᵀ A with weights in \[0, 1\], and the constant one where a weight was negative.
fn ranged(wanted: &[Vec<DVec3>], basis: &[Vec<f64>], clips: &[Refined]) -> Morphed {
    let vertices = wanted[0].len();
    let mut constant = vec![DVec3::ZERO; vertices];
    let (mut offsets, mut rows) = (Vec::new(), vec![Vec::new(); wanted.len()]);
    let mut below = false;
    for u in basis {
        let shape = |v: usize| u.iter().zip(wanted).map(|(u, w)| w[v] * *u).sum::<DVec3>();
        let shape: Vec<DVec3> = (0..vertices).into_par_iter().map(shape).collect();
        let (lo, hi) = u.iter().fold((0.0f64, 0.0f64), |(lo, hi), &x| (lo.min(x), hi.max(x)));
        let range = (hi - lo).max(f64::MIN_POSITIVE);
        below |= lo < 0.0;
        constant.iter_mut().zip(&shape).for_each(|(c, s)| *c += *s * lo);
        rows.iter_mut().zip(u).for_each(|(row, x)| row.push(((x - lo) / range).clamp(0.0, 1.0)));
        offsets.push(shape.iter().map(|s| *s * range).collect());
    }
    if below {
        offsets.push(constant);
        rows.iter_mut().for_each(|row| row.push(1.0));
    }
    let mut rows = rows.into_iter();
    let weights = clips.iter().map(|c| rows.by_ref().take(c.motion.poses.len()).collect()).collect();
    Morphed { offsets, weights, ..Morphed::default() }
}

fn measure(rig: &Rig, diagonal: f64, clips: &[Refined], morphed: &Morphed) -> Residual {
    let clip = |(clip, weights): (&Refined, &Vec<Vec<f64>>)| -> Vec<f64> {
        let target = surface(rig, clip);
        let frame =
            |f: usize| distances(&posed(rig, &clip.motion, f, &morphed.offsets, &weights[f]), &target.frames[f]);
        let frames: Vec<Vec<f64>> = (0..weights.len()).into_par_iter().map(frame).collect();
        frames.into_iter().flatten().collect()
    };
    Residual::of_distances(clips.iter().zip(&morphed.weights).flat_map(clip).collect(), diagonal)
}

/// Vertices of a frame with shapes added before the skin.
fn posed(rig: &Rig, motion: &Motion, frame: usize, offsets: &[Vec<DVec3>], weights: &[f64]) -> Vec<DVec3> {
    let world = rig.skeleton.world_from_joint(&motion.poses[frame].locals);
    let slots: Vec<_> = rig.skin.slots.iter().map(|s| world[s.joint] * s.inverse_bind).collect();
    (0..rig.skin.bind_positions.len())
        .map(|v| {
            let added: DVec3 = offsets.iter().zip(weights).map(|(o, w)| o[v] * *w).sum();
            let x = rig.skin.bind_positions[v] + added;
            rig.skin.influences[v].iter().map(|i| slots[i.slot as usize].transform_point3(x) * i.weight).sum()
        })
        .collect()
}
