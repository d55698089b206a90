//! What a run says about itself: `report.json`.

use super::{Job, PartCertainty, Take, certainty};
use crate::{Evaluation, Physics};
use animimic_scene::{Asset, Mask, Motion, Skeleton};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Everything that a run found, fit for machines.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Program and version.
    pub program: String,
    /// The model's file name.
    pub model: String,
    /// Options that shaped the result.
    pub options: Value,
    /// Where the rig is from, in words.
    pub rig: String,
    /// Size of the model.
    pub size: Value,
    /// One entry per video.
    pub clips: Vec<ClipReport>,
    /// What was learnt of the flesh, by group of joints; null where soft tissue was not asked for.
    pub material: Value,
    /// How motion beyond the skeleton was delivered, and what that lost.
    pub physics: Value,
    /// What the readers had to mend or ignore.
    pub warnings: Vec<String>,
    /// Wall time of each stage [s]: the only part that differs between equal runs.
    pub timings: Value,
}

/// One clip.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ClipReport {
    /// Clip name in the GLB.
    pub name: String,
    /// Frames.
    pub frames: usize,
    /// Frames per second.
    pub fps: f64,
    /// Working size of the video, width and height [px].
    pub size_px: [usize; 2],
    /// Size of the video in its file [px].
    pub native_size_px: [usize; 2],
    /// Peak memory that finding the motion was estimated to take [MiB].
    pub memory_estimate_mib: u64,
    /// Statistics of the cues.
    pub cues: Value,
    /// Loss over iterations, by stage of the solver.
    pub losses: Vec<LossCurve>,
    /// Numbers of the metrics, of the skinned clip.
    pub metrics: Value,
    /// What became of the soft tissue, and why; null where it was not asked for.
    pub softness: Value,
    /// What the video left open, one sentence each.
    pub uncertain: Vec<String>,
    /// How well each part that moves surface is known; empty where that was not estimated.
    pub certainty: Vec<PartCertainty>,
}

/// The loss during one stage of the solver.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LossCurve {
    /// Stage.
    pub stage: String,
    /// Loss after each iteration.
    pub values: Vec<f64>,
}

impl LossCurve {
    pub(super) fn new(stage: &str, values: Vec<f64>) -> Self {
        Self { stage: stage.into(), values }
    }
}

/// Below this overlap of model and object in frame 0, the camera is in doubt.
const DOUBTFUL_CAMERA_IOU: f64 = 0.9;
/// A joint that turns farther from one frame to the next was taken for another or lost [rad].
const SNAP: f64 = 1.75;
/// Most of these that are told.
const MOST_SNAPS: usize = 3;
/// Below this, the mask provider doubts its background.
const DOUBTFUL_MASK: f32 = 0.5;

impl Report {
    pub(super) fn new(job: &Job, asset: &Asset, rig: String, clips: Vec<ClipReport>) -> Self {
        let mut options = serde_json::json!({
            "camera": job.camera.to_string(), "height_px": job.height_px, "seed": job.seed,
            "preset": job.preset.name(),
            "frames": job.frames.as_ref().map(|f| [f.start, f.end]),
        });
        if job.physics != Physics::default() {
            options["physics"] = job.physics.name().into();
        }
        let mesh = &asset.mesh;
        let size = serde_json::json!({
            "vertices": mesh.positions.len(), "welded_vertices": mesh.welded_count, "triangles": mesh.triangles.len(),
            "joints": asset.rig.skeleton.joints.len(), "diagonal": mesh.diagonal(),
        });
        let file_name = |p: &std::path::Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
        Self {
            program: concat!("animimic ", env!("CARGO_PKG_VERSION")).into(),
            model: file_name(&job.model).unwrap_or_default(),
            options,
            rig,
            size,
            clips,
            material: Value::Null,
            physics: Value::Null,
            warnings: asset.warnings.clone(),
            timings: Value::Null,
        }
    }
}

impl ClipReport {
    pub(super) fn new(take: &Take, skeleton: &Skeleton, evaluation: &Evaluation) -> Self {
        let frame = &take.video.frames[0];
        let certainty = certainty::named(skeleton, &take.certainty);
        let mut uncertain = take.uncertain.clone();
        uncertain.extend(certainty::doubt(&certainty, take.motion.fps));
        uncertain.extend(doubts(take, evaluation));
        uncertain.extend(snaps(&take.motion, skeleton));
        Self {
            name: take.name.clone(),
            frames: take.video.frames.len(),
            fps: take.motion.fps,
            size_px: [frame.width, frame.height],
            native_size_px: [take.video.native_size.0, take.video.native_size.1],
            memory_estimate_mib: take.memory_bytes >> 20,
            cues: cue_statistics(take),
            losses: take.losses.clone(),
            metrics: evaluation.to_json(),
            softness: take.softness.clone(),
            uncertain,
            certainty,
        }
    }
}

fn cue_statistics(take: &Take) -> Value {
    let areas: Vec<usize> = take.cues.masks.iter().map(Mask::area).collect();
    let residual = &take.background.residual;
    serde_json::json!({
        "mask_area_mean_px": areas.iter().sum::<usize>() as f64 / areas.len().max(1) as f64,
        "mask_area_min_px": areas.iter().min(),
        "mask_confidence_min": take.mask_confidence.iter().copied().fold(1.0, f32::min),
        "background_residual_max": residual.iter().copied().fold(0.0, f64::max),
    })
}

/// The joints that turn too far between two frames, each where it turns most, the worst first.
fn snaps(motion: &Motion, skeleton: &Skeleton) -> Vec<String> {
    let turn = |j: usize, t: usize| {
        let [a, b] = [t, t + 1].map(|t| motion.poses[t].locals[j].rotation);
        a.normalize().angle_between(b.normalize())
    };
    let worst = |j: usize| {
        let all = (0..motion.poses.len().saturating_sub(1)).map(|t| (turn(j, t), t));
        all.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(angle, t)| (angle, j, t))
    };
    let mut found: Vec<_> = (0..skeleton.joints.len()).filter_map(worst).filter(|w| w.0 > SNAP).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let words = |&(angle, j, t): &(f64, usize, usize)| {
        let (name, secs) = (&skeleton.joints[j].name, (t + 1) as f64 / motion.fps);
        format!("motion: {name} turns by {:.0}° from frame {t} to {} ({secs:.2} s)", angle.to_degrees(), t + 1)
    };
    found.iter().take(MOST_SNAPS).map(words).collect()
}

fn doubts(take: &Take, evaluation: &Evaluation) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(iou) = evaluation.get("iou_main_frame0").filter(|i| *i < DOUBTFUL_CAMERA_IOU) {
        out.push(format!(
            "frame 0: the model as it stands covers the object with an overlap of only {iou:.2}: the camera is wrong, or the clip \
             begins in another pose than the model's"
        ));
    }
    let weak = take.mask_confidence.iter().filter(|c| **c < DOUBTFUL_MASK).count();
    if weak > 0 {
        out.push(format!("masks: the background of {weak} frames is not plain, their outlines are in doubt"));
    }
    let empty = take.cues.masks.iter().filter(|m| m.area() == 0).count();
    if empty > 0 {
        out.push(format!("masks: no object was found in {empty} frames"));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::{Joint, Pose, Transform};
    use glam::DQuat;

    #[test]
    fn a_joint_that_snaps_is_told_with_its_frame_and_one_that_turns_steadily_is_not() {
        let joint = |name: &str| Joint { name: name.into(), parent: None, rest: Transform::IDENTITY, node: None };
        let skeleton = Skeleton { joints: vec![joint("hand"), joint("tail")] };
        let turned = |angle: f64| Transform { rotation: DQuat::from_rotation_x(angle), ..Transform::IDENTITY };
        let hand = [0.0, 0.1, 3.0, 3.1];
        let pose = |t: usize| Pose { locals: vec![turned(hand[t]), turned(1.5 * t as f64)] };
        let motion = Motion { name: "wave".into(), fps: 10.0, poses: (0..4).map(pose).collect() };
        assert_eq!(snaps(&motion, &skeleton), ["motion: hand turns by 166° from frame 1 to 2 (0.20 s)"]);
    }
}
