//! The motion in the example's video: the creature starts to trot on the spot, looks around and flicks an ear; its tail swings along.

use animimic_scene::{Motion, Pose, Skeleton};
use glam::{DQuat, DVec3};
use std::f64::consts::TAU;

/// Steps a second of each leg.
const STEP_HZ: f64 = 1.25;
/// Time over which the motion sets in [s].
const ONSET_SECS: f64 = 0.5;

/// The clip; its first pose is the rest pose, because the motion sets in from 0.
pub fn motion(skeleton: &Skeleton, frames: usize, fps: f64) -> Motion {
    let poses = (0..frames).map(|t| pose(skeleton, t as f64 / fps)).collect();
    Motion { name: "trot".into(), fps, poses }
}

/// Another clip, for what several videos of one creature say together: it turns and sways on the spot.
pub fn sway(skeleton: &Skeleton, frames: usize, fps: f64) -> Motion {
    let pose = |t: usize| {
        let time_secs = t as f64 / fps;
        let (onset, wave) = (onset(time_secs), |hertz: f64| (TAU * hertz * time_secs).sin());
        let mut locals = skeleton.rest_locals();
        let hips = skeleton.joints.iter().position(|j| j.name == "hips").unwrap_or(0);
        locals[hips].rotation = DQuat::from_rotation_y(0.30 * onset * wave(0.8));
        locals[hips].translation += DVec3::new(0.06 * wave(1.1), 0.0, 0.0) * onset;
        Pose { locals }
    };
    Motion { name: "sway".into(), fps, poses: (0..frames).map(pose).collect() }
}

/// How far motion has set in, in [0, 1].
fn onset(time_secs: f64) -> f64 {
    let s = (time_secs / ONSET_SECS).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

fn pose(skeleton: &Skeleton, time_secs: f64) -> Pose {
    let onset = onset(time_secs);
    let phase = TAU * STEP_HZ * time_secs;
    let locals = skeleton
        .joints
        .iter()
        .map(|joint| {
            let mut local = joint.rest;
            let angles = angles(&joint.name, phase, time_secs) * onset;
            local.rotation =
                DQuat::from_rotation_y(angles.y) * DQuat::from_rotation_x(angles.x) * DQuat::from_rotation_z(angles.z);
            if joint.name == "hips" {
                let bob = DVec3::new(0.018 * phase.sin(), 0.028 * (1.0 - (2.0 * phase).cos()), 0.0);
                local.translation += bob * onset;
            }
            local
        })
        .collect();
    Pose { locals }
}

/// Rotation about x (nod), y (turn) and z (roll) of a joint [rad].
fn angles(name: &str, phase: f64, time_secs: f64) -> DVec3 {
    let look = (TAU * 0.42 * time_secs).sin();
    let v = DVec3::new;
    match name {
        "hips" => v(0.02 * (2.0 * phase).sin(), 0.14 * phase.sin(), 0.05 * phase.cos()),
        "spine" => v(0.03 * (2.0 * phase + 0.6).sin(), -0.10 * phase.sin(), 0.0),
        "chest" => v(-0.03 * (2.0 * phase).sin(), -0.06 * phase.sin(), -0.05 * phase.cos()),
        "neck" => v(-0.10 * look + 0.03 * (2.0 * phase + 1.0).sin(), 0.30 * look, 0.05 * look),
        "head" => v(0.08 * look + 0.05 * (2.0 * phase + 1.8).sin(), 0.34 * look, 0.12 * look),
        "ear_left_1" | "ear_right_1" => v(0.10 * (2.0 * phase + 2.6).sin(), 0.0, flick(name, time_secs)),
        "ear_left_2" | "ear_right_2" => v(0.16 * (2.0 * phase + 2.0).sin(), 0.0, 0.8 * flick(name, time_secs - 0.06)),
        // No muscle moves it.
        "tail" => DVec3::ZERO,
        _ => leg(name, phase),
    }
}

/// Diagonal legs step together: the foot lifts while the leg swings forward.
fn leg(name: &str, phase: f64) -> DVec3 {
    let own = if matches!(&name[..name.rfind('_').unwrap_or(0)], "front_left" | "hind_right") {
        phase
    } else {
        phase + TAU / 2.0
    };
    let (swing, lift) = (own.sin(), own.cos().max(0.0).powi(2));
    let bend = match name.rsplit('_').next() {
        Some("upper") => -0.34 * swing - 0.20 * lift,
        Some("lower") if name.starts_with("front") => 0.55 * lift,
        Some("lower") => 0.10 * swing + 0.50 * lift,
        Some("paw") if name.starts_with("front") => 0.18 * swing + 0.55 * lift,
        _ => 0.20 * swing - 0.35 * lift,
    };
    DVec3::new(bend, 0.0, 0.0)
}

/// The right ear flicks at 0.7 s, the left one at 1.4 s.
fn flick(name: &str, time_secs: f64) -> f64 {
    let (at, sign) = if name.contains("left") { (1.4, -1.0) } else { (0.7, 1.0) };
    let x = (time_secs - at) / 0.16;
    sign * 0.26 * (-x * x).exp()
}
