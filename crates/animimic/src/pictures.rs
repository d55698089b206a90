//! Pictures of results for people and for metrics.

use crate::Error;
use animimic_render::picture::Background;
use animimic_render::{Light, Surface, rasterize, rasterize_surface, render_image, solve_light};
use animimic_scene::{Asset, Camera, Image, Mask, Mesh};
use glam::DVec3;

/// Samples a pixel and axis of pictures for people.
const SAMPLES: u32 = 2;
/// Samples a pixel and axis of silhouettes that are measured.
const SILHOUETTE_SAMPLES: u32 = 4;

/// Coverage of the mesh, all faces drawn from both sides, no look applied.
pub fn silhouette(camera: &Camera, mesh: &Mesh, positions: &[DVec3]) -> Mask {
    let s = SILHOUETTE_SAMPLES as usize;
    let fine = camera.resized(camera.width * SILHOUETTE_SAMPLES, camera.height * SILHOUETTE_SAMPLES);
    let raster = rasterize(&fine, positions, &mesh.triangles);
    let (width, height) = (camera.width as usize, camera.height as usize);
    let coverage = (0..width * height)
        .map(|pixel| {
            let (x, y) = (pixel % width * s, pixel / width * s);
            let row = |r: usize| (y + r) * raster.width + x;
            let hits: usize = (0..s).map(|r| (row(r)..row(r) + s).filter(|&p| raster.covered(p)).count()).sum();
            ((hits * 255 + s * s / 2) / (s * s)) as u8
        })
        .collect();
    Mask { width, height, coverage }
}

/// Median colour of a picture's outermost pixels: the background of a plain video.
pub fn border_color(image: &Image) -> [u8; 3] {
    let (w, h) = (image.width, image.height);
    let border: Vec<[u8; 3]> = (0..w * h)
        .filter(|&i| {
            let (x, y) = (i % w, i / w);
            x == 0 || y == 0 || x + 1 == w || y + 1 == h
        })
        .map(|i| image.rgb[i])
        .collect();
    [0, 1, 2].map(|c| {
        let mut values: Vec<u8> = border.iter().map(|p| p[c]).collect();
        values.sort_unstable();
        values.get(values.len() / 2).copied().unwrap_or(255)
    })
}

/// The background that the mask provider found in frame `t`, as a picture.
pub fn background_picture(background: &animimic_video::cues::Background, frame: &Image, t: usize) -> Image {
    let byte = |v: f32| v.round().clamp(0.0, 255.0) as u8;
    let rgb = (0..frame.width * frame.height)
        .map(|i| background.at(frame, t, i % frame.width, i / frame.width).map(byte))
        .collect();
    Image { width: frame.width, height: frame.height, rgb }
}

/// A model ready to be drawn, with the light of the video.
pub struct Studio {
    surface: Surface,
    /// The light solved from frame 0, or a neutral one.
    pub light: Light,
}

impl Studio {
    /// Prepares the model and solves the light so that it looks as in `reference` at `positions`.
    ///
    /// # Errors
    /// [`Error::Render`] for meshes that cannot be drawn.
    pub fn new(
        asset: &Asset,
        camera: &Camera,
        positions: &[DVec3],
        reference: &Image,
        mask: Option<&Mask>,
    ) -> Result<Self, Error> {
        let surface = Surface::new(&asset.mesh, &asset.looks)?;
        let raster = rasterize_surface(camera, &surface, positions, true);
        // A model out of sight in frame 0 says nothing about light; a neutral one serves.
        let light = solve_light(camera, &surface, positions, &raster, reference, mask).unwrap_or_default();
        Ok(Self { surface, light })
    }

    /// The same under a given light.
    ///
    /// # Errors
    /// [`Error::Render`] for meshes that cannot be drawn.
    pub fn with_light(asset: &Asset, light: Light) -> Result<Self, Error> {
        Ok(Self { surface: Surface::new(&asset.mesh, &asset.looks)?, light })
    }

    /// A picture of the model over one colour, and its coverage.
    pub fn draw(&self, camera: &Camera, positions: &[DVec3], background: [u8; 3]) -> (Image, Mask) {
        render_image(camera, &self.surface, positions, &self.light, Background::Color(background), SAMPLES)
    }

    /// A picture of the model over another of the camera's size, and its coverage.
    pub fn draw_over(&self, camera: &Camera, positions: &[DVec3], behind: &Image) -> (Image, Mask) {
        render_image(camera, &self.surface, positions, &self.light, Background::Picture(behind), SAMPLES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_averages_and_the_border_colour_is_the_median() {
        let mut image = Image::filled(4, 4, [10, 20, 30]);
        image.rgb[5] = [250; 3];
        let small = image.resized(2, 2);
        assert_eq!(small.rgb[0], [70, 78, 85]);
        assert_eq!(small.rgb[3], [10, 20, 30]);
        assert_eq!(border_color(&image), [10, 20, 30]);
    }

    #[test]
    fn a_silhouette_has_the_projected_area() {
        let mesh = crate::metrics::fixtures::octahedron();
        let camera = Camera::orbit(DVec3::ZERO, 1000.0, 0.0, 0.0, 0.003, 100, 100);
        let area: f64 =
            silhouette(&camera, &mesh, &mesh.positions).coverage.iter().map(|&c| f64::from(c) / 255.0).sum();
        // Seen along z, the octahedron is a square of diagonal 2 at fx / 1000 pixels a unit.
        let expected = 2.0 * (camera.fx / 1000.0).powi(2);
        println!("{area} px, expected {expected}");
        assert!((area / expected - 1.0).abs() < 0.01);
    }
}
