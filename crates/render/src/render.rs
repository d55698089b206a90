//! The differentiable renderer: one picture of a posed surface, and the adjoint of the whole chain.
//!
//! Forward is exact and hard (no blur): project → rasterise → interpolate → texture → light → encode. Backward, a pixel's colour
//! changes with the pose in two ways, and each has its part:
//! 1. inside: what is seen slides and turns under the pixel (this file: colour → fragment → weights → screen points, normals);
//! 2. at edges: what is seen changes ([`crate::edges`]).
//!
//! Sums run in pixel order in one thread: the same bytes always. Frames are meant to run in parallel.

use crate::edges::edges_vjp;
use crate::interpolate::DCorners;
use crate::light::Light;
use crate::normals::{Normals, posed_normals, posed_normals_vjp};
use crate::plain::shade_plain_vjp;
use crate::project::{DCamera, ScreenPoint, project, project_vjp};
use crate::raster::{NONE, Raster};
use crate::shade::{Corners, Posed, ShadeAdjoint, rasterize_screen_into, shade_into};
use crate::surface::Surface;
use crate::texture::TexelAdjoint;
use animimic_scene::Camera;
use glam::DVec3;

/// A picture and what its adjoint needs.
#[derive(Clone, Debug, Default)]
pub struct Rendered {
    /// What each pixel sees.
    pub raster: Raster,
    /// sRGB-encoded colours in \[0, 1\], the background's where there is no triangle.
    pub rgb: Vec<[f32; 3]>,
    /// The background's colour, sRGB-encoded.
    pub background: [f32; 3],
    /// Projected vertices.
    pub screen: Vec<ScreenPoint>,
    /// Shading normals.
    pub normals: Normals,
}

/// ∂L/∂picture. Each part may be empty where a loss does not use it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cotangents<'a> {
    /// ∂L/∂rgb \[pixel\].
    pub rgb: &'a [[f32; 3]],
    /// ∂L/∂coverage \[pixel\] (1 on the surface, 0 beside it).
    pub mask: &'a [f32],
    /// ∂L/∂z \[pixel\] [1 / model unit]; read on covered pixels only. Depth has inner gradients, not those of its edges.
    pub depth: &'a [f32],
}

/// ∂L/∂everything.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// ∂L/∂positions, per vertex, world space.
    pub positions: Vec<DVec3>,
    /// ∂L/∂camera.
    pub camera: DCamera,
    /// ∂L/∂light coefficients.
    pub light: Light,
    /// ∂L/∂(linear texel) of each look's texture at full resolution; empty where not asked for.
    pub texels: Vec<Vec<[f32; 3]>>,
}

/// Draws a surface at `positions` over a plain `background` (sRGB-encoded), one sample at each pixel centre, in one thread.
///
/// # Panics
/// When `positions` does not have the surface's number of vertices.
pub fn render(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    light: &Light,
    background: [f32; 3],
) -> Rendered {
    let mut rendered = Rendered::default();
    render_into(camera, surface, positions, light, background, &mut rendered);
    rendered
}

/// [`render`] into an earlier picture, whose memory is used again: a third faster in loops over frames.
///
/// # Panics
/// When `positions` does not have the surface's number of vertices.
pub fn render_into(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    light: &Light,
    background: [f32; 3],
    out: &mut Rendered,
) {
    out.background = background;
    out.screen = project(camera, positions);
    rasterize_screen_into(camera, surface, positions, &out.screen, false, &mut out.raster);
    out.normals =
        if surface.unlit { Normals::default() } else { posed_normals(&surface.normals, positions, &surface.triangles) };
    let posed = Posed { surface, screen: &out.screen, normals: &out.normals };
    shade_into(&posed, &out.raster, light, background, false, &mut out.rgb);
}

/// Adjoint of [`render`]. `texels` asks for the textures' gradients too.
///
/// # Panics
/// When a cotangent is neither empty nor of the picture's size.
pub fn render_vjp(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    light: &Light,
    rendered: &Rendered,
    d: &Cotangents,
    texels: bool,
) -> Gradients {
    let pixels = rendered.raster.triangle.len();
    for length in [d.rgb.len(), d.mask.len(), d.depth.len()] {
        assert!(length == 0 || length == pixels, "a cotangent has {length} pixels, the picture {pixels}");
    }
    let posed = Posed { surface, screen: &rendered.screen, normals: &rendered.normals };
    let mut inner = Inner {
        posed,
        light,
        d_screen: vec![ScreenPoint::default(); positions.len()],
        d_normals: match &rendered.normals {
            Normals::Smooth(n) | Normals::Flat(n) => vec![DVec3::ZERO; n.len()],
        },
        shade: ShadeAdjoint {
            normal: [DVec3::ZERO; 3],
            light: Light::ambient(0.0),
            texels: if texels {
                surface.looks.iter().map(|l| TexelAdjoint::new(l.texture.as_ref())).collect()
            } else {
                Vec::new()
            },
        },
    };
    inner.run(&rendered.raster, &rendered.rgb, d);
    let Inner { mut d_screen, d_normals, shade, .. } = inner;
    edges_vjp(&posed, light, rendered, d, &mut d_screen);

    let mut d_positions = vec![DVec3::ZERO; positions.len()];
    if !d.rgb.is_empty() && !surface.unlit {
        posed_normals_vjp(&surface.normals, positions, &surface.triangles, &d_normals, &mut d_positions);
    }
    let d_camera = project_vjp(camera, positions, &d_screen, &mut d_positions);
    let texels = shade.texels.into_iter().zip(surface.looks.iter());
    let texels = texels.map(|(t, look)| look.texture.as_ref().map_or(Vec::new(), |m| t.collapsed(m))).collect();
    Gradients { positions: d_positions, camera: d_camera, light: shade.light, texels }
}

/// The inner part: pixel by pixel, summed per triangle while neighbouring pixels show the same one.
struct Inner<'a> {
    posed: Posed<'a>,
    light: &'a Light,
    d_screen: Vec<ScreenPoint>,
    d_normals: Vec<DVec3>,
    shade: ShadeAdjoint,
}

impl Inner<'_> {
    fn run(&mut self, raster: &Raster, rgb: &[[f32; 3]], d: &Cotangents) {
        if d.rgb.is_empty() && d.depth.is_empty() {
            return;
        }
        if self.posed.surface.plain && d.depth.is_empty() {
            let (surface, screen) = (self.posed.surface, self.posed.screen);
            return shade_plain_vjp(surface, screen, raster, rgb, d.rgb, &mut self.d_screen);
        }
        let mut current = NONE;
        let mut corners = None;
        let mut sums = DCorners::default();
        for (pixel, &id) in raster.triangle.iter().enumerate() {
            let d_rgb = d.rgb.get(pixel).copied().unwrap_or_default();
            let d_z = d.depth.get(pixel).copied().unwrap_or_default();
            if id == NONE || (d_rgb == [0.0; 3] && d_z == 0.0) {
                continue;
            }
            if id != current {
                self.flush(current, &corners, &mut sums);
                current = id;
                corners = Some(self.posed.corners(id, true));
            }
            let Some(c) = &corners else { continue };
            let Some(weights) = &c.weights else { continue };
            let (b, q) = (raster.weights(pixel), raster.inv_z[pixel]);
            let mut d_b = [0.0; 3];
            if d_rgb != [0.0; 3] {
                let fragment = c.fragment(b, q);
                d_b = c.fragment_vjp(b, &fragment, self.light, rgb[pixel], d_rgb, &mut self.shade);
            }
            // z = 1/Q.
            weights.at_vjp(b, q, d_b, -d_z / (q * q), &mut sums);
        }
        self.flush(current, &corners, &mut sums);
    }

    fn flush(&mut self, id: u32, corners: &Option<Corners>, sums: &mut DCorners) {
        let Some(c) = corners else { return };
        sums.flush(c.vertices, &mut self.d_screen);
        if c.look.unlit {
            return;
        }
        let normal = std::mem::take(&mut self.shade.normal);
        match self.posed.normals {
            Normals::Smooth(_) => c.vertices.iter().zip(normal).for_each(|(&v, n)| self.d_normals[v] += n * c.side),
            Normals::Flat(_) => self.d_normals[id as usize] += normal[0] * c.side,
        }
    }
}
