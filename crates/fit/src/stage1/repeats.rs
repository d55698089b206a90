//! Repeats: what a walk, a gallop or a fin does in one cycle it does again in the next.
//!
//! Where limbs cross fast they may be taken for each other in one cycle and be told apart in another. So a stretch of frames that
//! looks wrong is tried with the clip's own poses some frames earlier or later, wherever those look more like the video already;
//! that is solved, and kept where the frames then look better.

use super::search::Small;
use super::solve::Stage;
use animimic_rig::FramePose;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// A frame that looks more unlike than this many times what is usual in the clip is wrong.
const WRONG: f64 = 1.3;
/// What is usual: the mismatch that this share of the frames stays below.
const USUAL_SHARE: f64 = 0.25;
/// A stretch goes on over so many frames that look right.
const GAP: usize = 2;
/// A stretch is widened to where the mismatch is least, by so many frames to each side.
const WIDENED: usize = 3;
/// A pose so few frames away is much like the frame's own.
const LEAST_SHIFT: isize = 4;
/// A repeat must look better by this factor, before it is solved, to be tried.
const PROMISING: f64 = 0.97;
/// Repeats solved per stretch, at most.
const MOST_TRIALS: usize = 2;

/// Other poses for a stretch of frames, each from as many frames earlier or later, or as it was.
struct Repeat {
    poses: Vec<FramePose>,
    /// Mismatch of the stretch, summed, on small pictures.
    cost: f64,
}

impl Stage<'_> {
    /// Tries the clip's own poses from earlier and later over stretches of frames that look wrong, and keeps what looks better.
    pub fn repeat(&self, poses: &mut [FramePose]) {
        let mut mismatches = self.mismatches(poses);
        let centers: Vec<DVec3> = poses.iter().map(|p| self.center(p)).collect();
        for frames in stretches(&mismatches, self.usual_mismatch) {
            for repeat in self.promising_repeats(poses, &frames, &centers) {
                let mut trial = poses.to_vec();
                trial[frames.clone()].clone_from_slice(&repeat.poses);
                self.try_out(trial, frames.clone(), poses, &mut mismatches);
            }
        }
    }

    /// Repeats that look better than the present poses of a stretch, the best first.
    fn promising_repeats(&self, poses: &[FramePose], frames: &Range<usize>, centers: &[DVec3]) -> Vec<Repeat> {
        let small: Vec<Small> =
            frames.clone().into_par_iter().map(|t| Small::new(&self.frames[t], self.studio.camera)).collect();
        let score = |t: usize, pose: &FramePose| small[t - frames.start].score(self.subject, &self.studio, pose);
        let now: Vec<f64> = frames.clone().into_par_iter().map(|t| score(t, &poses[t])).collect();
        let farthest = poses.len() as isize - 1;
        let mut found: Vec<Repeat> = (-farthest..=farthest)
            .into_par_iter()
            .filter(|shift| shift.abs() >= LEAST_SHIFT)
            .map(|shift| {
                let drift = drift(centers, shift);
                let mut repeat = Repeat { poses: poses[frames.clone()].to_vec(), cost: 0.0 };
                for (t, (pose, &now)) in frames.clone().zip(repeat.poses.iter_mut().zip(&now)) {
                    repeat.cost += now;
                    let Some(there) = t.checked_add_signed(shift).and_then(|t| poses.get(t)) else { continue };
                    let there = self.moved(there, -drift);
                    let unlike = score(t, &there);
                    if unlike < now {
                        repeat.cost += unlike - now;
                        *pose = there;
                    }
                }
                repeat
            })
            .collect();
        let now: f64 = now.iter().sum();
        found.retain(|r| r.cost < PROMISING * now);
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        found.truncate(MOST_TRIALS);
        found
    }

    /// A pose with all that has no parent moved.
    fn moved(&self, pose: &FramePose, by: DVec3) -> FramePose {
        let mut moved = pose.clone();
        for (displacement, parent) in moved.displacements.iter_mut().zip(&self.subject.tree.kinematics.parents) {
            if parent.is_none() {
                *displacement += by;
            }
        }
        moved
    }

    /// Middle of the vertices in a pose [model unit].
    fn center(&self, pose: &FramePose) -> DVec3 {
        let vertices = self.subject.skinned(&self.subject.posed(pose));
        vertices.iter().sum::<DVec3>() / vertices.len().max(1) as f64
    }
}

/// How far the body gets in `shift` frames: the median over the clip, of each coordinate, which one cycle more or less does not change.
fn drift(centers: &[DVec3], shift: isize) -> DVec3 {
    let far = shift.unsigned_abs();
    let steps = |k: usize| -> f64 {
        let mut all: Vec<f64> = centers.iter().zip(&centers[far..]).map(|(a, b)| b[k] - a[k]).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    DVec3::from_array([0, 1, 2].map(steps)) * shift.signum() as f64
}

/// Stretches of frames that look wrong in a clip, with short gaps closed, widened to where the frames look best. Frame 0, which looks
/// as unlike as `least`, is known and belongs to none.
fn stretches(mismatches: &[f64], least: f64) -> Vec<Range<usize>> {
    let mut sorted = mismatches.to_vec();
    sorted.sort_by(f64::total_cmp);
    let limit = WRONG * sorted[(USUAL_SHARE * sorted.len() as f64) as usize].max(least);
    let mut found: Vec<Range<usize>> = Vec::new();
    for t in (1..mismatches.len()).filter(|&t| mismatches[t] > limit) {
        match found.last_mut().filter(|r| t <= r.end + GAP) {
            Some(r) => r.end = t + 1,
            None => found.push(t..t + 1),
        }
    }
    for r in &mut found {
        for _ in 0..WIDENED {
            if r.start > 1 && mismatches[r.start - 1] < mismatches[r.start] {
                r.start -= 1;
            }
            if r.end < mismatches.len() && mismatches[r.end] < mismatches[r.end - 1] {
                r.end += 1;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{with_stage, with_stage_of};
    use std::f64::consts::TAU;

    const PERIOD: usize = 10;
    const WAY: DVec3 = DVec3::new(0.02, 0.0, 0.01);

    #[test]
    fn a_stretch_that_went_wrong_is_mended_with_the_poses_of_another_cycle_also_where_the_body_travels() {
        let motion = |subject: &crate::stage1::subject::Subject| -> Vec<FramePose> {
            let tree = &subject.tree.kinematics;
            let cycle = |t: usize, i: usize| 0.1 * (TAU * t as f64 / PERIOD as f64).sin() * (1.7 * i as f64).sin();
            let turned =
                |t: usize| tree.retract(&tree.rest(), &(0..tree.dimension).map(|i| cycle(t, i)).collect::<Vec<_>>());
            (0..3 * PERIOD)
                .map(|t| {
                    let mut pose = turned(t);
                    (0..tree.len())
                        .filter(|&j| tree.parents[j].is_none())
                        .for_each(|j| pose.displacements[j] += WAY * t as f64);
                    pose
                })
                .collect()
        };
        with_stage_of(motion, |stage, truth| {
            let centers: Vec<DVec3> = truth.iter().map(|p| stage.center(p)).collect();
            let way = drift(&centers, -(PERIOD as isize));
            println!("in a cycle it travels {way}");
            assert!(way.abs_diff_eq(-WAY * PERIOD as f64, 1e-9));

            let mut poses = truth.to_vec();
            let lever = stage.subject.limbs[0].levers[0];
            for pose in &mut poses[11..15] {
                pose.rotations[lever] *= glam::DMat3::from_rotation_z(0.9);
            }
            let unlike = |poses: &[FramePose]| stage.mismatches(poses)[11..15].iter().sum::<f64>();
            let far = |poses: &[FramePose]| {
                (0..truth.len()).map(|t| stage.pose_distance(&poses[t], &truth[t])).fold(0.0, f64::max)
            };
            let before = (unlike(&poses), far(&poses));
            stage.repeat(&mut poses);
            let after = (unlike(&poses), far(&poses));
            println!(
                "mismatch {:.4} -> {:.4}, worst frame {:.4} -> {:.4} of the diagonal",
                before.0, after.0, before.1, after.1
            );
            assert!(after.0 < 0.1 * before.0 && after.1 < 0.3 * before.1);
        });
    }

    #[test]
    fn where_nothing_looks_wrong_nothing_changes() {
        with_stage(|stage, truth| {
            let mut poses = truth.to_vec();
            stage.repeat(&mut poses);
            assert_eq!(poses, truth);
        });
    }

    #[test]
    fn stretches_close_short_gaps_and_reach_to_the_best_frames_beside_them() {
        let looks = [1.0, 1.0, 1.1, 1.2, 3.0, 3.0, 1.4, 3.0, 1.2, 1.1, 1.1, 1.0, 1.0, 2.0, 2.0];
        println!("{:?}", stretches(&looks, 1.0));
        assert_eq!(stretches(&looks, 1.0), [1..10, 12..15]);
        assert!(stretches(&looks, 3.0).is_empty());
    }
}
