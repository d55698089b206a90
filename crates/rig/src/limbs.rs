//! Limbs and hinges, read off the rest pose.
//!
//! A limb is a chain of joints from below a branching to a tip. Where it is bent at rest, it bends on in the same plane:
//! the normal of that plane is its hinge axis (a knee, an elbow, a hock). Only limbs that come in pairs hinge: a neck or a
//! tail that is bent at rest turns to all sides. The axis about which most limbs bend, else the line between the joints of pairs, is the
//! body's sideways direction; a straight leg tells no plane of its own, but what stands on the ground swings fore and aft, about that.

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
    /// Axis about which the limb bends, world axes at rest; `None` for a straight limb and for one that does not come in pairs.
    pub hinge: Option<DVec3>,
    /// The limb of the same build beside this one, if each is the other's nearest.
    pub partner: Option<usize>,
    /// Ends on the ground: in the lowest part of the body.
    pub stands: bool,
}

/// Bones shorter than this turn without being seen [rest diagonal].
const SHORTEST_LEVER: f64 = 0.04;
/// A chain is bent where directions differ by more than this [rad].
const LEAST_BEND_RAD: f64 = 0.2;
/// A chain whose side branch is longer than this share of the way to it is a trunk.
const TRUNK_SHARE: f64 = 0.6;
/// Bones of a pair of limbs differ by less than this share of the limb's length, all together.
const PARTNER_TOLERANCE: f64 = 0.3;
/// Limbs of the same build reach as far as each other within this share.
const ALIKE: f64 = 0.2;
/// What the way between two limbs counts beside the difference of their bones.
const NEAR: f64 = 0.2;
/// A pair of limbs lies this far apart [rest diagonal].
const BESIDE: f64 = 0.02;
/// A limb stands if it ends in this lowest share of the body's height.
const GROUND: f64 = 0.3;
/// Pairs, and hinges, within this angle of each other agree (cosine of 30°).
const AGREEMENT: f64 = 0.866;
/// Limbs whose own hinge is within this of the body's sideways axis hinge about that axis (cosine of 45°).
const ALIGNED: f64 = 0.707;

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
        limbs.push(Limb { joints, levers, tip: ends[ends.len() - 1], hinge, partner: None, stands: false });
    }
    find_partners(kinematics, &mut limbs, None, diagonal);
    // A neck may be as long as the leg beside it: the direction in which most pairs lie tells them apart.
    if let Some(lateral) = lateral(kinematics, &limbs) {
        find_partners(kinematics, &mut limbs, Some(lateral), diagonal);
    }
    let heights = || tips.iter().chain(&kinematics.pivots).map(|p| p.y);
    let lowest = heights().fold(f64::INFINITY, f64::min);
    let highest = heights().fold(f64::NEG_INFINITY, f64::max);
    let paired: Vec<bool> = (0..limbs.len()).map(|i| comes_in_pairs(kinematics, &limbs, &reach, i, diagonal)).collect();
    for (limb, paired) in limbs.iter_mut().zip(paired) {
        limb.hinge = limb.hinge.filter(|_| paired);
        let foot = limb.joints.iter().map(|&j| kinematics.pivots[j].y).fold(limb.tip.y, f64::min);
        limb.stands = foot < lowest + GROUND * (highest - lowest);
    }
    limbs
}

/// Whether another bent limb of the same build lies elsewhere: legs and arms come in pairs, a neck or a tail does not.
fn comes_in_pairs(kinematics: &Kinematics, limbs: &[Limb], reach: &[f64], i: usize, diagonal: f64) -> bool {
    let center = |l: &Limb| l.levers.iter().map(|&j| kinematics.pivots[j]).sum::<DVec3>() / l.levers.len() as f64;
    let alike = |a: f64, b: f64| (a - b).abs() < ALIKE * a.max(b);
    let this = &limbs[i];
    limbs.iter().enumerate().any(|(k, other)| {
        k != i
            && other.hinge.is_some()
            && other.joints.len() == this.joints.len()
            && alike(reach[other.joints[0]], reach[this.joints[0]])
            && center(other).distance(center(this)) > BESIDE * diagonal
    })
}

/// The body's sideways direction: the axis about which most limbs bend, if at least two and half of them agree, else from hip to hip and
/// from shoulder to shoulder where most pairs agree.
pub fn lateral(kinematics: &Kinematics, limbs: &[Limb]) -> Option<DVec3> {
    let top = |l: &Limb| kinematics.pivots[l.joints[0]];
    let pairs = limbs.iter().enumerate().filter_map(|(i, l)| Some((l, &limbs[l.partner.filter(|&k| k > i)?])));
    let across: Vec<DVec3> = pairs.filter_map(|(a, b)| (top(a) - top(b)).try_normalize()).collect();
    let hinges: Vec<DVec3> = limbs.iter().filter_map(|l| l.hinge).collect();
    agreed(&hinges, 2).or_else(|| agreed(&across, 1))
}

/// Mean of those axes that agree with the one with which most do; `None` where fewer than `least` or than half of all agree.
fn agreed(axes: &[DVec3], least: usize) -> Option<DVec3> {
    let agreeing = |axis: DVec3| axes.iter().filter(move |h| h.dot(axis).abs() > AGREEMENT);
    // The first of the best, so that the order of limbs alone decides between equals.
    let best = axes.iter().copied().rev().max_by_key(|h| agreeing(*h).count())?;
    let sum: DVec3 = agreeing(best).map(|h| if h.dot(best) < 0.0 { -*h } else { *h }).sum();
    let count = agreeing(best).count();
    (count >= least && 2 * count >= axes.len()).then(|| sum.normalize())
}

/// Turns hinges to the sideways direction where they are near it: a leg that stands askew at rest still bends fore
/// and aft. Straight legs in pairs take it as theirs; an arm does not swing as its partner does.
pub fn align_hinges(kinematics: &Kinematics, limbs: &mut [Limb], lateral: DVec3) {
    for limb in limbs {
        let along = (limb.tip - kinematics.pivots[limb.joints[0]]).normalize_or_zero();
        let aligned = match limb.hinge {
            Some(hinge) => lateral.dot(hinge).abs() > ALIGNED,
            None => limb.partner.is_some() && limb.stands && along.dot(lateral).abs() < ALIGNED,
        };
        if aligned {
            limb.hinge = Some(lateral);
        }
    }
}

/// Pairs limbs of which each is the most like the other, beside it in the direction `lateral` if that is known: on the same joint, with as
/// many bones, as long, and near.
fn find_partners(kinematics: &Kinematics, limbs: &mut [Limb], lateral: Option<DVec3>, diagonal: f64) {
    let pivot = |j: usize| kinematics.pivots[j];
    let bones = |l: &Limb| l.joints.windows(2).map(|w| pivot(w[0]).distance(pivot(w[1]))).collect::<Vec<_>>();
    let ends = |l: &Limb| pivot(l.joints[l.joints.len() - 1]).distance(l.tip);
    let most_alike = |i: usize| {
        let a = &limbs[i];
        let own = bones(a);
        let whole = own.iter().sum::<f64>() + ends(a);
        let unlike = |b: &Limb| {
            let across = pivot(b.joints[0]) - pivot(a.joints[0]);
            let far = across.length();
            let beside = lateral.is_none_or(|l| l.dot(across).abs() > AGREEMENT * far);
            let differ: f64 = own.iter().zip(bones(b)).map(|(p, q)| (p - q).abs()).sum::<f64>();
            let fits = b.joints.len() == a.joints.len()
                && kinematics.parents[b.joints[0]] == kinematics.parents[a.joints[0]]
                && (ends(a) - ends(b)).abs() + differ < PARTNER_TOLERANCE * whole
                && far > BESIDE * diagonal
                && beside;
            fits.then_some(differ + NEAR * far)
        };
        let others = (0..limbs.len()).filter(|&k| k != i).filter_map(|k| Some((k, unlike(&limbs[k])?)));
        others.min_by(|p, q| p.1.total_cmp(&q.1)).map(|o| o.0)
    };
    let best: Vec<Option<usize>> = (0..limbs.len()).map(most_alike).collect();
    for (i, limb) in limbs.iter_mut().enumerate() {
        limb.partner = best[i].filter(|&k| best[k] == Some(i));
    }
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

    /// A body along z with four straight legs, of which one pair is in mid-stride, and a neck of as many bones.
    fn straight_legged() -> (Kinematics, Vec<DVec3>) {
        let mut parents = vec![None, Some(0)];
        let mut pivots = vec![DVec3::ZERO, DVec3::new(0.0, 0.0, 1.0)];
        let mut add = |parent: usize, places: [DVec3; 3]| {
            let first = pivots.len();
            parents.extend([Some(parent), Some(first), Some(first + 1)]);
            pivots.extend(places);
        };
        for x in [0.15, -0.15] {
            let leg = |z: f64, stride: f64| {
                [0.0, 0.4, 0.8].map(|s: f64| DVec3::new(x, -s * stride.cos(), z + s * stride.sin()))
            };
            add(0, leg(0.0, 0.0));
            add(1, leg(1.0, 2.0 * x));
        }
        add(1, [0.1, 0.5, 0.9].map(|s| DVec3::new(0.0, 0.0, 1.0 + s)));
        let mut tips = pivots.clone();
        for j in [4, 7, 10, 13] {
            tips[j] += DVec3::new(0.0, -0.15, 0.0);
        }
        let count = parents.len();
        (Kinematics::new(parents, pivots, vec![true; count], vec![false; count]), tips)
    }

    #[test]
    fn straight_legs_swing_about_the_line_from_hip_to_hip_and_a_neck_as_long_does_not() {
        let (tree, tips) = straight_legged();
        let mut found = limbs(&tree, &tips, 2.5);
        let lateral = lateral(&tree, &found).expect("two pairs agree");
        align_hinges(&tree, &mut found, lateral);
        println!("sideways {lateral}");
        for limb in &found {
            println!("{:?}: partner {:?}, hinge {:?}", limb.joints, limb.partner, limb.hinge);
        }
        assert!(lateral.x.abs() > 0.999);
        let hinged: Vec<usize> = found.iter().filter(|l| l.hinge == Some(lateral)).map(|l| l.joints[0]).collect();
        assert_eq!(hinged, [2, 5, 8, 11]);
        let neck = found.iter().find(|l| l.joints[0] == 14).expect("the neck is a limb");
        assert!(neck.hinge.is_none() && neck.partner.is_none());
    }
}
