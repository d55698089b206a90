//! Antialiased pictures for people, and their coverage.
//!
//! Supersampled and averaged in encoded values, as a browser's multisampling resolves them; so pictures of ours and of
//! three.js differ by rounding, not by policy, at silhouettes.

use crate::light::Light;
use crate::raster::{NONE, Raster};
use crate::shade::{rasterize_surface, shade};
use crate::surface::Surface;
use animimic_scene::{Camera, Image, Mask};
use glam::DVec3;
use rayon::prelude::*;

/// What is behind the model.
#[derive(Clone, Copy, Debug)]
pub enum Background<'a> {
    /// One sRGB colour.
    Color([u8; 3]),
    /// A picture of the camera's size; another size is treated as white.
    Picture(&'a Image),
}

/// Draws a surface at `positions` with `samples` × `samples` samples a pixel: the picture over `background`, and the
/// model's coverage. Rows are shared among threads; the same bytes for any number of them.
///
/// # Panics
/// When `positions` does not have the surface's number of vertices.
pub fn render_image(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    light: &Light,
    background: Background,
    samples: u32,
) -> (Image, Mask) {
    let samples = samples.max(1);
    let fine = camera.resized(camera.width * samples, camera.height * samples);
    let raster = rasterize_surface(&fine, surface, positions, true);
    let rgb = shade(&fine, surface, positions, &raster, light, [0.0; 3], true);
    resolve(&raster, &rgb, samples as usize, background)
}

fn resolve(raster: &Raster, rgb: &[[f32; 3]], samples: usize, background: Background) -> (Image, Mask) {
    let (width, height) = (raster.width / samples, raster.height / samples);
    let behind = |pixel: usize| match background {
        Background::Color(c) => c,
        Background::Picture(i) if (i.width, i.height) == (width, height) => i.rgb[pixel],
        Background::Picture(_) => [255; 3],
    };
    let per_pixel = (samples * samples) as f32;
    let (rgb, coverage) = (0..width * height)
        .into_par_iter()
        .map(|pixel| {
            let (x, y) = (pixel % width * samples, pixel / width * samples);
            let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
            for row in y..y + samples {
                for at in row * raster.width + x..row * raster.width + x + samples {
                    if raster.triangle[at] != NONE {
                        (0..3).for_each(|c| sum[c] += rgb[at][c]);
                        count += 1.0;
                    }
                }
            }
            let share = count / per_pixel;
            let back = behind(pixel);
            let out = [0, 1, 2].map(|c| byte(sum[c] / per_pixel + (1.0 - share) * f32::from(back[c]) / 255.0));
            (out, byte(share))
        })
        .unzip();
    (Image { width, height, rgb }, Mask { width, height, coverage })
}

/// \[0, 1\] → 0–255, rounded.
pub(crate) fn byte(v: f32) -> u8 {
    (v * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{blob, painted};

    #[test]
    fn coverage_has_the_area_of_the_silhouette_and_pictures_do_not_depend_on_threads() {
        let mesh = blob(40, 30);
        let surface = Surface::new(&mesh, &[painted(64)]).expect("the fixture is sound");
        let camera = Camera::orbit(DVec3::ZERO, 4.0, 0.4, 0.2, 0.7, 61, 47);
        let draw = |samples| {
            render_image(&camera, &surface, &mesh.positions, &Light::default(), Background::Color([217; 3]), samples)
        };
        let area = |mask: &Mask| mask.coverage.iter().map(|&c| f64::from(c)).sum::<f64>() / 255.0;
        let (coarse, fine) = (area(&draw(4).1), area(&draw(16).1));
        println!("area at 4x4 samples {coarse:.2}, at 16x16 {fine:.2}");
        assert!((coarse / fine - 1.0).abs() < 2e-3);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
        assert!(one.install(|| draw(3)) == draw(3));
        assert_eq!(draw(2).0.at(0, 0), [217; 3]);
    }
}
