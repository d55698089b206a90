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
