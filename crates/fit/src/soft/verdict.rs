//! What the frames say of a soft surface against the skinned one.
//!
//! Both are looked for in every frame, and the differences of their energies judge, frame by frame: what lies behind them (light,
//! compression, the mask's edge) is the same in both. A soft surface is no worse where the mean difference is not above its own
//! standard error, and better where it is below zero at the 1 % level, one-sided: which groups are soft was chosen by the same frames.
//! Neighbouring frames err alike, which the standard error counts: Newey and West 1987 (eq. 5, Bartlett's weights), as many lags as
//! Andrews 1991 (eqs. 5.3, 6.2, 6.4) takes for a series of first order.

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
    mean < -SIGNIFICANT * error
}

/// Standard errors below zero that chance reaches in one case of a hundred.
const SIGNIFICANT: f64 = 2.326;

/// Mean of soft less skinned over frames, and its standard error.
pub fn difference(skinned: &[f64], soft: &[f64]) -> [f64; 2] {
    let differences: Vec<f64> = skinned.iter().zip(soft).map(|(a, b)| b - a).collect();
    let n = differences.len().max(1) as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let off: Vec<f64> = differences.iter().map(|d| d - mean).collect();
    [mean, (long_run_variance(&off) / (n - 1.0).max(1.0)).sqrt()]
}

/// Largest correlation of neighbours that lags are chosen by (Andrews and Monahan 1992): at 1 the rule has no answer.
const MOST_CORRELATED: f64 = 0.97;

/// n times the variance of the mean of a series with these deviations from it; no less than if they were independent.
fn long_run_variance(off: &[f64]) -> f64 {
    let n = off.len();
    let covariance = |lag: usize| off.iter().zip(&off[lag..]).map(|(a, b)| a * b).sum::<f64>() / n as f64;
    if n < 2 || covariance(0) == 0.0 {
        return 0.0;
    }
    let before: f64 = off[..n - 1].iter().map(|e| e * e).sum();
    let correlation = (covariance(1) * n as f64 / before).clamp(-MOST_CORRELATED, MOST_CORRELATED);
    let alpha = 4.0 * correlation.powi(2) / (1.0 - correlation.powi(2)).powi(2);
    let lags = ((1.1447 * (alpha * n as f64).cbrt()).ceil() as usize).min(n - 1);
    let weighted = |lag: usize| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * covariance(lag);
    covariance(0) + (1..=lags).map(weighted).sum::<f64>().max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::SplitMix64;

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
        assert!(!better(&skinned, &plus(&|t| noise(t) - 0.2)), "one in ten times by chance");
        assert!(better(&skinned, &plus(&|t| noise(t) - 0.5)), "far beyond it");
        assert!(!better(&skinned, &skinned));
        assert_eq!(difference(&[], &[]), [0.0, 0.0]);
        assert_eq!(difference(&[1.0], &[3.0]), [2.0, 0.0]);
    }

    #[test]
    fn the_standard_error_counts_that_neighbouring_frames_err_alike() {
        // Means of series x_t = rho x_{t-1} + e_t around zero: how often they are within the error that is told for each.
        let covered = |rho: f64, frames: usize, blind: bool| -> f64 {
            let (mut rng, series) = (SplitMix64(5), 2000);
            let zeros = vec![0.0; frames];
            let within = (0..series).filter(|_| {
                let mut x = rng.normal() / (1.0 - rho * rho).sqrt();
                let mut next = || {
                    x = rho * x + rng.normal();
                    x
                };
                let mut all: Vec<f64> = (0..frames).map(|_| next()).collect();
                let mean = all.iter().sum::<f64>() / frames as f64;
                if blind {
                    // Shuffled, so that neighbours are as good as independent.
                    (1..frames).for_each(|k| all.swap(k, rng.next_u64() as usize % (k + 1)));
                }
                mean.abs() <= difference(&zeros, &all)[1]
            });
            within.count() as f64 / f64::from(series)
        };
        // One standard error covers 68 % of means. What is left is bias of so few frames: less with more of them.
        for (rho, least) in [(0.0, 0.65), (0.5, 0.58), (0.7, 0.54)] {
            let [few, many, blind] = [(60, false), (240, false), (60, true)].map(|(n, b)| covered(rho, n, b));
            println!("rho {rho}: {few:.3} of 60 frames, {many:.3} of 240, {blind:.3} if taken as independent");
            assert!(few > least - 0.04 && many > least && many < 0.72, "{rho}");
            assert!(rho == 0.0 || few > blind + 0.1, "{rho}");
        }
    }
}
