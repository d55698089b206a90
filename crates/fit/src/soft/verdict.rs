//! What the frames say of a soft surface against the skinned one.
//!
//! Both are looked for in every frame, and the differences of their energies judge, frame by frame: what lies behind them (light,
//! compression, the mask's edge) is the same in both. A soft surface is no worse where the mean difference is not above its own standard
//! error, and better where it is below zero by more than that.

use super::clusters::Groups;
use super::evidence::Evidence;
use super::seen::Seen;
use crate::stage1::solve::Stage;
use animimic_scene::Asset;
use glam::DVec3;

/// Energies of both surfaces.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Energy of each frame with the skinned and with the soft surface.
    pub frames: [Vec<f64>; 2],
    /// The same by group of flesh, residuals alone.
    pub by_group: Vec<[Vec<f64>; 2]>,
}

/// Compares both surfaces \[frame\]\[vertex\] with a video.
pub fn judge(asset: &Asset, groups: &Groups, stage: &Stage, skinned: &[Vec<DVec3>], soft: &[Vec<DVec3>]) -> Verdict {
    let main = |v: usize| asset.rig.skin.main_joint(v).map_or(0, |j| groups.of_joint[j] as usize);
    let count = skinned.len();
    let mut by_group = vec![[vec![0.0; count], vec![0.0; count]]; groups.parents.len()];
    let mut frames = [Vec::new(), Vec::new()];
    for (k, surfaces) in [skinned, soft].into_iter().enumerate() {
        let seen = Seen::new(stage, surfaces, stage.settings.reach_px.1);
        frames[k] = seen.energies(surfaces);
        for (t, surface) in surfaces.iter().enumerate() {
            for r in seen.residuals(t, surface) {
                by_group[main(r.gradient[0].0 as usize)][k][t] += r.energy();
            }
        }
    }
    Verdict { frames, by_group }
}

/// Whether `soft` explains frames no worse than `skinned`, as far as they can tell: energies of each frame.
pub fn no_worse(skinned: &[f64], soft: &[f64]) -> bool {
    let [mean, error] = difference(skinned, soft);
    mean <= error
}

/// Whether `soft` explains frames better than `skinned`, beyond what they cannot tell.
pub fn better(skinned: &[f64], soft: &[f64]) -> bool {
    let [mean, error] = difference(skinned, soft);
    mean < -error
}

/// Mean of soft less skinned over frames, and its standard error.
pub fn difference(skinned: &[f64], soft: &[f64]) -> [f64; 2] {
    let n = skinned.len().max(1) as f64;
    let differences = || skinned.iter().zip(soft).map(|(a, b)| b - a);
    let mean = differences().sum::<f64>() / n;
    let variance = differences().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    [mean, (variance / n).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_judged_by_how_much_they_scatter() {
        let skinned: Vec<f64> = (0..40).map(|t| 10.0 + f64::from(t % 7)).collect();
        let plus =
            |f: &dyn Fn(usize) -> f64| -> Vec<f64> { skinned.iter().enumerate().map(|(t, e)| e + f(t)).collect() };
        let noise = |t: usize| if t.is_multiple_of(2) { 1.0 } else { -1.0 };
        assert!(no_worse(&skinned, &skinned));
        assert!(no_worse(&skinned, &plus(&|t| noise(t) + 0.1)), "within the noise");
        assert!(!no_worse(&skinned, &plus(&|t| noise(t) + 0.3)), "beyond it");
        assert!(!no_worse(&skinned, &plus(&|_| 1e-3)), "little, but in every frame");
        assert!(better(&skinned, &plus(&|_| -1e-3)) && no_worse(&skinned, &plus(&|_| -1e-3)));
        assert!(!better(&skinned, &plus(&|t| noise(t) - 0.1)), "within the noise");
        assert!(!better(&skinned, &skinned));
    }
}
