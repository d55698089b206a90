//! Stage 2: the material of a body from videos of it, with the joints held where stage 1 put them.
//!
//! loose chains → groups of flesh → ln E by rounds of drawing and Gauss–Newton ([`super::estimate`]). What a video does not
//! determine stays at the prior and says so. All clips of a body share its material.

use super::clusters::Groups;
use super::estimate::{Clip, Estimate, Problem};
use super::loosen;
use super::seen::Seen;
use super::{Settings, Stepping, Tissue};
use crate::FitError;
use crate::stage1::solve::Stage;
use animimic_scene::{Asset, Pose};
use animimic_sim::tet::cage;
use animimic_sim::{Elasticity, Model};
use glam::DVec3;
use rayon::prelude::*;

/// How a material is learnt.
#[derive(Clone, Debug)]
pub struct Wish {
    /// Young's modulus that flesh is taken to have [Pa].
    pub young: f64,
    /// Width of that prior, as a standard deviation of ln E.
    pub deviation: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// Density [kg/m³].
    pub density: f64,
    /// Whether chains of joints may be found to be loose.
    pub loosen: bool,
    /// Times that the model is drawn anew, and steps of each.
    pub rounds: usize,
    /// Steps of each round.
    pub steps: usize,
}

impl Default for Wish {
    /// Flesh, within a factor of ten.
    fn default() -> Self {
        Self { young: 1e5, deviation: 2.3, poisson: 0.4, density: 1000.0, loosen: true, rounds: 2, steps: 4 }
    }
}

/// One video with its solved motion.
#[derive(Clone, Copy)]
pub struct Watched<'a> {
    /// The video, as stage 1 looks at it.
    pub stage: &'a Stage<'a>,
    /// Poses \[frame\].
    pub poses: &'a [Pose],
    /// Frames per second.
    pub fps: f64,
}

/// A learnt material.
#[derive(Clone, Debug)]
pub struct Learnt {
    /// How the tissue is made: with the chains that were found to be loose.
    pub settings: Settings,
    /// Groups of flesh.
    pub groups: Groups,
    /// ln E of each group [ln Pa].
    pub ln_youngs: Vec<f64>,
    /// Its posterior standard deviation.
    pub deviations: Vec<f64>,
    /// The cluster that each group is in.
    pub clusters: Vec<u32>,
    /// Energy of the evidence before and after.
    pub energies: [f64; 2],
    /// What was asked for.
    pub wish: Wish,
}

/// Most groups of flesh.
const GROUPS: usize = 16;
/// Most tets that stiffness is learnt on, in all rounds but the last and in that: a lattice is stiffer the coarser it is, so the last
/// should be as fine as the body that will have this stiffness.
const TETS: [usize; 2] = [1500, 3000];

/// Learns the material of a model from videos.
///
/// # Errors
/// As [`Tissue::new`] and [`Tissue::simulate`]; no frames; a stop, which `go_on` asks for.
pub fn learn(
    asset: &Asset,
    settings: &Settings,
    wish: &Wish,
    watched: &[Watched],
    go_on: &mut dyn FnMut(f64) -> Result<(), FitError>,
) -> Result<Learnt, FitError> {
    let mut surfaces: Vec<Vec<Vec<DVec3>>> = watched.iter().map(|w| skinned(asset, w.poses)).collect();
    let rounds = wish.rounds.max(1);
    let mut made = Settings { tets: settings.tets.min(TETS[0]), ..settings.clone() };
    let mut lattice = cage(&asset.mesh, made.tets)?;
    let mut tissue = Tissue::with_cage(asset, lattice.clone(), &made)?;
    let groups = Groups::new(&tissue, GROUPS);
    let deviations = vec![wish.deviation; groups.parents.len()];
    let mut found: Option<Estimate> = None;
    let mut first = None;
    for round in 0..rounds {
        go_on(round as f64 / rounds as f64)?;
        let seen = look(watched, &surfaces, round == 0);
        let clips = clips(watched, &seen);
        // What hangs loose is seen better once what was found to be loose before is where it belongs.
        if wish.loosen && (round == 0 || made.loose.len() > settings.loose.len()) {
            let looser = loosen::loose(asset, &made, &clips, (wish.poisson, wish.density))?;
            if (&looser.loose, looser.held_roots) != (&made.loose, made.held_roots) {
                tissue = Tissue::with_cage(asset, lattice.clone(), &looser)?;
                (made, found) = (looser, None);
            }
        }
        if round + 1 == rounds && settings.tets > made.tets {
            made.tets = settings.tets.min(TETS[1]);
            lattice = cage(&asset.mesh, made.tets)?;
            tissue = Tissue::with_cage(asset, lattice.clone(), &made)?;
            // The same moduli, by the tets of the finer cage.
            found =
                found.map(|f| Estimate { elasticity: material(&groups, &tissue, &f.elasticity.ln_youngs, wish), ..f });
        }
        let prior = material(&groups, &tissue, &vec![wish.young.ln(); groups.parents.len()], wish);
        go_on((round as f64 + 0.4) / rounds as f64)?;
        let problem = Problem {
            tissue: &tissue,
            clips: &clips,
            substeps: 1,
            prior_deviations: &deviations,
            groups: Some(&groups),
            damping: false,
            pictures: true,
        };
        let next = problem.fit(&prior, found.as_ref(), wish.steps)?;
        first = first.or(Some(next.energies[0]));
        if round + 1 < rounds {
            let simulated = |w: &Watched| simulated(&tissue, &next.elasticity, w.poses, w.fps);
            surfaces = watched.iter().map(simulated).collect::<Result<_, _>>()?;
        }
        found = Some(next);
    }
    let found = found.ok_or_else(|| FitError::Input("there is no video to learn from".into()))?;
    let last = found.energies.last().copied().unwrap_or(0.0);
    Ok(Learnt {
        settings: Settings { tets: settings.tets, ..made },
        groups,
        ln_youngs: found.elasticity.ln_youngs,
        deviations: found.deviations,
        clusters: found.clusters,
        energies: [first.unwrap_or(last), last],
        wish: wish.clone(),
    })
}

impl Learnt {
    /// The material for a body on the same skeleton.
    pub fn elasticity(&self, tissue: &Tissue) -> Elasticity {
        material(&self.groups, tissue, &self.ln_youngs, &self.wish)
    }
}

fn material(groups: &Groups, tissue: &Tissue, ln_youngs: &[f64], wish: &Wish) -> Elasticity {
    let tets = tissue.body.tets.len();
    let one = Elasticity::uniform(Model::GuardedCorotated, tets, wish.young, wish.poisson, wish.density);
    Elasticity { cluster: groups.of_tets(tissue), ln_youngs: ln_youngs.to_vec(), ..one }
}

/// Looks for surfaces in all videos, first from far, then from near.
fn look<'a>(watched: &[Watched<'a>], surfaces: &[Vec<Vec<DVec3>>], first: bool) -> Vec<Seen<'a>> {
    let reach = |s: &Stage| if first { s.settings.reach_px.0 } else { s.settings.reach_px.1 };
    watched.iter().zip(surfaces).map(|(w, s)| Seen::new(w.stage, s, reach(w.stage))).collect()
}

fn clips<'a>(watched: &[Watched<'a>], seen: &'a [Seen]) -> Vec<Clip<'a>> {
    let clip = |(w, evidence): (&Watched<'a>, &'a Seen)| Clip { poses: w.poses, fps: w.fps, evidence };
    watched.iter().zip(seen).map(clip).collect()
}

/// Surfaces of plain skinning \[frame\]\[vertex\].
pub fn skinned(asset: &Asset, poses: &[Pose]) -> Vec<Vec<DVec3>> {
    poses.par_iter().map(|p| asset.rig.in_pose(p)).collect()
}

/// Soft surfaces of a motion \[frame\]\[vertex\].
pub(super) fn simulated(
    tissue: &Tissue,
    material: &Elasticity,
    poses: &[Pose],
    fps: f64,
) -> Result<Vec<Vec<DVec3>>, FitError> {
    Ok(tissue.simulate(material, &Stepping::default(), poses, fps)?.surfaces(tissue, poses))
}
