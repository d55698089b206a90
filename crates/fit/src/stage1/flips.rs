//! Depth flips: a bone that leans towards the camera looks almost like one that leans away by the same angle.
//!
//! While a limb swings through the image plane the two are one, and a fit that follows the frames in turn may come out on the
//! wrong side and stay there until the limb passes the plane again. So, with the motion known, the bones of a limb are
//! mirrored over whole stretches between such passages, solved again, and kept where the frames then look better
//! (kinematic jumps: Sminchisescu & Triggs, "Kinematic jump processes for monocular 3D human tracking", CVPR 2003).

use super::search::Small;
use super::solve::Stage;
use super::subject::Subject;
use animimic_rig::FramePose;
use animimic_rig::limbs::Limb;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use std::ops::Range;

/// A bone nearer to the image plane than this may pass it between two frames [rad].
const NEAR_PLANE_RAD: f64 = 0.35;
/// A stretch in which a bone leans less than this is not worth a flip [rad].
const LEAST_LEAN_RAD: f64 = 0.12;
/// A stretch that looks no more unlike than this many times frame 0 is right as it is.
const LOOKS_RIGHT: f64 = 1.15;
/// Frames of a stretch on which a flip is judged before it is solved.
const GLANCES: usize = 5;
/// A flip that looks worse than this many times the present pose before it is solved is not tried.
const HOPELESS: f64 = 1.35;
/// Flips solved, at most.
const MOST_TRIALS: usize = 12;

/// Some bones of a limb, mirrored over a stretch of frames.
#[derive(Clone, Debug)]
struct Flip {
    limb: usize,
    /// Range in the limb's levers.
    levers: Range<usize>,
    frames: Range<usize>,
}

impl Stage<'_> {
    /// Tries to mirror limbs in depth over stretches of frames that do not look right, and keeps what looks better.
    pub fn flip_limbs(&self, poses: &mut [FramePose]) {
        let mut kept: Vec<Flip> = Vec::new();
        let mut mismatches = self.mismatches(poses);
        for flip in self.promising(poses, &mismatches).into_iter().take(MOST_TRIALS) {
            if kept.iter().any(|k| k.limb == flip.limb && overlap(&k.frames, &flip.frames)) {
                continue;
            }
            let mut trial = poses.to_vec();
            flip.frames.clone().for_each(|t| trial[t] = self.flipped(&poses[t], &flip));
            if self.try_out(trial, flip.frames.clone(), poses, &mut mismatches) {
                kept.push(flip);
            }
        }
    }

    /// All flips that are not plainly wrong, the best looking first.
    fn promising(&self, poses: &[FramePose], mismatches: &[f64]) -> Vec<Flip> {
        let wrong = |r: &Range<usize>| {
            mismatches[r.clone()].iter().sum::<f64>() > LOOKS_RIGHT * self.usual_mismatch * r.len() as f64
        };
        let mut flips = Vec::new();
        for (limb, l) in self.subject.limbs.iter().enumerate() {
            for first in 0..l.levers.len() {
                let leans: Vec<f64> = poses.iter().map(|p| self.lean(p, l, first)).collect();
                for frames in stretches(&leans).into_iter().filter(wrong) {
                    flips.extend((first..l.levers.len()).map(|last| Flip {
                        limb,
                        levers: first..last + 1,
                        frames: frames.clone(),
                    }));
                }
            }
        }
        let small: Vec<Small> = self.frames.par_iter().map(|f| Small::new(f, self.studio.camera)).collect();
        let score = |t: usize, pose: &FramePose| small[t].score(self.subject, &self.studio, pose);
        let now: Vec<f64> = (0..poses.len()).into_par_iter().map(|t| score(t, &poses[t])).collect();
        let mut rated: Vec<(f64, Flip)> = flips
            .into_par_iter()
            .map(|flip| {
                let step = flip.frames.len().div_ceil(GLANCES);
                let glances = || flip.frames.clone().skip(step / 2).step_by(step);
                let there: f64 = glances().map(|t| score(t, &self.flipped(&poses[t], &flip))).sum();
                let here: f64 = glances().map(|t| now[t]).sum();
                (there / here.max(1e-9), flip)
            })
            .collect();
        rated.retain(|r| r.0 < HOPELESS);
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        rated.into_iter().map(|r| r.1).collect()
    }

    /// Angle between a lever and the image plane [rad], positive away from the camera.
    fn lean(&self, pose: &FramePose, limb: &Limb, lever: usize) -> f64 {
        let posed = self.subject.posed(pose);
        let j = limb.levers[lever];
        let from = posed.centers[j];
        let bone = posed.transforms[j].transform_point3(bone_end(self.subject, limb, lever)) - from;
        bone.normalize_or_zero().dot(self.ray(from)).clamp(-1.0, 1.0).asin()
    }

    /// Unit viewing ray to a point.
    fn ray(&self, point: DVec3) -> DVec3 {
        (point - self.studio.camera.view_from_world.inverse().translation).normalize()
    }

    /// A pose with a flip's bones mirrored in the plane across their viewing ray; bones after them keep their direction.
    fn flipped(&self, pose: &FramePose, flip: &Flip) -> FramePose {
        let (subject, kinematics) = (self.subject, &self.subject.tree.kinematics);
        let limb = &subject.limbs[flip.limb];
        let posed = subject.posed(pose);
        let mut world: Vec<DMat3> = posed.transforms.iter().map(|t| t.matrix3).collect();
        let mut turn = DMat3::IDENTITY;
        let mut moved = pose.clone();
        for &j in &limb.joints {
            if let Some(k) = limb.levers.iter().position(|&l| l == j) {
                turn = DMat3::IDENTITY;
                if flip.levers.contains(&k) {
                    let from = posed.centers[j];
                    let end = posed.transforms[j].transform_point3(bone_end(subject, limb, k));
                    let (bone, ray) = ((end - from).normalize_or_zero(), self.ray(from));
                    let mirrored = bone - 2.0 * bone.dot(ray) * ray;
                    turn = DMat3::from_quat(DQuat::from_rotation_arc(bone, mirrored));
                }
            }
            world[j] = turn * world[j];
            let parent = kinematics.parents[j].map_or(DMat3::IDENTITY, |p| world[p]);
            moved.rotations[j] = parent.transpose() * world[j];
        }
        moved
    }
}

/// Where a lever's bone ends at rest: at the next lever, or at the limb's tip.
fn bone_end(subject: &Subject, limb: &Limb, lever: usize) -> DVec3 {
    limb.levers.get(lever + 1).map_or(limb.tip, |&next| subject.tree.kinematics.pivots[next])
}

fn overlap(a: &Range<usize>, b: &Range<usize>) -> bool {
    a.start < b.end && b.start < a.end
}

/// Stretches of frames between possible passages of the image plane: where the lean changes sign, or is least near 0. Frame 0
/// is known and belongs to none.
fn stretches(leans: &[f64]) -> Vec<Range<usize>> {
    let n = leans.len();
    let passes = |t: usize| {
        let lean = leans[t].abs();
        leans[t] * leans[t - 1] < 0.0
            || (lean < NEAR_PLANE_RAD && lean <= leans[t - 1].abs() && t + 1 < n && lean < leans[t + 1].abs())
    };
    let cuts: Vec<usize> = [1].into_iter().chain((2..n).filter(|&t| passes(t))).chain([n]).collect();
    let worth = |r: &Range<usize>| leans[r.clone()].iter().any(|l| l.abs() > LEAST_LEAN_RAD);
    cuts.windows(2).map(|c| c[0]..c[1]).filter(|r| !r.is_empty() && worth(r)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::with_stage;

    #[test]
    fn a_flip_mirrors_its_bones_in_depth_keeps_the_others_and_undoes_itself() {
        with_stage(|stage, truth| {
            let subject = stage.subject;
            let pose = &truth[3];
            let mut mirrored = 0;
            for (limb, l) in subject.limbs.iter().enumerate() {
                for first in 0..l.levers.len() {
                    for last in first..l.levers.len() {
                        let flip = Flip { limb, levers: first..last + 1, frames: 3..4 };
                        let there = stage.flipped(pose, &flip);
                        let back = stage.flipped(&there, &flip);
                        let ends = |pose: &FramePose, k: usize| {
                            let posed = subject.posed(pose);
                            let j = l.levers[k];
                            posed.transforms[j].transform_point3(bone_end(subject, l, k)) - posed.centers[j]
                        };
                        // The first mirrored bone starts where it did: its viewing ray is the same, and its lean changes sign.
                        let (a, b) = (stage.lean(pose, l, first), stage.lean(&there, l, first));
                        println!("limb {limb} bones {first}..={last}: lean {a:.3} becomes {b:.3}");
                        assert!((a + b).abs() < 1e-9);
                        mirrored += usize::from(a.abs() > 0.05);
                        for k in (0..l.levers.len()).filter(|k| !flip.levers.contains(k)) {
                            assert!((ends(pose, k) - ends(&there, k)).length() < 1e-9, "bone {k} keeps its direction");
                        }
                        assert!((ends(pose, first) - ends(&back, first)).length() < 1e-9);
                    }
                }
            }
            assert!(mirrored > 0, "the pose leans");
        });
    }

    #[test]
    fn stretches_end_where_a_bone_crosses_the_image_plane_or_turns_back_before_it() {
        let leans: Vec<f64> = (0..40).map(|t| (0.3 * t as f64).cos()).collect();
        println!("{:?}", stretches(&leans));
        // Frames in the plane itself (5, 26) need no flip.
        assert_eq!(stretches(&leans), [1..5, 6..16, 16..26, 27..37, 37..40]);
        // Turns back without crossing.
        let leans: Vec<f64> = (0..40).map(|t| (0.15 * t as f64).cos().abs() + 0.01).collect();
        assert_eq!(stretches(&leans), [1..10, 10..31, 31..40]);
        // Far from the plane all along, and always within it.
        assert_eq!(stretches(&[0.8; 10]), [Range { start: 1, end: 10 }]);
        assert!(stretches(&[0.05; 10]).is_empty());
    }
}
