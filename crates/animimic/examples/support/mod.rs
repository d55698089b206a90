//! A recorded case, read and made ready for stage 1.

use animimic::camera;
use animimic::cues::{Given, find, refine_masks};
use animimic::pictures::{background_picture, silhouette};
use animimic_fit::stage1::Input;
use animimic_scene::{Asset, Camera, Image, Mask, Video, io};
use animimic_video::flow::{FlowOptions, Gray, dis};
use std::error::Error;
use std::path::Path;

const HEIGHT_PX: usize = 512;

/// A folder with `static.glb`, `video.mp4` and `camera.json`.
pub struct Case {
    pub name: String,
    pub asset: Asset,
    pub video: Video,
    pub camera: Camera,
    pub masks: Vec<Mask>,
    pub backgrounds: Vec<Image>,
}

impl Case {
    /// Reads up to `frames` frames, finds masks and background.
    pub fn read(folder: &Path, frames: usize) -> Result<Self, Box<dyn Error>> {
        let asset = io::read(folder.join("static.glb"))?;
        let options = animimic_video::ReadOptions {
            working_height: Some(HEIGHT_PX),
            frames: Some(0..frames),
            ..Default::default()
        };
        let video = animimic_video::read(&folder.join("video.mp4"), &options)?;
        let mut found = find(&video, &Given::default())?;
        let (w, h) = (video.frames[0].width as u32, video.frames[0].height as u32);
        let camera = camera::from_file(&folder.join("camera.json"), w, h)?.main;
        let rest = asset.rig.at_rest();
        refine_masks(&video, &silhouette(&camera, &asset.mesh, &rest), &mut found)?;
        let backgrounds =
            video.frames.iter().enumerate().map(|(t, frame)| background_picture(&found.background, frame, t)).collect();
        let name = folder.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        Ok(Self { name, asset, camera, masks: found.cues.masks, backgrounds, video })
    }

    /// What stage 1 looks at.
    pub fn input(&self) -> Input<'_> {
        Input {
            asset: &self.asset,
            camera: &self.camera,
            frames: &self.video.frames,
            masks: &self.masks,
            backgrounds: &self.backgrounds,
            flow: &flow,
            tracks: None,
            depth: &[],
            depth_kind: Default::default(),
        }
    }
}

fn flow(from: &Image, to: &Image) -> Vec<[f32; 2]> {
    dis(&Gray::from_image(from), &Gray::from_image(to), &FlowOptions::default()).vectors
}
