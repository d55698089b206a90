//! Soft tissue for clips with their videos: the material is learnt from them, and they decide where the soft surface stays.

use super::body::{self, Softened};
use super::softness::{DENSITY, POISSON};
use crate::Error;
use crate::animate::motion::Scene;
use crate::event::{Event, Progress, tell};
use animimic_fit::FitError;
use animimic_fit::soft::clusters::count;
use animimic_fit::soft::learn::{self, Learnt, Watched, Wish, learn};
use animimic_fit::soft::seen::energies;
use animimic_fit::soft::together::{Turns, blend, together};
use animimic_fit::soft::verdict::{Verdict, better, difference, judge, no_worse};
use animimic_fit::soft::{Settings, Stepping, Tissue};
use animimic_fit::stage1::solve::Stage;
use animimic_fit::stage1::subject::Subject;
use animimic_fit::stage1::{self, Input};
use animimic_render::Light;
use animimic_scene::{Asset, Image, Motion};
use glam::DVec3;
use serde_json::{Value, json};

/// A clip, and the video that shows it.
pub(crate) struct Filmed<'a> {
    pub scene: Scene<'a>,
    pub motion: &'a Motion,
}

/// What is asked for.
#[derive(Clone, Debug)]
pub(crate) struct Ask {
    /// How tissue is made.
    pub settings: Settings,
    /// Young's modulus that flesh is taken to have [Pa].
    pub young: f64,
    /// Whether poses are solved again for the soft surface: not where the motion is given.
    pub solve: bool,
}

/// What was made of a clip.
pub(crate) struct Outcome {
    /// The clip with its surface: where the frames do not speak for the soft one, the skinned one.
    pub softened: Softened,
    /// The soft surface \[frame\]\[vertex\], also where it is not kept: to be looked at.
    pub shown: Vec<Vec<DVec3>>,
    /// Whether the frames speak for it.
    pub kept: bool,
    /// What they said.
    pub report: Value,
}

/// Deviations below this share of the prior's are called learnt.
const LEARNT: f64 = 0.5;

/// Most turns of solving poses with all flesh soft, and with what the frames let be soft.
const ROUNDS: [usize; 2] = [2, 3];

/// Learns the material that the clips share and gives them soft tissue. Motions and videos are those of `solved`, the model or its
/// stand-in; surfaces are those of `asset`. Returns what was made of each clip, and what was learnt of the material.
pub(crate) fn refine(
    asset: &Asset,
    solved: &Asset,
    filmed: &[Filmed],
    ask: &Ask,
    progress: &mut Progress,
) -> Result<(Vec<Outcome>, Value), Error> {
    let subject = Subject::new(solved)?;
    let backgrounds: Vec<Vec<Image>> = filmed.iter().map(|f| f.scene.backgrounds()).collect();
    let inputs: Vec<Input> = filmed.iter().zip(&backgrounds).map(|(f, b)| f.scene.input(b)).collect();
    let lights: Vec<Light> = inputs.iter().map(|i| stage1::first_light(i, &subject)).collect::<Result<_, _>>()?;
    let settings = stage1::Settings::default;
    let mut stages: Vec<Stage> =
        inputs.iter().zip(&lights).map(|(i, l)| stage1::stage(i, &subject, l, settings())).collect();
    let watched: Vec<Watched> = (filmed.iter().zip(&stages))
        .map(|(f, stage)| Watched { stage, poses: &f.motion.poses, fps: f.motion.fps })
        .collect();
    tell(progress, Event::Stage { name: "stiffness" })?;
    let wish = Wish { young: ask.young, poisson: POISSON, density: DENSITY, ..Wish::default() };
    let learnt = {
        let mut go_on = |done: f64| tell(progress, Event::Step { done, loss: None }).map_err(|_| FitError::Stopped);
        learn(solved, &ask.settings, &wish, &watched, &mut go_on)?
    };
    tell(progress, Event::Stage { name: "soft tissue" })?;
    let tissue = Tissue::new(solved, &learnt.settings)?;
    let dense = if std::ptr::eq(asset, solved) { None } else { Some(Tissue::new(asset, &learnt.settings)?) };
    let tissues = (&tissue, dense.as_ref());
    let clips = filmed.iter().zip(&mut stages).map(|(f, s)| clip(tissues, &learnt, s, f.motion, ask.solve, progress));
    Ok((clips.collect::<Result<_, _>>()?, material(solved, &learnt)))
}

fn clip(
    (tissue, dense): (&Tissue, Option<&Tissue>),
    learnt: &Learnt,
    stage: &mut Stage,
    motion: &Motion,
    solve: bool,
    progress: &mut Progress,
) -> Result<Outcome, Error> {
    let mut go_on = || tell(progress, Event::Step { done: 1.0, loss: None }).map_err(|_| FitError::Stopped);
    let (asset, material) = (tissue.asset, learnt.elasticity(tissue));
    let skinned = learn::skinned(asset, &motion.poses);
    let mut turn = |stage: &mut Stage, share: &[f64], rounds: usize, rival: Option<f64>| {
        let turns = Turns { share, rounds: if solve { rounds } else { 0 }, rival };
        together(tissue, &material, stage, (&motion.poses, motion.fps), turns, &mut go_on)
    };
    // All of it soft first: which groups the frames then explain by it; then poses for those soft and the others skinned.
    let first = turn(stage, &vec![1.0; asset.mesh.positions.len()], ROUNDS[0], None)?;
    let mut verdict = judge(asset, &learnt.groups, stage, &skinned, &first.surfaces);
    let soft: Vec<bool> = verdict.by_group.iter().map(|[skinned, soft]| no_worse(skinned, soft)).collect();
    let asked = soft.contains(&true);
    let rival = Some(verdict.frames[0].iter().sum());
    let last = if asked { turn(stage, &shares(asset, learnt, &soft), ROUNDS[1], rival)? } else { first.clone() };
    let posed = Motion { poses: last.poses.clone(), ..motion.clone() };
    let made = |tissue: &Tissue, share: bool| -> Result<(Softened, Vec<Vec<DVec3>>), Error> {
        let mut made = body::soften(tissue, &learnt.elasticity(tissue), &Stepping::default(), &posed)?;
        let all = made.soft.clone();
        if share {
            blend(&made.skinned, &mut made.soft, &shares(tissue.asset, learnt, &soft));
        }
        // What the result is held against is stage 1's own surface, and its keys are the clip's.
        made.skinned = learn::skinned(tissue.asset, &motion.poses);
        made.motion = motion.clone();
        made.uncross(tissue);
        Ok((made, all))
    };
    let (mut softened, mut shown) = made(tissue, asked)?;
    verdict.frames[1] = energies(stage, &softened.soft);
    let mut kept = asked && better(&verdict.frames[0], &verdict.frames[1]);
    let mut again = None;
    if kept && solve {
        // Poses solved once more explain any frames better: softness has to beat skinning with as much search.
        let skin = turn(stage, &vec![0.0; asset.mesh.positions.len()], ROUNDS[1], rival)?.frames;
        kept = better(&skin, &verdict.frames[1]);
        again = Some(skin);
    }
    if let Some(dense) = dense {
        (softened, shown) = made(dense, asked)?;
    }
    let mut report = softened.to_json(dense.unwrap_or(tissue).asset.mesh.diagonal());
    if kept {
        shown.clone_from(&softened.soft);
    } else {
        softened.soft.clone_from(&softened.skinned);
    }
    report["energy_rounds_soft"] = first.energies.into();
    report["energy_rounds"] = last.energies.into();
    words(&mut report, asset, learnt, (&verdict, again.as_deref()), &soft, kept);
    Ok(Outcome { softened, shown, kept, report })
}

/// What the frames said, beside what the simulation did.
fn words(
    report: &mut Value,
    asset: &Asset,
    learnt: &Learnt,
    (verdict, again): (&Verdict, Option<&[f64]>),
    soft: &[bool],
    kept: bool,
) {
    let name = |g: usize| asset.rig.skeleton.joints[learnt.groups.joints[g]].name.clone();
    let held: Vec<String> = (0..soft.len()).filter(|&g| !soft[g]).map(name).collect();
    let [skinned, last] = &verdict.frames;
    let rival = again.unwrap_or(skinned);
    let [before, after, other] = [skinned, last, rival].map(|frames| frames.iter().sum::<f64>());
    let percent = |per_frame: f64| 100.0 * per_frame * last.len() as f64 / other.max(f64::MIN_POSITIVE);
    let [change, noise] = difference(rival, last).map(percent);
    report["kept"] = kept.into();
    report["energy_skinned"] = before.into();
    report["energy_soft"] = after.into();
    report["energy_skinned_again"] = again.map(|_| other).into();
    report["energy_change_percent"] = change.into();
    report["energy_change_error_percent"] = noise.into();
    report["skinned_by_evidence"] = held.into();
    report["verdict"] = if kept {
        format!("soft: it shows the video better, with {:.1} ± {noise:.1} % less that is unlike it", -change)
    } else if soft.contains(&true) {
        let effort = if again.is_some() { " than by skinning with as much search" } else { "" };
        format!(
            "skinned: soft tissue would not clearly show the video better{effort} (what is unlike it changes by {change:+.1} ± {noise:.1} %)"
        )
    } else {
        "skinned: the frames speak against softness everywhere".into()
    }
    .into();
}

/// Share of softness of each vertex: what of its weight belongs to groups that stay soft.
fn shares(asset: &Asset, learnt: &Learnt, soft: &[bool]) -> Vec<f64> {
    let skin = &asset.rig.skin;
    let stays = |slot: u32| soft[learnt.groups.of_joint[skin.slots[slot as usize].joint] as usize];
    let one = |i: &Vec<animimic_scene::Influence>| -> f64 {
        i.iter().filter(|i| stays(i.slot)).map(|i| i.weight).sum::<f64>().clamp(0.0, 1.0)
    };
    skin.influences.iter().map(one).collect()
}

/// What was learnt, by group of flesh.
fn material(asset: &Asset, learnt: &Learnt) -> Value {
    let joints = &asset.rig.skeleton.joints;
    let group = |g: usize| {
        let own = (0..joints.len()).filter(|&j| learnt.groups.of_joint[j] as usize == g);
        json!({
            "group": joints[learnt.groups.joints[g]].name, "cluster": learnt.clusters[g],
            "joints": own.map(|j| joints[j].name.as_str()).collect::<Vec<_>>(),
            "young": learnt.ln_youngs[g].exp(), "ln_young_deviation": learnt.deviations[g],
            "learnt": learnt.deviations[g] < LEARNT * learnt.wish.deviation,
        })
    };
    json!({
        "prior_young": learnt.wish.young, "prior_ln_deviation": learnt.wish.deviation,
        "size_m": learnt.settings.size_m, "tets": learnt.settings.tets, "roots_held": learnt.settings.held_roots,
        "loose": learnt.settings.loose.iter().map(|&j| joints[j].name.as_str()).collect::<Vec<_>>(),
        "clusters": count(&learnt.clusters),
        "groups": (0..learnt.groups.joints.len()).map(group).collect::<Vec<_>>(),
        "energy_first": learnt.energies[0], "energy_last": learnt.energies[1],
    })
}
