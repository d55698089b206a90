//! Limbs and hinges, read off the rest pose.
//!
//! A limb is a chain of joints from below a branching to a tip. Where it is bent at rest, it bends on in the same plane:
//! the normal of that plane is its hinge axis (a knee, an elbow, a hock). Only limbs that come in pairs hinge: a neck or a
//! tail that is bent at rest turns to all sides.

use crate::kinematics::Kinematics;
use glam::DVec3;

/// A chain of joints that can be swung as a whole.
#[derive(Clone, Debug)]
pub struct Limb {
    /// Joints from the body outwards.
    pub joints: Vec<usize>,
    /// Those of `joints` that carry a bone long enough to be seen turning.
    pub levers: Vec<usize>,
    /// Where the last bone ends at rest [model unit].
    pub tip: DVec3,
    /// Axis about which the limb bends, world axes at rest; `None` for a straight limb and for one without a partner.
    pub hinge: Option<DVec3>,
}

/// Bones shorter than this turn without being seen [rest diagonal].
const SHORTEST_LEVER: f64 = 0.04;
/// A chain is bent where directions differ by more than this [rad].
const LEAST_BEND_RAD: f64 = 0.2;
/// A chain whose side branch is longer than this share of the way to it is a trunk.
const TRUNK_SHARE: f64 = 0.6;
/// Lengths of a pair of limbs differ by less than this share.
const PARTNER_TOLERANCE: f64 = 0.2;
/// A pair of limbs lies this far apart [rest diagonal].
const BESIDE: f64 = 0.02;

/// All limbs. `tips` are the farthest surface points of each joint's own geometry, used as the end of the last bone.
pub fn limbs(kinematics: &Kinematics, tips: &[DVec3], diagonal: f64) -> Vec<Limb> {
    let children = children(kinematics);
    let reach = reaches(kinematics, tips, &children);
    let mut limbs = Vec::new();
    for top in 0..kinematics.len() {
        let Some(parent) = kinematics.parents[top] else { continue };
        if children[parent].len() < 2 && kinematics.parents[parent].is_some() {
            continue;
        }
        let Some(joints) = chain(kinematics, top, &children, &reach) else { continue };
        let ends: Vec<DVec3> =
            joints[1..].iter().map(|&j| kinematics.pivots[j]).chain(joints.last().map(|&j| tips[j])).collect();
        let bone = |k: usize| ends[k] - kinematics.pivots[joints[k]];
        let levers: Vec<usize> =
            (0..joints.len()).filter(|&k| bone(k).length() > SHORTEST_LEVER * diagonal).map(|k| joints[k]).collect();
        if levers.is_empty() {
            continue;
        }
        let hinge = hinge(&(0..joints.len()).map(bone).collect::<Vec<_>>(), diagonal);
        limbs.push(Limb { joints, levers, tip: ends[ends.len() - 1], hinge });
    }
    let paired: Vec<bool> = (0..limbs.len()).map(|i| has_partner(kinematics, &limbs, &reach, i, diagonal)).collect();
    for (limb, paired) in limbs.iter_mut().zip(paired) {
        limb.hinge = limb.hinge.filter(|_| paired);
    }
    limbs
}

/// Whether another bent limb of the same build lies elsewhere: legs and arms come in pairs, a neck or a tail does not.
fn has_partner(kinematics: &Kinematics, limbs: &[Limb], reach: &[f64], i: usize, diagonal: f64) -> bool {
    let center = |l: &Limb| l.levers.iter().map(|&j| kinematics.pivots[j]).sum::<DVec3>() / l.levers.len() as f64;
    let alike = |a: f64, b: f64| (a - b).abs() < PARTNER_TOLERANCE * a.max(b);
    let this = &limbs[i];
    limbs.iter().enumerate().any(|(k, other)| {
        k != i
            && other.hinge.is_some()
            && other.joints.len() == this.joints.len()
            && alike(reach[other.joints[0]], reach[this.joints[0]])
            && center(other).distance(center(this)) > BESIDE * diagonal
    })
}

/// The joints from `top` along the longest way to a tip; `None` where the chain forks into parts that are long themselves: that
/// is a trunk, not a limb. (A hand forks too, into fingers short beside the arm.)
fn chain(kinematics: &Kinematics, top: usize, children: &[Vec<usize>], reach: &[f64]) -> Option<Vec<usize>> {
    let mut joints = vec![top];
    let mut length = 0.0;
    loop {
        let at = joints[joints.len() - 1];
        let mut next = children[at].clone();
        next.sort_by(|a, b| reach[*b].total_cmp(&reach[*a]));
        let Some(&longest) = next.first() else { return Some(joints) };
        length += kinematics.pivots[at].distance(kinematics.pivots[longest]);
        if next.get(1).is_some_and(|&second| reach[second] > TRUNK_SHARE * length) {
            return None;
        }
        joints.push(longest);
    }
}

/// Normal of the plane in which a chain of bones is bent: the sum of consecutive cross products, all turned to one side.
fn hinge(bones: &[DVec3], diagonal: f64) -> Option<DVec3> {
    let long: Vec<DVec3> = bones.iter().copied().filter(|b| b.length() > SHORTEST_LEVER * diagonal).collect();
    let bends: Vec<DVec3> = long.windows(2).map(|w| w[0].normalize().cross(w[1].normalize())).collect();
    let largest = bends.iter().copied().max_by(|a, b| a.length().total_cmp(&b.length()))?;
    if largest.length() < LEAST_BEND_RAD.sin() {
        return None;
    }
    let sum: DVec3 = bends.iter().map(|b| if b.dot(largest) < 0.0 { -*b } else { *b }).sum();
    sum.try_normalize()
}

/// Child joints of every joint.
pub fn children(kinematics: &Kinematics) -> Vec<Vec<usize>> {
    let mut children = vec![Vec::new(); kinematics.len()];
    for (j, parent) in kinematics.parents.iter().enumerate() {
        if let Some(p) = parent {
            children[*p].push(j);
        }
    }
    children
}

/// Longest way from each joint to a tip below it.
fn reaches(kinematics: &Kinematics, tips: &[DVec3], children: &[Vec<usize>]) -> Vec<f64> {
    let mut reach: Vec<f64> = (0..kinematics.len()).map(|j| kinematics.pivots[j].distance(tips[j])).collect();
    for j in (0..kinematics.len()).rev() {
        for &c in &children[j] {
            reach[j] = reach[j].max(kinematics.pivots[j].distance(kinematics.pivots[c]) + reach[c]);
        }
    }
    reach
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_leg_hinges_about_the_normal_of_its_plane_and_a_tail_or_a_neck_does_not() {
        let pivots = vec![
            DVec3::ZERO,
            DVec3::new(0.2, 0.0, 0.0),
            DVec3::new(0.2, -0.5, 0.2),
            DVec3::new(0.2, -1.0, -0.1),
            DVec3::new(0.0, 0.0, -0.3),
            DVec3::new(0.0, 0.0, -0.8),
            DVec3::new(0.0, 0.3, 0.5),
            DVec3::new(0.0, 0.8, 0.5),
            DVec3::new(-0.2, 0.0, 0.0),
            DVec3::new(-0.2, -0.5, 0.2),
            DVec3::new(-0.2, -1.0, -0.1),
        ];
        let parents: Vec<Option<usize>> =
            [None, Some(0), Some(1), Some(2), Some(0), Some(4), Some(0), Some(6), Some(0), Some(8), Some(9)].into();
        let mut tips: Vec<DVec3> = pivots.iter().map(|p| *p + DVec3::new(0.0, 0.0, -0.01)).collect();
        tips[7] = DVec3::new(0.0, 0.8, 1.0);
        let tree = Kinematics::new(parents, pivots, vec![true; 11], vec![false; 11]);
        let found = limbs(&tree, &tips, 1.5);
        assert_eq!(
            found.iter().map(|l| l.joints.clone()).collect::<Vec<_>>(),
            [vec![1, 2, 3], vec![4, 5], vec![6, 7], vec![8, 9, 10]]
        );
        assert!(found[0].hinge.expect("bent").x.abs() > 0.99);
        assert!(found[1].hinge.is_none());
        assert!(found[2].hinge.is_none(), "a bent neck turns to all sides");
    }
}
