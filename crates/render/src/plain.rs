//! Surfaces without light and texture: interpolated vertex colours, encoded, nothing else. The same results as the general path
//! ([`crate::shade`], [`crate::render`]) at half its cost.

use crate::interpolate::{DCorners, Weights};
use crate::project::ScreenPoint;
use crate::raster::{NONE, Raster};
use crate::srgb::{Encoder, encode_slope};
use crate::surface::Surface;

/// What the pixels of one triangle have in common.
struct PlainCorners {
    vertices: [usize; 3],
    /// Linear colours of the corners, emitted light included.
    color: [[f32; 3]; 3],
}

impl PlainCorners {
    #[inline(always)]
    fn new(surface: &Surface, id: u32) -> Self {
        let [a, b, c] = surface.triangles[id as usize];
        let vertices = [a as usize, b as usize, c as usize];
        let look = surface.look(id);
        let color = |v: usize| {
            let tint = if surface.colors.is_empty() { [1.0; 3] } else { surface.colors[v] };
            std::array::from_fn(|k| look.base[k] * tint[k] + look.emissive[k])
        };
        Self { vertices, color: [color(vertices[0]), color(vertices[1]), color(vertices[2])] }
    }

    #[inline(always)]
    fn at(&self, [b0, b1]: [f32; 2]) -> [f32; 3] {
        let b2 = 1.0 - b0 - b1;
        let c = &self.color;
        std::array::from_fn(|k| b0 * c[0][k] + b1 * c[1][k] + b2 * c[2][k])
    }
}

/// Colours of some rows, from the pixel `first` on.
pub(crate) fn shade_plain(surface: &Surface, raster: &Raster, first: usize, out: &mut [[f32; 3]]) {
    let encoder = Encoder::new();
    let mut current = (NONE, PlainCorners { vertices: [0; 3], color: [[0.0; 3]; 3] });
    let range = first..first + out.len();
    for ((out, &id), &b) in out.iter_mut().zip(&raster.triangle[range.clone()]).zip(&raster.bary[range]) {
        if id == NONE {
            continue;
        }
        if id != current.0 {
            current = (id, PlainCorners::new(surface, id));
        }
        *out = encoder.encode_rgb(current.1.at(b));
    }
}

/// Adjoint of [`shade_plain`] with the interpolation: adds to ∂L/∂screen points. `rgb` is the picture.
pub(crate) fn shade_plain_vjp(
    surface: &Surface,
    screen: &[ScreenPoint],
    raster: &Raster,
    rgb: &[[f32; 3]],
    d_rgb: &[[f32; 3]],
    d_screen: &mut [ScreenPoint],
) {
    let mut current = NONE;
    let mut corners = PlainCorners { vertices: [0; 3], color: [[0.0; 3]; 3] };
    let mut weights = None;
    let mut sums = DCorners::default();
    for (pixel, &id) in raster.triangle.iter().enumerate() {
        if id == NONE {
            continue;
        }
        if id != current {
            sums.flush(corners.vertices, d_screen);
            current = id;
            corners = PlainCorners::new(surface, id);
            let [a, b, c] = corners.vertices;
            weights = Weights::new([screen[a], screen[b], screen[c]]);
        }
        let Some(weights) = &weights else { continue };
        let [b0, b1] = raster.bary[pixel];
        let (linear, y, d) = (corners.at([b0, b1]), rgb[pixel], d_rgb[pixel]);
        let d_linear: [f32; 3] = std::array::from_fn(|k| d[k] * encode_slope(linear[k], y[k]));
        let d_b = corners.color.map(|c| c[0] * d_linear[0] + c[1] * d_linear[1] + c[2] * d_linear[2]);
        weights.at_vjp([b0, b1, 1.0 - b0 - b1], raster.inv_z[pixel], d_b, 0.0, &mut sums);
    }
    sums.flush(corners.vertices, d_screen);
}

#[cfg(test)]
mod tests {
    use crate::fixtures::blob;
    use crate::light::Light;
    use crate::render::{Cotangents, render, render_vjp};
    use crate::surface::Surface;
    use animimic_scene::{Camera, Look};
    use glam::DVec3;

    #[test]
    fn the_plain_path_and_the_general_one_agree() {
        let mut mesh = blob(30, 20);
        mesh.colors = mesh.positions.iter().map(|p| [0.5 + 0.4 * p.x as f32, 0.5, 0.5 - 0.4 * p.y as f32]).collect();
        let looks = [Look { unlit: true, emissive: [0.05, 0.0, 0.1], ..Look::default() }];
        let plain = Surface::new(&mesh, &looks).expect("the fixture is sound");
        assert!(plain.plain);
        let general = Surface { plain: false, ..plain.clone() };
        let camera = Camera::orbit(DVec3::ZERO, 3.5, 0.3, 0.4, 0.8, 64, 64);
        let light = Light::default();
        let d_rgb: Vec<[f32; 3]> = (0..64 * 64).map(|p| [1.0, -0.5 + 0.01 * (p % 64) as f32, 0.3]).collect();
        let d = Cotangents { rgb: &d_rgb, ..Cotangents::default() };
        let [a, b] = [&plain, &general].map(|surface| {
            let rendered = render(&camera, surface, &mesh.positions, &light, [1.0; 3]);
            let g = render_vjp(&camera, surface, &mesh.positions, &light, &rendered, &d, false);
            (rendered.rgb, g.positions)
        });
        let color = a.0.iter().flatten().zip(b.0.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let size = b.1.iter().map(|g| g.length()).fold(0.0, f64::max);
        let gradient = a.1.iter().zip(&b.1).map(|(a, b)| (*a - *b).length() / size).fold(0.0, f64::max);
        println!("largest difference: colour {color:.1e}, gradient {gradient:.1e} of the largest");
        assert!(color < 1e-6 && gradient < 1e-5);
    }
}
