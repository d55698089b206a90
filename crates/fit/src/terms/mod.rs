//! The family of terms: each compares a posed frame with what is known, as weighted squares of residuals.
//!
//! A term is one file and one word in [`NAMES`]. The test below loops over all of them through the assembled chain
//! (parameters → forward kinematics → skinning → projection → residual).

mod depth;
mod joint_prior;
mod penetration;
mod pixel;

pub use depth::{Depth, DepthTarget};
pub(crate) use depth::{reading, slope};
pub use joint_prior::{JointPrior, JointPriors};
pub use penetration::{BallPair, Penetration};
pub use pixel::{PixelTarget, Pixels};

use crate::normal::NormalEquations;
use animimic_rig::{Anchor, AnchorColumns, FramePose, Kinematics, Posed};
use animimic_scene::Camera;

/// Names of all terms, in the order in which they are listed.
pub const NAMES: &[&str] = &["pixels", "depth", "joint_prior", "penetration"];

/// What terms of one problem share.
pub struct Context<'a> {
    /// The tree.
    pub kinematics: &'a Kinematics,
    /// The camera of the video.
    pub camera: &'a Camera,
    /// Surface points that residuals refer to.
    pub anchors: &'a [Anchor],
    /// Their Jacobian structure.
    pub columns: &'a [AnchorColumns],
}

/// A frame at which terms are evaluated.
pub struct At<'a> {
    /// Frame number.
    pub frame: usize,
    /// The parameters.
    pub pose: &'a FramePose,
    /// Forward kinematics of `pose`.
    pub posed: &'a Posed,
}

/// A sum of robust squares over one frame.
pub trait Term: Sync {
    /// Name as in [`NAMES`].
    fn name(&self) -> &'static str;
    /// Energy at a frame.
    fn energy(&self, context: &Context, at: &At) -> f64;
    /// Adds the Gauss–Newton model of the energy to `normal`; its gradient is exact (half of dE).
    fn linearize(&self, context: &Context, at: &At, normal: &mut NormalEquations);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Robust;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};
    use animimic_math::so3;
    use animimic_rig::fixtures::{creature, creature_with_stray_weight};
    use animimic_rig::solve_tree::SolveTree;
    use animimic_scene::DepthKind;
    use glam::{DVec2, DVec3};

    const LOSSES: [Robust; 3] = [Robust::Squared, Robust::Huber(2.0), Robust::GemanMcClure(4.0)];

    /// Members of a term's family of settings; a term without one here fails the test.
    fn cases(name: &str, context: &Context, pose: &FramePose, rng: &mut SplitMix64) -> Vec<Box<dyn Term>> {
        let posed = context.kinematics.pose(pose);
        let at = |i: usize| context.anchors[i].position(&posed);
        let count = context.anchors.len();
        match name {
            "pixels" => {
                let targets: Vec<PixelTarget> = (0..count)
                    .map(|i| PixelTarget {
                        anchor: i as u32,
                        pixel: context.camera.project(at(i)) + DVec2::new(rng.normal(), rng.normal()) * 3.0,
                        weight: 0.2 + rng.uniform(),
                        normal: (i % 2 == 0).then(|| DVec2::from_angle(6.0 * rng.uniform())),
                    })
                    .collect();
                let of =
                    |robust| Box::new(Pixels { targets: vec![targets.clone()], robust, weight: 0.7 }) as Box<dyn Term>;
                LOSSES.map(of).into()
            }
            "depth" => {
                let mut targets = |scale: f64, shift: f64, power: i32| -> Vec<DepthTarget> {
                    (0..count)
                        .map(|i| DepthTarget {
                            anchor: i as u32,
                            depth: scale * context.camera.to_view(at(i)).z.powi(power) + shift + 0.1 * rng.normal(),
                            weight: 0.2 + rng.uniform(),
                        })
                        .collect()
                };
                let kinds = [
                    (targets(0.4, 0.3, 1), true, DepthKind::Metric),
                    (targets(1.0, 0.0, 1), false, DepthKind::Metric),
                    (targets(9.0, 0.3, -1), true, DepthKind::Inverse),
                ];
                let of = |robust, (targets, affine, kind): &(Vec<DepthTarget>, bool, DepthKind)| {
                    let targets = vec![targets.clone()];
                    Box::new(Depth { targets, sigma: 0.05, robust, weight: 0.7, affine: *affine, kind: *kind })
                        as Box<dyn Term>
                };
                LOSSES.iter().flat_map(|&robust| kinds.iter().map(move |k| of(robust, k))).collect()
            }
            "joint_prior" => {
                let mut any = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
                let mut prior = || JointPrior {
                    rotation: so3::exp(any() * 0.5),
                    stiffness: 2.0,
                    stiff_axes: [any(), DVec3::new(0.3, -0.2, 0.5)],
                    slide_axis: DVec3::new(0.4, 0.1, -0.7),
                    limit_rad: 0.3,
                    limit_stiffness: 5.0,
                    displacement: any() * 0.2,
                    slide_stiffness: 3.0,
                };
                vec![Box::new(JointPriors { joints: vec![(0..context.kinematics.len()).map(|_| prior()).collect()] })]
            }
            "penetration" => {
                let pairs: Vec<BallPair> = (0..count as u32 - 3)
                    .map(|i| BallPair {
                        anchors: [i, i + 3],
                        clearance: at(i as usize).distance(at(i as usize + 3)) * (0.7 + rng.uniform()),
                    })
                    .collect();
                vec![Box::new(Penetration { pairs: pairs.leak(), weight: 1.3 })]
            }
            _ => Vec::new(),
        }
    }

    /// Largest relative gradient error of a term at a pose, through the whole chain.
    fn error(term: &dyn Term, context: &Context, pose: &FramePose) -> f64 {
        let energy =
            |pose: &FramePose| term.energy(context, &At { frame: 0, pose, posed: &context.kinematics.pose(pose) });
        let mut normal = NormalEquations::zeros(context.kinematics.dimension);
        term.linearize(context, &At { frame: 0, pose, posed: &context.kinematics.pose(pose) }, &mut normal);
        let gradient: Vec<f64> = normal.gradient.iter().map(|g| 2.0 * g).collect();
        let f = |step: &[f64]| energy(&context.kinematics.retract(pose, step));
        gradient_error(f, &vec![0.0; gradient.len()], &gradient, 5, &[1e-3, 1e-4, 1e-5, 1e-6], 7)
    }

    #[test]
    fn every_term_has_an_exact_gradient_through_the_rig_driver() {
        for (rig, mesh) in [creature(), creature_with_stray_weight()] {
            let tree = SolveTree::new(&rig, &mesh);
            let vertices = tree.vertex_anchors(&rig);
            let anchors: Vec<Anchor> = (0..vertices.len() - 20)
                .step_by(7)
                .map(|i| Anchor::blend([i, i + 9, i + 20].map(|v| &vertices[v]), [0.2, 0.5, 0.3]))
                .collect();
            let columns: Vec<AnchorColumns> = anchors.iter().map(|a| a.columns(&tree.kinematics)).collect();
            let camera = Camera::orbit(DVec3::new(1.0, 0.6, 0.5), 6.0, 0.4, 0.2, 0.8, 320, 240);
            let context =
                Context { kinematics: &tree.kinematics, camera: &camera, anchors: &anchors, columns: &columns };
            let mut rng = SplitMix64(21);
            let step: Vec<f64> = (0..tree.kinematics.dimension).map(|_| 0.3 * rng.normal()).collect();
            let pose = tree.kinematics.retract(&tree.kinematics.rest(), &step);
            for &name in NAMES {
                let members = cases(name, &context, &pose, &mut rng);
                assert!(!members.is_empty(), "{name} has no case here");
                for (k, term) in members.iter().enumerate() {
                    assert_eq!(term.name(), name);
                    let error = error(term.as_ref(), &context, &pose);
                    println!("{name} {k}: relative error {error:.1e}");
                    assert!(error < 1e-6);
                }
            }
        }
    }
}
