//! What the model looks like in a pose: the synthesis half of analysis by synthesis.

use super::subject::Subject;
use animimic_render::{Light, NONE, Raster, rasterize_surface, shade};
use animimic_rig::{Anchor, FramePose, Posed};
use animimic_scene::{Camera, Image};
use glam::DVec3;

/// The model drawn in one pose.
pub struct Sight {
    /// Forward kinematics of the pose.
    pub posed: Posed,
    /// Vertices [model unit].
    pub surface: Vec<DVec3>,
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
        Self::draw_surface(subject, studio, background, posed, positions)
    }

    /// Draws a surface that need not be where the skin of the pose has it.
    pub fn draw_surface(
        subject: &Subject,
        studio: &Studio,
        background: &Image,
        posed: Posed,
        surface: Vec<DVec3>,
    ) -> Self {
        let raster = rasterize_surface(studio.camera, &subject.surface, &surface, false);
        let rgb = shade(studio.camera, &subject.surface, &surface, &raster, studio.light, [0.0; 3], false);
        Self { posed, image: drawn_over(background, &raster, &rgb), surface, raster }
    }

    /// The surface point seen at a covered pixel.
    pub fn point(&self, subject: &Subject, pixel: usize) -> Point {
        let corners = subject.surface.triangles[self.raster.triangle[pixel] as usize];
        Point { corners, weights: self.raster.weights(pixel).map(f64::from) }
    }

    /// The same as it moves with the skin.
    pub fn anchor(&self, subject: &Subject, pixel: usize) -> Anchor {
        self.point(subject, pixel).anchor(subject)
    }
}

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Vertices of its triangle.
    pub corners: [u32; 3],
    /// Its barycentric coordinates.
    pub weights: [f64; 3],
}

impl Point {
    /// How it moves with the skin.
    pub fn anchor(&self, subject: &Subject) -> Anchor {
        self.anchor_of(&subject.vertices)
    }

    /// How it moves with the anchors of all vertices.
    pub fn anchor_of(&self, vertices: &[Anchor]) -> Anchor {
        Anchor::blend(self.corners.map(|v| &vertices[v as usize]), self.weights)
    }

    /// Where it is on a surface.
    pub fn position(&self, surface: &[DVec3]) -> DVec3 {
        self.corners.iter().zip(self.weights).map(|(&v, b)| surface[v as usize] * b).sum()
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
