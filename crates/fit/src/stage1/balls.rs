//! Balls inside a model's parts, so that parts do not pass through each other.

use crate::terms::BallPair;
use animimic_rig::{Anchor, Share};
use glam::{DMat3, DVec3};

/// Balls along a part.
const PER_PART: usize = 3;
/// Parts with fewer vertices than this have no balls.
const FEWEST_VERTICES: usize = 6;
/// Radius as a share of the mean distance of a part's vertices from its long axis: flesh may give a little.
const RADIUS_SHARE: f64 = 0.4;

/// Balls and the pairs of them that keep apart.
#[derive(Clone, Debug, Default)]
pub struct Balls {
    /// Centres, each rigid to one joint.
    pub anchors: Vec<Anchor>,
    /// Pairs of parts that do not touch at rest; anchors index `anchors`.
    pub pairs: Vec<BallPair>,
}

impl Balls {
    /// Fills the geometry that follows each joint most. `vertices` and `positions` are of the mesh at rest.
    pub fn new(vertices: &[Anchor], positions: &[DVec3], joints: usize) -> Self {
        let mut of_joint: Vec<Vec<DVec3>> = vec![Vec::new(); joints];
        for (anchor, &x) in vertices.iter().zip(positions) {
            of_joint[anchor.main_joint()].push(x);
        }
        let balls: Vec<(usize, DVec3, f64)> = of_joint
            .iter()
            .enumerate()
            .filter(|(_, points)| points.len() >= FEWEST_VERTICES)
            .flat_map(|(j, points)| inside(points).into_iter().map(move |(center, radius)| (j, center, radius)))
            .collect();
        let anchors = balls
            .iter()
            .map(|&(joint, center, _)| Anchor { shares: vec![Share { joint, weight: 1.0, weighted_rest: center }] })
            .collect();
        let mut pairs = Vec::new();
        for (i, a) in balls.iter().enumerate() {
            for (k, b) in balls.iter().enumerate().skip(i + 1) {
                let clearance = a.2 + b.2;
                if a.0 != b.0 && a.1.distance(b.1) > clearance {
                    pairs.push(BallPair { anchors: [i as u32, k as u32], clearance });
                }
            }
        }
        Self { anchors, pairs }
    }
}

/// Balls along the long axis of a cloud of points: (centre, radius).
fn inside(points: &[DVec3]) -> Vec<(DVec3, f64)> {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let covariance = points.iter().fold(DMat3::ZERO, |m, &p| {
        let d = p - mean;
        m + DMat3::from_cols(d * d.x, d * d.y, d * d.z)
    });
    let axis = long_axis(&covariance);
    let along = |p: DVec3| axis.dot(p - mean);
    let (low, high) = points.iter().fold((f64::MAX, f64::MIN), |(l, h), &p| (l.min(along(p)), h.max(along(p))));
    let slice = |p: DVec3| (((along(p) - low) / (high - low).max(1e-12) * PER_PART as f64) as usize).min(PER_PART - 1);
    (0..PER_PART)
        .filter_map(|k| {
            let part: Vec<DVec3> = points.iter().copied().filter(|&p| slice(p) == k).collect();
            let center = part.iter().sum::<DVec3>() / part.len().max(1) as f64;
            let radius =
                part.iter().map(|&p| (p - center).reject_from(axis).length()).sum::<f64>() / part.len().max(1) as f64;
            (part.len() >= 3).then_some((center, RADIUS_SHARE * radius))
        })
        .collect()
}

/// The direction in which a cloud of points extends most, by power iteration.
fn long_axis(covariance: &DMat3) -> DVec3 {
    // A start that is no symmetry axis of a body.
    let mut axis = DVec3::new(0.8, 0.5, 0.33);
    for _ in 0..POWER_STEPS {
        axis = (*covariance * axis).try_normalize().unwrap_or(axis);
    }
    axis.normalize()
}

/// Steps of the power iteration: the slices need no more.
const POWER_STEPS: usize = 30;

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a tube along y between two heights.
    fn tube(center: DVec3, radius: f64, low: f64, high: f64) -> Vec<DVec3> {
        let ring = |y: f64| (0..12).map(move |k| (y, f64::from(k) * std::f64::consts::TAU / 12.0));
        let points = (0..10).flat_map(|i| ring(low + (high - low) * f64::from(i) / 9.0));
        points.map(|(y, a)| center + DVec3::new(radius * a.cos(), y, radius * a.sin())).collect()
    }

    #[test]
    fn two_legs_keep_apart_and_a_thigh_may_touch_its_shin() {
        let parts = [
            tube(DVec3::ZERO, 0.1, 0.0, 1.0),
            tube(DVec3::X * 0.5, 0.1, 0.0, 1.0),
            tube(DVec3::ZERO, 0.1, -1.0, -0.01),
        ];
        let positions: Vec<DVec3> = parts.iter().flatten().copied().collect();
        let anchors: Vec<Anchor> = parts
            .iter()
            .enumerate()
            .flat_map(|(joint, p)| p.iter().map(move |&x| (joint, x)))
            .map(|(joint, x)| Anchor { shares: vec![Share { joint, weight: 1.0, weighted_rest: x }] })
            .collect();
        let balls = Balls::new(&anchors, &positions, 3);
        assert_eq!(balls.anchors.len(), 3 * PER_PART);
        let joints = |p: &BallPair| p.anchors.map(|a| balls.anchors[a as usize].shares[0].joint);
        let legs = balls.pairs.iter().filter(|p| joints(p) == [0, 1]).count();
        assert_eq!(legs, PER_PART * PER_PART);
        for pair in &balls.pairs {
            assert!((pair.clearance - 2.0 * RADIUS_SHARE * 0.1).abs() < 1e-6, "{}", pair.clearance);
        }
    }
}
