//! Stiffness from what is seen: Gauss–Newton on ln E through forward sensitivities.
//!
//! Minimise E(ln E, α)/s² + Σ_c (ln E_c − ln E_c⁰)²/σ² over the clips of one body, E the energy of all [`Evidence`], s² what of it an
//! independent observation has (re-estimated). The columns of the Jacobian are ∂x/∂ln E through the embedding, and one
//! difference quotient for the damping α; losses of pictures add their exact gradient, their curvature is left out. The inverse of
//! the normal matrix is the posterior: what the evidence does not determine stays at the prior with a deviation of σ.
//!
//! Coarse to fine: all groups of flesh have one modulus first; where no step helps any more, the cluster whose parts pull
//! apart most is split, as long as the model's minimum falls by more than what a parameter costs (ln n, Schwarz 1978).

use super::clusters::{Groups, count, split};
use super::evidence::{Evidence, Residual};
use super::normal::Normal;
use super::{Simulated, Stepping, Tissue};
use crate::FitError;
use animimic_scene::Pose;
use animimic_sim::{Elasticity, sensitivities};
use glam::{DAffine3, DVec3};
use rayon::prelude::*;

/// One motion of the body, with what is known of it.
#[derive(Clone, Copy)]
pub struct Clip<'a> {
    /// Poses of the joints.
    pub poses: &'a [Pose],
    /// Frames per second.
    pub fps: f64,
    /// What is known.
    pub evidence: &'a dyn Evidence,
}

/// The motions that a material is fitted to.
pub struct Problem<'a, 'b> {
    /// The body.
    pub tissue: &'a Tissue<'b>,
    /// Its clips: they share the material.
    pub clips: &'a [Clip<'a>],
    /// Steps per frame, constant: the loss must not jump.
    pub substeps: usize,
    /// Width of the prior of ln E, for each of the material's clusters; a small one keeps what is known.
    pub prior_deviations: &'a [f64],
    /// The groups that the material's clusters are, where they may share a modulus; else each has its own.
    pub groups: Option<&'a Groups>,
    /// Whether the damping is fitted too.
    pub damping: bool,
    /// Whether losses of pictures count.
    pub pictures: bool,
}

/// A fitted material.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The material.
    pub elasticity: Elasticity,
    /// Damping proportional to mass [1/s].
    pub mass_damping: f64,
    /// The cluster that each of the material's groups is in.
    pub clusters: Vec<u32>,
    /// Posterior standard deviation of ln E, per group; that of the prior where nothing was learnt.
    pub deviations: Vec<f64>,
    /// Energy at the start and after each accepted step.
    pub energies: Vec<f64>,
}

/// Largest change of ln E in a step.
const LARGEST_CHANGE: f64 = 1.5;
/// Change of the damping for its difference quotient [1/s].
const DAMPING_STEP: f64 = 0.25;
/// Width of the prior of the damping [1/s], around none.
const DAMPING_DEVIATION: f64 = 5.0;
/// Most damping [1/s]: it acts on velocities in the world, so much of it would hold back what is only carried along.
const MOST_DAMPING: f64 = 10.0;
/// ln E may leave the prior by this much: a factor of 1000 either way.
const RANGE: f64 = 7.0;
/// Dampings of the step tried before an iteration gives up.
const TRIES: usize = 4;
/// Clusters may be split where a step lowers the energy by less than the first share; the fit ends below the second.
const SETTLED: [f64; 2] = [0.05, 1e-3];
/// Changes of ln E of all open clusters together that are tried first, and dampings with each where it is fitted [1/s].
const SCAN: ([f64; 5], [f64; 3]) = ([-2.5, -1.2, 0.0, 1.2, 2.5], [0.0, 2.0, 8.0]);
/// Clusters with a prior at least this wide take part in the scan.
const OPEN: f64 = 0.5;

/// A simulated material with its comparison.
struct State {
    elasticity: Elasticity,
    damping: f64,
    clips: Vec<Run>,
    energy: f64,
}

/// One clip of it.
struct Run {
    simulated: Simulated,
    /// \[frame\]\[residual\].
    residuals: Vec<Vec<Residual>>,
    /// Losses of pictures \[frame\].
    rendered: Vec<f64>,
}

impl Problem<'_, '_> {
    fn run(&self, elasticity: Elasticity, damping: f64) -> Result<State, FitError> {
        let stepping = Stepping { mass_damping: damping, tolerance: 1e-3, ..Stepping::default() };
        let one = |clip: &Clip| -> Result<Run, FitError> {
            let start = self.tissue.start(&elasticity, &stepping, &clip.poses[0])?;
            let simulated =
                self.tissue.simulate_from(start, &elasticity, &stepping, clip.poses, clip.fps, self.substeps)?;
            let cages: Vec<&Vec<DVec3>> = simulated.frames().collect();
            let frames = cages.par_iter().enumerate().map(|(t, cage)| {
                let surface = self.surface(clip, t, cage);
                let rendered = if self.pictures { clip.evidence.rendered(t, &surface, false).0 } else { 0.0 };
                (clip.evidence.residuals(t, &surface), rendered)
            });
            let (residuals, rendered) = frames.unzip();
            Ok(Run { simulated, residuals, rendered })
        };
        let clips: Vec<Run> = self.clips.par_iter().map(one).collect::<Result<_, _>>()?;
        let energy = clips.iter().map(Run::energy).sum();
        Ok(State { elasticity, damping, clips, energy })
    }

    fn surface(&self, clip: &Clip, frame: usize, cage: &[DVec3]) -> Vec<DVec3> {
        let world: Vec<DAffine3> = self.tissue.world(&clip.poses[frame]);
        self.tissue.surface(cage, &world)
    }

    /// Energy of all evidence for a material.
    ///
    /// # Errors
    /// As [`Tissue::simulate`].
    pub fn energy(&self, elasticity: &Elasticity, damping: f64) -> Result<f64, FitError> {
        Ok(self.run(elasticity.clone(), damping)?.energy)
    }

    /// The best of changes of ln E of all open clusters together, from a material on.
    ///
    /// # Errors
    /// As [`Tissue::simulate`].
    pub fn best_of(&self, material: &Elasticity, changes: &[f64]) -> Result<(Elasticity, f64), FitError> {
        let best = self.scan(material, changes, &[0.0])?;
        Ok((best.elasticity, best.energy))
    }

    /// How many independent observations all clips are worth.
    pub fn observations(&self) -> f64 {
        self.clips.iter().map(|c| c.evidence.observations()).sum()
    }

    fn check(&self, prior: &Elasticity) -> Result<(), FitError> {
        let count = prior.ln_youngs.len();
        let positive = self.prior_deviations.iter().all(|d| *d > 0.0);
        if self.prior_deviations.len() != count || !positive {
            return Err(FitError::Input("a prior needs one positive deviation for every cluster".into()));
        }
        if self.groups.is_some_and(|g| g.parents.len() != count) {
            return Err(FitError::Input("the material's clusters are not the groups of the body".into()));
        }
        if self.clips.iter().any(|c| c.poses.is_empty()) || self.observations() <= 0.0 {
            return Err(FitError::Input("there is nothing to compare the soft surface with".into()));
        }
        Ok(())
    }

    /// Fits ln E around a prior, and the damping: from a scan, or from where an earlier fit ended.
    ///
    /// # Errors
    /// As [`Tissue::simulate`]; no evidence at all.
    pub fn fit(&self, prior: &Elasticity, from: Option<&Estimate>, iterations: usize) -> Result<Estimate, FitError> {
        self.check(prior)?;
        let (mut now, mut cluster) = match from {
            Some(e) => (self.run(e.elasticity.clone(), e.mass_damping)?, e.clusters.clone()),
            None => (self.scan(prior, &SCAN.0, if self.damping { &SCAN.1 } else { &[0.0] })?, self.coarse()),
        };
        let mut history = vec![now.energy];
        let (mut fine, mut step_damping) = (self.normal(&now)?, 1e-3);
        for _ in 0..iterations {
            let next = self.step(&now, prior, &fine, &cluster, &mut step_damping)?;
            let gain = next.as_ref().map_or(0.0, |n| 1.0 - n.energy / now.energy.max(f64::MIN_POSITIVE));
            if let Some(next) = next {
                now = next;
                history.push(now.energy);
                fine = self.normal(&now)?;
            }
            let price = self.observations().ln();
            let system = |cluster: &[u32]| self.system(&now, prior, &fine, cluster);
            let mut parted = false;
            if let Some(groups) = self.groups.filter(|_| gain < SETTLED[0]) {
                while split(groups, &mut cluster, price, system) {
                    parted = true;
                }
            }
            if gain < SETTLED[1] && !parted {
                break;
            }
        }
        let own = self.system(&now, prior, &fine, &cluster).deviations();
        Ok(Estimate {
            mass_damping: now.damping,
            deviations: cluster.iter().map(|&c| own[c as usize]).collect(),
            clusters: cluster,
            elasticity: now.elasticity,
            energies: history,
        })
    }

    /// All groups in one cluster where they may share, each in its own where not.
    fn coarse(&self) -> Vec<u32> {
        let each = 0..self.prior_deviations.len() as u32;
        if self.groups.is_some() { each.map(|_| 0).collect() } else { each.collect() }
    }

    /// A step that lowers the objective; none where none does.
    fn step(
        &self,
        now: &State,
        prior: &Elasticity,
        fine: &Normal,
        cluster: &[u32],
        damping: &mut f64,
    ) -> Result<Option<State>, FitError> {
        let normal = self.system(now, prior, fine, cluster);
        let scale = self.scale(now);
        let before = self.objective(now, prior, cluster, scale);
        let clusters = normal.gradient.len() - usize::from(self.damping);
        for _ in 0..TRIES {
            let step = normal.solve(*damping);
            let largest = step[..clusters].iter().fold(0.0f64, |m, d| m.max(d.abs()));
            let shrink = (LARGEST_CHANGE / largest.max(LARGEST_CHANGE)).min(1.0);
            let mut next = now.elasticity.clone();
            for (g, (l, p)) in next.ln_youngs.iter_mut().zip(&prior.ln_youngs).enumerate() {
                *l = (*l - shrink * step[cluster[g] as usize]).clamp(p - RANGE, p + RANGE);
            }
            let drag = if self.damping { shrink * step[clusters] } else { 0.0 };
            let trial = self.run(next, (now.damping - drag).clamp(0.0, MOST_DAMPING))?;
            if self.objective(&trial, prior, cluster, scale) < before {
                *damping = (*damping / 10.0).max(1e-9);
                return Ok(Some(trial));
            }
            *damping = (*damping * 10.0).max(1e-2);
        }
        Ok(None)
    }

    /// The best of a coarse grid around a material: far away, linearised motions are no guide.
    fn scan(&self, around: &Elasticity, changes: &[f64], dampings: &[f64]) -> Result<State, FitError> {
        let tries: Vec<(f64, f64)> = dampings.iter().flat_map(|d| changes.iter().map(|c| (*d, *c))).collect();
        let one = |&(damping, change): &(f64, f64)| {
            let mut trial = around.clone();
            let open = self.prior_deviations.iter().map(|d| f64::from(u8::from(*d >= OPEN)));
            trial.ln_youngs.iter_mut().zip(open).for_each(|(l, o)| *l += o * change);
            self.run(trial, damping)
        };
        // The first of the best, as if they were tried one by one; only the best so far are held.
        let better = |a: Result<State, FitError>, b: Result<State, FitError>| {
            let (a, b) = (a?, b?);
            Ok(if b.energy < a.energy { b } else { a })
        };
        let none = || Err(FitError::Input("nothing was tried".into()));
        tries.par_iter().map(one).reduce_with(better).unwrap_or_else(none)
    }

    /// s²: energy of an independent observation.
    fn scale(&self, state: &State) -> f64 {
        (state.energy / self.observations()).max(f64::MIN_POSITIVE)
    }

    /// Precision of the prior of each cluster: the mean of its groups'.
    fn precisions(&self, cluster: &[u32]) -> Vec<f64> {
        means(cluster, self.prior_deviations.iter().map(|d| d.powi(-2)))
    }

    /// How far each cluster is from its prior: the mean of its groups'.
    fn away(now: &Elasticity, prior: &Elasticity, cluster: &[u32]) -> Vec<f64> {
        means(cluster, now.ln_youngs.iter().zip(&prior.ln_youngs).map(|(l, p)| l - p))
    }

    /// Energy over s², and the priors.
    fn objective(&self, state: &State, prior: &Elasticity, cluster: &[u32], scale: f64) -> f64 {
        let away = Self::away(&state.elasticity, prior, cluster);
        let material: f64 = away.iter().zip(self.precisions(cluster)).map(|(a, p)| p * a * a).sum();
        state.energy / scale + material + (state.damping / DAMPING_DEVIATION).powi(2)
    }

    /// Normal equations of clusters, with priors; the damping comes last where it is fitted.
    fn system(&self, now: &State, prior: &Elasticity, fine: &Normal, cluster: &[u32]) -> Normal {
        let clusters = count(cluster);
        let mut all = cluster.to_vec();
        all.extend(self.damping.then_some(clusters as u32));
        let mut normal = fine.merged(&all, clusters + usize::from(self.damping));
        let away = Self::away(&now.elasticity, prior, cluster);
        for (c, (a, p)) in away.into_iter().zip(self.precisions(cluster)).enumerate() {
            normal.add_prior(c, a, p);
        }
        if self.damping {
            normal.add_prior(clusters, now.damping, DAMPING_DEVIATION.powi(-2));
        }
        normal
    }

    /// Normal equations of the evidence for all groups, over s²; the last parameter is the damping where it is fitted.
    fn normal(&self, now: &State) -> Result<Normal, FitError> {
        let weight = 1.0 / self.scale(now);
        let shaken =
            if self.damping { Some(self.run(now.elasticity.clone(), now.damping + DAMPING_STEP)?) } else { None };
        let mut normal = Normal::zeros(self.prior_deviations.len() + usize::from(self.damping));
        for (k, clip) in self.clips.iter().enumerate() {
            let of_clip = self.normal_of(now, clip, &now.clips[k], shaken.as_ref().map(|s| &s.clips[k]))?;
            of_clip.iter().for_each(|frame| normal.add_all(frame));
        }
        normal.matrix.iter_mut().flatten().for_each(|m| *m *= weight);
        normal.gradient.iter_mut().for_each(|g| *g *= weight);
        Ok(normal)
    }

    /// Normal equations of every frame of a clip.
    fn normal_of(&self, now: &State, clip: &Clip, run: &Run, shaken: Option<&Run>) -> Result<Vec<Normal>, FitError> {
        let simulated = &run.simulated;
        let columns = sensitivities(&self.tissue.body, &now.elasticity, &simulated.settings, &simulated.simulation)?;
        let ends: Vec<&Vec<Vec<f64>>> = columns.frames.iter().skip(self.substeps - 1).step_by(self.substeps).collect();
        let cages: Vec<&Vec<DVec3>> = simulated.frames().collect();
        let groups = self.prior_deviations.len();
        let frame = |t: usize| {
            let mut normal = Normal::zeros(groups + usize::from(self.damping));
            // The first frame is the start, which no modulus changes.
            let Some(columns) = t.checked_sub(1).map(|n| ends[n]) else { return normal };
            let fields: Vec<Vec<DVec3>> = columns.iter().map(|c| self.tissue.surface_column(c)).collect();
            let mut row = vec![0.0; groups + usize::from(self.damping)];
            for (i, r) in run.residuals[t].iter().enumerate() {
                for (value, field) in row.iter_mut().zip(&fields) {
                    *value = r.gradient.iter().map(|(v, g)| g.dot(field[*v as usize])).sum();
                }
                if let Some(other) = shaken {
                    row[groups] = (other.residuals[t][i].value - r.value) / DAMPING_STEP;
                }
                normal.add(&row, r.value, r.weight * r.robust.weight(r.value.abs()));
            }
            if self.pictures {
                let forces = clip.evidence.rendered(t, &self.surface(clip, t, cages[t]), true).1;
                let pairs = normal.gradient.iter_mut().zip(&fields);
                pairs.for_each(|(g, f)| *g += 0.5 * forces.iter().zip(f).map(|(a, b)| a.dot(*b)).sum::<f64>());
                if let Some(other) = shaken {
                    normal.gradient[groups] += 0.5 * (other.rendered[t] - run.rendered[t]) / DAMPING_STEP;
                }
            }
            normal
        };
        Ok((0..clip.poses.len()).into_par_iter().map(frame).collect())
    }

    /// ∂(energy)/∂ln E of every group: what a step follows, for checks.
    ///
    /// # Errors
    /// As [`Tissue::simulate`].
    pub fn gradient(&self, elasticity: &Elasticity, damping: f64) -> Result<Vec<f64>, FitError> {
        let now = self.run(elasticity.clone(), damping)?;
        let scale = self.scale(&now);
        Ok(self.normal(&now)?.gradient.iter().map(|g| 2.0 * g * scale).collect())
    }
}

impl Run {
    fn energy(&self) -> f64 {
        self.residuals.iter().flatten().map(Residual::energy).sum::<f64>() + self.rendered.iter().sum::<f64>()
    }
}

/// Mean of the groups' values in each cluster.
fn means(cluster: &[u32], values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0f64); count(cluster)];
    for (c, value) in cluster.iter().zip(values) {
        let s = &mut sums[*c as usize];
        *s = (s.0 + value, s.1 + 1.0);
    }
    sums.iter().map(|s| s.0 / s.1.max(1.0)).collect()
}
