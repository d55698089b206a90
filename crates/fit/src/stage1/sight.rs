//! What the model looks like in a pose: the synthesis half of analysis by synthesis.

use super::subject::Subject;
use animimic_render::{Light, NONE, Raster, rasterize_surface, shade};
use animimic_rig::{Anchor, FramePose, Posed};
use animimic_scene::{Camera, Image};

/// The model drawn in one pose.
pub struct Sight {
    /// Forward kinematics of the pose.
    pub posed: Posed,
    /// Which triangle each pixel shows.
    pub raster: Raster,
    /// The picture over the video's background.
    pub image: Image,
}

/// How the model is drawn.
#[derive(Clone, Copy)]
pub struct Studio<'a> {
    /// The video's camera at working size.
    pub camera: &'a Camera,
    /// Light solved from frame 0.
    pub light: &'a Light,
}

impl Sight {
    /// Draws the subject in a pose over a background.
    pub fn draw(subject: &Subject, studio: &Studio, background: &Image, pose: &FramePose) -> Self {
        let posed = subject.posed(pose);
        let positions = subject.skinned(&posed);
        let raster = rasterize_surface(studio.camera, &subject.surface, &positions, false);
        let rgb = shade(studio.camera, &subject.surface, &positions, &raster, studio.light, [0.0; 3], false);
        Self { posed, image: drawn_over(background, &raster, &rgb), raster }
    }

    /// The surface point seen at a covered pixel.
    pub fn anchor(&self, subject: &Subject, pixel: usize) -> Anchor {
        let corners = subject.surface.triangles[self.raster.triangle[pixel] as usize];
        let weights = self.raster.weights(pixel).map(f64::from);
        Anchor::blend(corners.map(|v| &subject.vertices[v as usize]), weights)
    }
}

/// Shaded pixels where the raster is covered, the background elsewhere.
pub(crate) fn drawn_over(background: &Image, raster: &Raster, rgb: &[[f32; 3]]) -> Image {
    let mut image = background.clone();
    for (pixel, color) in rgb.iter().enumerate() {
        if raster.triangle[pixel] != NONE {
            image.rgb[pixel] = color.map(|c| (c * 255.0 + 0.5) as u8);
        }
    }
    image
}
