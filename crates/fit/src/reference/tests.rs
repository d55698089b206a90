use super::*;
use crate::fixtures::{FRAMES, with_video};
use animimic_math::gradcheck::SplitMix64;
use animimic_render::Light;

fn with_loss(work: impl FnOnce(&Loss, &[FramePose])) {
    with_video(|input, subject, truth| {
        let (kinematics, light) = (free(&subject.tree.kinematics), Light::ambient(1.0));
        work(&Loss::new(input, subject, &kinematics, &light), truth);
    });
}

#[test]
fn the_total_loss_has_the_right_gradient_and_is_least_near_the_truth() {
    with_loss(|loss, truth| {
        let kinematics = loss.kinematics();
        let mut rng = SplitMix64(2);
        let poses: Vec<FramePose> = truth
            .iter()
            .map(|p| {
                let step: Vec<f64> = (0..kinematics.dimension).map(|_| 0.05 * rng.normal()).collect();
                kinematics.retract(p, &step)
            })
            .collect();
        let (parts, gradients) = loss.with_gradient(&poses);
        assert!(loss.score(truth).total() < 0.5 * parts.total(), "{:?} {parts:?}", loss.score(truth));
        let direction: Vec<Vec<f64>> =
            gradients.iter().map(|g| g.iter().map(|v| v.signum() * (0.5 + rng.uniform())).collect()).collect();
        let along: f64 = gradients.iter().flatten().zip(direction.iter().flatten()).map(|(g, d)| g * d).sum();
        // The rendered parts jump from pixel to pixel: they are checked closely by themselves, and a few per cent are left here.
        let at = |h: f64| {
            let moved: Vec<FramePose> = poses
                .iter()
                .zip(&direction)
                .map(|(p, d)| kinematics.retract(p, &d.iter().map(|v| h * v).collect::<Vec<_>>()))
                .collect();
            loss.score(&moved).total()
        };
        let h = 2e-3;
        let numeric = (at(h) - at(-h)) / (2.0 * h);
        println!("{along:.4} {numeric:.4}: relative error {:.1e}", (along - numeric).abs() / numeric.abs());
        assert!((along - numeric).abs() < 3e-2 * numeric.abs());
    });
}

#[test]
fn the_recipe_goes_down_and_gives_the_same_bytes_for_any_number_of_threads() {
    with_loss(|loss, _| {
        let schedule = Schedule { alone: 10, together: 60 };
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| run(loss, FRAMES, &schedule, &mut |_, _| ControlFlow::Continue(()))).expect("not stopped")
        };
        let (one, three) = (with(1), with(3));
        let rest = loss.score(&vec![loss.kinematics().rest(); FRAMES]).total();
        let end = loss.score(&one.poses).total();
        println!("rest {rest:.4}, after the first phase {:.4}, at the end {end:.4}", one.losses[0]);
        assert_eq!(one.poses, three.poses);
        assert!(end < 0.9 * one.losses[0] && one.losses[0] < rest);
        assert!(run(loss, FRAMES, &schedule, &mut |_, _| ControlFlow::Break(())).is_err());
    });
}
