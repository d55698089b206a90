//! Pictures in which one limb moves and all else stays: what stays is drawn once.

use super::sight::{Studio, drawn_over};
use super::subject::Subject;
use animimic_render::{Part, Parts, Raster, rasterize_surface, shade};
use animimic_rig::Posed;
use animimic_rig::anchor::Share;
use animimic_rig::limbs::Limb;
use animimic_scene::Image;
use glam::DVec3;

/// The model in two parts: a limb, and the rest.
pub struct Layers {
    parts: Parts,
}

/// One part of the model drawn.
pub struct Layer {
    raster: Raster,
    image: Image,
}

impl Layers {
    /// Parts a model by what hangs on a limb's first lever.
    pub fn new(subject: &Subject, limb: &Limb) -> Self {
        let kinematics = &subject.tree.kinematics;
        let hangs = |s: &Share| limb.levers.first().is_some_and(|&top| kinematics.is_ancestor(top, s.joint));
        Self { parts: Parts::new(&subject.surface, |v| subject.vertices[v].shares.iter().any(hangs)) }
    }

    /// Draws what the limb does not move.
    pub fn still(&self, subject: &Subject, studio: &Studio, background: &Image, posed: &Posed) -> Layer {
        layer(&self.parts.still, subject, studio, background, posed)
    }

    /// Draws what the limb moves.
    pub fn moving(&self, subject: &Subject, studio: &Studio, background: &Image, posed: &Posed) -> Layer {
        layer(&self.parts.moving, subject, studio, background, posed)
    }

    /// What a pixel of both shows: the model's colour, or none.
    pub fn color(&self, pixel: usize, moving: &Layer, still: &Layer) -> Option<[u8; 3]> {
        if self.parts.shows_moving(pixel, &moving.raster, &still.raster) {
            Some(moving.image.rgb[pixel])
        } else {
            still.raster.covered(pixel).then(|| still.image.rgb[pixel])
        }
    }
}

fn layer(part: &Part, subject: &Subject, studio: &Studio, background: &Image, posed: &Posed) -> Layer {
    let x: Vec<DVec3> = part.vertices.iter().map(|&v| subject.vertices[v].position(posed)).collect();
    let raster = rasterize_surface(studio.camera, &part.surface, &x, false);
    let rgb = shade(studio.camera, &part.surface, &x, &raster, studio.light, [0.0; 3], false);
    Layer { image: drawn_over(background, &raster, &rgb), raster }
}
