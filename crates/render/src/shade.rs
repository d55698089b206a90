//! Colours of the visible fragments.
//!
//! colour = encode(albedo · max(0, E(n)) + emitted), albedo = base colour · texture · vertex colour in linear light, E the light's
//! irradiance at the (interpolated, renormalised) normal, encode the sRGB curve. Surfaces that face away are lit from behind
//! them: their normal is turned round.

use crate::interpolate::Weights;
use crate::light::{Light, irradiance, irradiance_vjp};
use crate::normals::{Normals, posed_normals};
use crate::plain::shade_plain;
use crate::project::{ScreenPoint, project};
use crate::raster::{Facing, NONE, Raster, rasterize_into};
use crate::srgb::{Encoder, encode_slope};
use crate::surface::{Surface, SurfaceLook};
use crate::texture::{MipTexture, Sample, TexelAdjoint};
use animimic_scene::Camera;
use glam::DVec3;
use rayon::prelude::*;

/// Rasterises a surface at `positions` with its looks' sidedness and alpha cutouts.
///
/// # Panics
/// When `positions` does not have the surface's number of vertices.
pub fn rasterize_surface(camera: &Camera, surface: &Surface, positions: &[DVec3], parallel: bool) -> Raster {
    let mut raster = Raster::default();
    rasterize_screen_into(camera, surface, positions, &project(camera, positions), parallel, &mut raster);
    raster
}

pub(crate) fn rasterize_screen_into(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    screen: &[ScreenPoint],
    parallel: bool,
    raster: &mut Raster,
) {
    assert_eq!(positions.len(), surface.vertex_count, "positions belong to another surface");
    let facing = Facing { cull_back: &surface.cull_back };
    let keep = |triangle: u32, b: [f32; 3]| kept(surface, triangle, b);
    let cutout: Option<crate::raster::Cutout> = if surface.has_cutouts { Some(&keep) } else { None };
    rasterize_into(camera, positions, screen, &surface.triangles, facing, cutout, parallel, raster);
}

fn kept(surface: &Surface, triangle: u32, b: [f32; 3]) -> bool {
    let look = surface.look(triangle);
    let Some(cutoff) = look.cutoff else { return true };
    let corners = surface.triangles[triangle as usize].map(|v| v as usize);
    let texel = look.texture.as_ref().map_or(1.0, |t| t.alpha(mix(b, corners.map(|v| surface.uvs[v]))));
    look.alpha * texel >= cutoff
}

#[inline(always)]
fn mix<const N: usize>(b: [f32; 3], c: [[f32; N]; 3]) -> [f32; N] {
    std::array::from_fn(|k| b[0] * c[0][k] + b[1] * c[1][k] + b[2] * c[2][k])
}

/// Colours (sRGB-encoded, in \[0, 1\]) of all pixels of a raster of the same surface, camera and positions; pixels without a
/// triangle get `background`. With `parallel` rows are shared among threads.
pub fn shade(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    raster: &Raster,
    light: &Light,
    background: [f32; 3],
    parallel: bool,
) -> Vec<[f32; 3]> {
    let screen = project(camera, positions);
    let normals = posed_normals(&surface.normals, positions, &surface.triangles);
    let mut rgb = Vec::new();
    let posed = Posed { surface, screen: &screen, normals: &normals };
    shade_into(&posed, raster, light, background, parallel, &mut rgb);
    rgb
}

pub(crate) fn shade_into(
    posed: &Posed,
    raster: &Raster,
    light: &Light,
    background: [f32; 3],
    parallel: bool,
    rgb: &mut Vec<[f32; 3]>,
) {
    rgb.clear();
    rgb.resize(raster.triangle.len(), background);
    let encoder = Encoder::new();
    let row = |(y, out): (usize, &mut [[f32; 3]])| {
        if posed.surface.plain {
            return shade_plain(posed.surface, raster, y * raster.width, out);
        }
        posed.each_fragment(raster, y, |x, fragment| {
            out[x] = encoder.encode_rgb(Lit::new(light, &fragment).linear);
        });
    };
    let width = raster.width.max(1);
    if parallel {
        rgb.par_chunks_mut(width).enumerate().for_each(row);
    } else {
        rgb.chunks_mut(width).enumerate().for_each(row);
    }
}

/// A surface in a pose, seen from a camera.
#[derive(Clone, Copy)]
pub(crate) struct Posed<'a> {
    pub surface: &'a Surface,
    pub screen: &'a [ScreenPoint],
    pub normals: &'a Normals,
}

impl<'a> Posed<'a> {
    /// Calls `visit` with column and fragment for every covered pixel of row `y`.
    pub fn each_fragment(&self, raster: &Raster, y: usize, mut visit: impl FnMut(usize, Fragment<'a>)) {
        let mut current = NONE;
        let mut corners = None;
        for x in 0..raster.width {
            let pixel = y * raster.width + x;
            let id = raster.triangle[pixel];
            if id == NONE {
                continue;
            }
            if id != current {
                current = id;
                corners = Some(self.corners(id, false));
            }
            if let Some(corners) = &corners {
                visit(x, corners.fragment(raster.weights(pixel), raster.inv_z[pixel]));
            }
        }
    }

    /// What a triangle's fragments have in common. Weights are made where the texture needs them or `with_weights` says so.
    pub fn corners(&self, id: u32, with_weights: bool) -> Corners<'a> {
        let s = self.surface;
        let [v0, v1, v2] = s.triangles[id as usize];
        let vertices = [v0 as usize, v1 as usize, v2 as usize];
        let p = [self.screen[vertices[0]], self.screen[vertices[1]], self.screen[vertices[2]]];
        let back = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y) > 0.0;
        let side = if back { -1.0 } else { 1.0 };
        let look = s.look(id);
        Corners {
            vertices,
            look,
            look_index: s.look_of_triangle[id as usize] as usize,
            weights: if with_weights || look.texture.is_some() { Weights::new(p) } else { None },
            uv: if s.uvs.is_empty() { [[0.0; 2]; 3] } else { vertices.map(|v| s.uvs[v]) },
            color: if s.colors.is_empty() { [[1.0; 3]; 3] } else { vertices.map(|v| s.colors[v]) },
            side,
            normal: match self.normals {
                _ if look.unlit => [DVec3::ZERO; 3],
                Normals::Smooth(n) => vertices.map(|v| n[v] * side),
                Normals::Flat(n) => [n[id as usize] * side; 3],
            },
            flat: matches!(self.normals, Normals::Flat(_)),
        }
    }
}

/// What the fragments of one triangle have in common.
#[derive(Clone)]
pub(crate) struct Corners<'a> {
    pub vertices: [usize; 3],
    pub look: &'a SurfaceLook,
    look_index: usize,
    pub weights: Option<Weights>,
    uv: [[f32; 2]; 3],
    color: [[f32; 3]; 3],
    /// −1 where the triangle shows its back.
    pub side: f64,
    /// On the viewer's side.
    normal: [DVec3; 3],
    flat: bool,
}

/// One visible pixel of a surface.
pub(crate) struct Fragment<'a> {
    pub look: &'a SurfaceLook,
    uv: [f32; 2],
    lod: f32,
    texel: Sample,
    /// Base colour times vertex colour, linear.
    tint: [f32; 3],
    /// Unit normal on the viewer's side; zero where it is not needed or not defined.
    pub normal: DVec3,
    /// Length of the interpolated normal before it was made a unit vector.
    normal_length: f64,
}

impl Fragment<'_> {
    /// Linear albedo.
    pub fn albedo(&self) -> [f32; 3] {
        [0, 1, 2].map(|c| self.texel.rgb[c] * self.tint[c])
    }
}

impl<'a> Corners<'a> {
    /// The fragment with weights `b` and inverse depth `q`.
    #[inline(always)]
    pub fn fragment(&self, b: [f32; 3], q: f32) -> Fragment<'a> {
        let look = self.look;
        let color = mix(b, self.color);
        let (normal, normal_length) = if self.flat || look.unlit {
            (self.normal[0], 1.0)
        } else {
            let w = b.map(f64::from);
            let m = self.normal[0] * w[0] + self.normal[1] * w[1] + self.normal[2] * w[2];
            (m.normalize_or_zero(), m.length())
        };
        let (mut uv, mut lod, mut texel) = ([0.0; 2], 0.0, Sample { rgb: [1.0; 3], ..Sample::default() });
        if let Some(texture) = &look.texture {
            uv = mix(b, self.uv);
            lod = self.level_of_detail(texture, b, q);
            texel = texture.sample(uv, lod);
        }
        Fragment { look, uv, lod, texel, tint: [0, 1, 2].map(|c| look.base[c] * color[c]), normal, normal_length }
    }

    fn level_of_detail(&self, texture: &MipTexture, [b0, b1, _]: [f32; 3], q: f32) -> f32 {
        let Some(weights) = &self.weights else { return 0.0 };
        let slopes = weights.slopes([b0, b1], q);
        let along = |axis: usize| {
            [0, 1].map(|k| {
                let (d0, d1) = (self.uv[0][k] - self.uv[2][k], self.uv[1][k] - self.uv[2][k]);
                d0 * slopes[0][axis] + d1 * slopes[1][axis]
            })
        };
        texture.level_of_detail(along(0), along(1))
    }

    /// Adjoint of [`Corners::fragment`] followed by [`Lit::new`] and the encoding to `encoded`: `d_rgb` = ∂L/∂(encoded colour) → ∂L/∂b, with ∂L/∂(corner
    /// normals, viewer's side), ∂L/∂light and ∂L/∂texels added to `out`. The level of detail is held fixed.
    #[inline(always)]
    pub fn fragment_vjp(
        &self,
        b: [f32; 3],
        f: &Fragment,
        light: &Light,
        encoded: [f32; 3],
        d_rgb: [f32; 3],
        out: &mut ShadeAdjoint,
    ) -> [f32; 3] {
        let lit = Lit::new(light, f);
        let d_linear = [0, 1, 2].map(|c| d_rgb[c] * encode_slope(lit.linear[c], encoded[c]));
        let d_albedo = [0, 1, 2].map(|c| d_linear[c] * lit.received[c]);
        let d_color = [0, 1, 2].map(|c| d_albedo[c] * f.texel.rgb[c] * f.look.base[c]);
        let mut d_b = self.color.map(|color| dot(color, d_color));
        if let Some(texture) = &f.look.texture {
            let d_texel = [0, 1, 2].map(|c| d_albedo[c] * f.tint[c]);
            let d_uv = MipTexture::sample_vjp_uv(&f.texel, d_texel);
            (0..3).for_each(|i| d_b[i] += self.uv[i][0] * d_uv[0] + self.uv[i][1] * d_uv[1]);
            if let Some(texels) = out.texels.get_mut(self.look_index) {
                texels.add(texture.taps(f.uv, f.lod), d_texel);
            }
        }
        if !f.look.unlit && f.normal != DVec3::ZERO {
            let albedo = f.albedo();
            let d_e = [0, 1, 2].map(|c| if lit.received[c] > 0.0 { f64::from(d_linear[c] * albedo[c]) } else { 0.0 });
            let d_n = irradiance_vjp(light, f.normal, d_e, &mut out.light);
            if self.flat {
                out.normal[0] += d_n;
            } else {
                let d_m = (d_n - f.normal * f.normal.dot(d_n)) / f.normal_length;
                for i in 0..3 {
                    d_b[i] += d_m.dot(self.normal[i]) as f32;
                    out.normal[i] += d_m * f64::from(b[i]);
                }
            }
        }
        d_b
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A fragment's light.
pub(crate) struct Lit {
    /// max(0, E) per channel.
    received: [f32; 3],
    /// Linear colour, before it is clamped and encoded.
    pub linear: [f32; 3],
}

impl Lit {
    /// Lights a fragment.
    #[inline(always)]
    pub fn new(light: &Light, f: &Fragment) -> Self {
        let received = if f.look.unlit { [1.0; 3] } else { irradiance(light, f.normal).map(|e| e.max(0.0) as f32) };
        let albedo = f.albedo();
        let linear = [0, 1, 2].map(|c| albedo[c] * received[c] + f.look.emissive[c]);
        Self { received, linear }
    }
}

/// What shading adjoints add up.
pub(crate) struct ShadeAdjoint {
    /// ∂L/∂corner normals of the current triangle, viewer's side.
    pub normal: [DVec3; 3],
    /// ∂L/∂light.
    pub light: Light,
    /// ∂L/∂texels per look; empty where not asked for.
    pub texels: Vec<TexelAdjoint>,
}
