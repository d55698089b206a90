//! RigNet's measures of how near two skeletons are (Xu et al. 2020, §6.1): Chamfer distances of joints and bones.
//!
//! Only joints that carry weight count. A bone leads from the nearest such ancestor to a joint. Percentages are of the longest side
//! of the rest bounding box.

use super::{Evidence, Metric, Missing, Reading, mean};
use animimic_scene::Rig;
use animimic_scene::mesh::bounds;
use glam::DVec3;

/// The metric.
pub struct SkeletonDistance;

/// Weights up to this do not count as moving anything (stored weights are rounded to 1/255 at the coarsest).
const LEAST_WEIGHT: f64 = 1e-3;

/// Points along a bone, [longest side] apart.
const SAMPLE: f64 = 0.002;

impl Metric for SkeletonDistance {
    fn name(&self) -> &'static str {
        "skeleton"
    }

    fn definition(&self) -> &'static str {
        "CD-J2J, CD-J2B, CD-B2B between the rests of result and truth, deforming joints only, in % of the longest side (RigNet)"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let truth = e.need_truth()?;
        let still = truth.still.as_ref().ok_or(Missing("the truth has no rigged still model"))?;
        let (lo, hi) = bounds(&still.mesh.positions);
        let pair = [Bones::new(&e.asset.rig), Bones::new(&still.rig)];
        if pair.iter().any(|b| b.joints.is_empty()) {
            return Err(Missing("a skeleton moves nothing"));
        }
        let [j2j, j2b, b2b] = distances(&pair[0], &pair[1], (hi - lo).max_element());
        Ok(vec![("cd_j2j_pct".into(), j2j), ("cd_j2b_pct".into(), j2b), ("cd_b2b_pct".into(), b2b)])
    }
}

/// The joints of a rig at rest that carry weight, and the bones between them.
#[derive(Clone, Debug, Default)]
pub struct Bones {
    /// World positions [model unit].
    pub joints: Vec<DVec3>,
    /// Ends of bones; where no joint has another above it, each is a bone of no length.
    pub bones: Vec<[DVec3; 2]>,
}

impl Bones {
    /// Reads them off a rig.
    pub fn new(rig: &Rig) -> Self {
        let mut moves = vec![false; rig.skeleton.joints.len()];
        for i in rig.skin.influences.iter().flatten().filter(|i| i.weight > LEAST_WEIGHT) {
            moves[rig.skin.slots[i.slot as usize].joint] = true;
        }
        let world = rig.skeleton.rest_world();
        let at = |j: usize| world[j].translation;
        let above = |j: usize| {
            let mut up = rig.skeleton.joints[j].parent;
            while let Some(p) = up.filter(|&p| !moves[p]) {
                up = rig.skeleton.joints[p].parent;
            }
            up
        };
        let live: Vec<usize> = (0..world.len()).filter(|&j| moves[j]).collect();
        let joints: Vec<DVec3> = live.iter().map(|&j| at(j)).collect();
        let mut bones: Vec<[DVec3; 2]> = live.iter().filter_map(|&j| above(j).map(|p| [at(p), at(j)])).collect();
        if bones.is_empty() {
            bones = joints.iter().map(|&p| [p, p]).collect();
        }
        Self { joints, bones }
    }

    fn to_bones(&self, p: DVec3) -> f64 {
        let distance = |[a, b]: &[DVec3; 2]| {
            let d = *b - *a;
            let s = ((p - *a).dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            p.distance(*a + s * d)
        };
        self.bones.iter().map(distance).fold(f64::INFINITY, f64::min)
    }

    fn to_joints(&self, p: DVec3) -> f64 {
        self.joints.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min)
    }

    fn samples(&self, step: f64) -> Vec<DVec3> {
        let along = |&[a, b]: &[DVec3; 2]| {
            let n = (a.distance(b) / step).ceil().max(1.0) as usize;
            (0..=n).map(move |k| a.lerp(b, k as f64 / n as f64))
        };
        self.bones.iter().flat_map(along).collect()
    }
}

/// CD-J2J, CD-J2B and CD-B2B in % of `longest` [model unit]: means of nearest distances, both ways, averaged.
pub fn distances(a: &Bones, b: &Bones, longest: f64) -> [f64; 3] {
    let percent = 100.0 / longest;
    let step = SAMPLE * longest;
    let both = |forth: f64, back: f64| 0.5 * (forth + back) * percent;
    let j2j = both(mean(a.joints.iter().map(|&p| b.to_joints(p))), mean(b.joints.iter().map(|&p| a.to_joints(p))));
    let j2b = both(mean(a.joints.iter().map(|&p| b.to_bones(p))), mean(b.joints.iter().map(|&p| a.to_bones(p))));
    let b2b = both(
        mean(a.samples(step).into_iter().map(|p| b.to_bones(p))),
        mean(b.samples(step).into_iter().map(|p| a.to_bones(p))),
    );
    [j2j, j2b, b2b]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_parallel_bones_are_their_distance_apart_and_a_shift_along_them_shows_in_joints_alone() {
        let bone =
            |shift: DVec3| Bones { joints: vec![shift, shift + DVec3::X], bones: vec![[shift, shift + DVec3::X]] };
        let beside = distances(&bone(DVec3::ZERO), &bone(DVec3::Y * 0.1), 2.0);
        let along = distances(&bone(DVec3::ZERO), &bone(DVec3::X * 0.2), 2.0);
        println!("beside {beside:.3?}, along {along:.3?}");
        assert!(beside.iter().all(|d| (d - 5.0).abs() < 1e-9));
        // One joint of each lies on the other's bone, one 0.2 outside of it.
        assert!((along[0] - 10.0).abs() < 1e-9 && (along[1] - 5.0).abs() < 1e-9);
        // The fifth that sticks out is 0.1 away on average.
        assert!((along[2] - 100.0 * 0.2 * 0.1 / 2.0).abs() < 0.02);
    }
}
