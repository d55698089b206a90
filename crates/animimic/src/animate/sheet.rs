//! Videos and contact sheets of a take.

use super::Take;
use super::residual::heat_map;
use crate::camera::{keep_in_view, side_views};
use crate::pictures::{Studio, background_picture, border_color};
use crate::turntable::overlays::draw_bones;
use animimic_render::overlay;
use animimic_scene::{Asset, Camera, Image, Pose};
use glam::DVec3;

/// Moments at which side views have to see the whole model.
const LOOKS: usize = 12;
/// Columns of the contact sheet.
const COLUMNS: usize = 8;
/// Width of a cell of the contact sheet [px].
const CELL_PX: usize = 256;
const OUTLINE: [u8; 3] = [255, 60, 90];
const INK: [u8; 3] = [40, 40, 48];

/// A take with everything needed to draw it.
pub struct Stage<'a> {
    asset: &'a Asset,
    take: &'a Take,
    studio: Studio,
    background: [u8; 3],
    sides: [Camera; 2],
}

impl<'a> Stage<'a> {
    /// Solves the light and places the side cameras.
    pub fn new(asset: &'a Asset, take: &'a Take) -> Result<Self, crate::Error> {
        let first = posed(asset, &take.motion.poses[0]);
        let (camera, video) = (&take.camera.main, &take.video.frames[0]);
        let studio = Studio::new(asset, camera, &first, video, take.cues.masks.first())?;
        let (low, high) = animimic_scene::mesh::bounds(&first);
        let sides = side_views(camera, take.camera.target.unwrap_or(0.5 * (low + high)));
        let step = take.motion.poses.len().div_ceil(LOOKS).max(1);
        let all: Vec<DVec3> = take.motion.poses.iter().step_by(step).flat_map(|p| posed(asset, p)).collect();
        let sides = sides.map(|side| keep_in_view(&side, &all));
        Ok(Self { asset, take, studio, background: border_color(video), sides })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.take.video.frames.len().min(self.take.motion.poses.len())
    }

    /// Video, result and both side views of frame `t`, side by side, labelled; where soft tissue was asked for, the skinned
    /// surface stands beside the soft one, also where the frames did not speak for it.
    pub fn views(&self, t: usize) -> Image {
        let video = &self.take.video.frames[t];
        let result = self.surface(t);
        let main = &self.take.camera.main;
        let draw = |camera: &Camera, x: &[DVec3]| self.studio.draw(camera, x, self.background).0;
        let mut panels = vec![("video", video.clone())];
        if let Some(soft) = self.take.soft.get(t) {
            let skinned = posed(self.asset, &self.take.motion.poses[t]);
            let label = if self.take.soft_kept { "soft" } else { "soft (not kept)" };
            panels.extend([("skinning", draw(main, &skinned)), (label, draw(main, soft))]);
        } else {
            panels.push(("result", draw(main, &result)));
        }
        panels.extend([("-45", draw(&self.sides[0], &result)), ("+45", draw(&self.sides[1], &result))]);
        let mut out = Image::filled(panels.len() * video.width, video.height, self.background);
        for (k, (label, panel)) in panels.iter().enumerate() {
            overlay::paste(&mut out, panel, k * video.width, 0);
            overlay::text(&mut out, k * video.width + 8, 8, label, 1, INK);
        }
        out
    }

    /// Where result and video disagree in frame `t`.
    pub fn residuals(&self, t: usize) -> Image {
        let video = &self.take.video.frames[t];
        let behind = background_picture(&self.take.background, video, t);
        let x = self.surface(t);
        let (drawn, coverage) = self.studio.draw_over(&self.take.camera.main, &x, &behind);
        heat_map(video, &self.take.cues.masks[t], &drawn, &coverage)
    }

    /// Eight frames in three rows: video, result, and the result's outline and bones over the video.
    pub fn contact_sheet(&self) -> Image {
        let frames = self.frames();
        let size = (self.take.video.frames[0].width, self.take.video.frames[0].height);
        let cell = (CELL_PX, (CELL_PX * size.1).div_ceil(size.0));
        let mut out = Image::filled(COLUMNS * cell.0, 3 * cell.1, self.background);
        for column in 0..COLUMNS {
            let t = column * (frames - 1) / (COLUMNS - 1);
            let pose = &self.take.motion.poses[t];
            let x = self.surface(t);
            let (result, coverage) = self.studio.draw(&self.take.camera.main, &x, self.background);
            let mut traced = self.take.video.frames[t].clone();
            overlay::contour(&mut traced, &coverage, OUTLINE);
            let rig = &self.asset.rig;
            let joints: Vec<DVec3> =
                rig.skeleton.world_from_joint(&pose.locals).iter().map(|w| w.translation).collect();
            draw_bones(&mut traced, &self.take.camera.main, rig, &joints);
            for (row, picture) in [&self.take.video.frames[t], &result, &traced].into_iter().enumerate() {
                overlay::paste(&mut out, &picture.resized(cell.0, cell.1), column * cell.0, row * cell.1);
            }
            overlay::text(
                &mut out,
                column * cell.0 + 6,
                6,
                &format!("{:.2} s", t as f64 / self.take.motion.fps),
                1,
                INK,
            );
        }
        out
    }

    /// The surface that was found: the soft one where there is one.
    fn surface(&self, t: usize) -> Vec<DVec3> {
        if self.take.soft_kept { self.take.soft[t].clone() } else { posed(self.asset, &self.take.motion.poses[t]) }
    }
}

fn posed(asset: &Asset, pose: &Pose) -> Vec<DVec3> {
    asset.rig.in_pose(pose)
}
