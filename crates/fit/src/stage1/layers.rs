//! Pictures in which one limb moves and all else stays: what stays is drawn once.

use super::sight::{Studio, drawn_over};
use super::subject::Subject;
use animimic_render::{Part, Parts, Raster, rasterize_surface, shade};
use animimic_rig::limbs::Limb;
use animimic_rig::{Anchor, Posed};
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
    /// Parts a surface by what hangs on a limb's first lever; `above` says whether a joint is another one or above it.
    pub fn new(
        surface: &animimic_render::Surface,
        vertices: &[Anchor],
        limb: &Limb,
        above: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let top = limb.levers.first().copied();
        let moves = |v: usize| top.is_some_and(|top| vertices[v].shares.iter().any(|s| above(top, s.joint)));
        Self { parts: Parts::new(surface, moves) }
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
    let x: Vec<DVec3> = part.vertices.iter().map(|&v| subject.vertices[v as usize].position(posed)).collect();
    let raster = rasterize_surface(studio.camera, &part.surface, &x, false);
    let rgb = shade(studio.camera, &part.surface, &x, &raster, studio.light, [0.0; 3], false);
    Layer { image: drawn_over(background, &raster, &rgb), raster }
}
