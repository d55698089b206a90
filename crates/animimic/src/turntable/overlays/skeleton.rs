use super::{Overlay, Seen};
use animimic_render::overlay::{disc, line};
use animimic_scene::{Camera, Image, Rig};
use glam::{DVec2, DVec3};

const BONE: [u8; 3] = [30, 70, 200];
const JOINT: [u8; 3] = [200, 40, 40];
/// Drawn under bones and joints, so that they are seen on any colour.
const HALO: [u8; 3] = [250, 250, 250];
/// Height of pictures in which a bone is [`BONE_PX`] wide [px].
const NORMAL_PX: f64 = 384.0;
const BONE_PX: f64 = 1.6;
const JOINT_PX: f64 = 2.6;

/// Bones and joints in front of the model.
pub struct Bones;

impl Overlay for Bones {
    fn name(&self) -> &'static str {
        "skeleton"
    }

    fn summary(&self) -> &'static str {
        "bones (blue) and joints (red) in front of the model"
    }

    fn paint(&self, picture: &mut Image, seen: &Seen) {
        draw_bones(picture, seen.camera, &seen.asset.rig, seen.joints);
    }
}

/// Draws a skeleton whose joints are at `joints`, over whatever the picture shows.
///
/// Joints above all that carry skin, which only say where the model stands, are left out.
pub(crate) fn draw_bones(picture: &mut Image, camera: &Camera, rig: &Rig, joints: &[DVec3]) {
    let scale = (picture.height as f64 / NORMAL_PX).max(0.5);
    let all = &rig.skeleton.joints;
    let mut carries = vec![false; all.len()];
    rig.skin.slots.iter().for_each(|s| carries[s.joint] = true);
    let body = |j: usize| std::iter::successors(Some(j), |&j| all[j].parent).any(|j| carries[j]);
    let place = |j: usize| -> Option<DVec2> {
        let seen = camera.to_view(joints[j]);
        (seen.z > 0.0 && body(j)).then(|| camera.pixel_from_view(seen))
    };
    let screen: Vec<Option<DVec2>> = (0..all.len()).map(place).collect();
    for (color, more) in [(HALO, 1.0), (BONE, 0.0)] {
        for (to, joint) in screen.iter().zip(all) {
            if let Some((from, to)) = joint.parent.and_then(|p| screen[p]).zip(*to) {
                line(picture, from, to, (BONE_PX + 1.5 * more) * scale, color, 1.0);
            }
        }
    }
    for (color, more) in [(HALO, 0.8), (JOINT, 0.0)] {
        screen.iter().flatten().for_each(|&p| disc(picture, p, (JOINT_PX + more) * scale, color, 1.0));
    }
}
