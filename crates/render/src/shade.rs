//! Colours of the visible fragments.
//!
//! colour = encode(albedo · max(0, E(n)) + emitted), albedo = base colour · texture · vertex colour in linear light, E the light's
//! irradiance at the (interpolated, renormalised) normal, encode the sRGB curve. Surfaces that face away are lit from behind
//! them: their normal is turned round.

use crate::interpolate::Weights;
use crate::light::{Light, irradiance};
use crate::normals::{Normals, posed_normals};
use crate::project::{ScreenPoint, project};
use crate::raster::{Facing, NONE, Raster, rasterize_projected};
use crate::srgb::encode;
use crate::surface::{Surface, SurfaceLook};
use animimic_scene::Camera;
use glam::DVec3;
use rayon::prelude::*;

/// Rasterises a surface at `positions` with its looks' sidedness and alpha cutouts.
///
/// # Panics
/// When `positions` does not have the surface's number of vertices.
pub fn rasterize_surface(camera: &Camera, surface: &Surface, positions: &[DVec3], parallel: bool) -> Raster {
    assert_eq!(positions.len(), surface.vertex_count, "positions belong to another surface");
    let screen = project(camera, positions);
    let facing = Facing { cull_back: &surface.cull_back };
    let keep = |triangle: u32, b: [f32; 3]| kept(surface, triangle, b);
    let cutout: Option<crate::raster::Cutout> = if surface.has_cutouts { Some(&keep) } else { None };
    rasterize_projected(camera, positions, &screen, &surface.triangles, facing, cutout, parallel)
}

fn kept(surface: &Surface, triangle: u32, b: [f32; 3]) -> bool {
    let look = surface.look(triangle);
    let Some(cutoff) = look.cutoff else { return true };
    let texel = look.texture.as_ref().map_or(1.0, |t| t.alpha(uv(surface, triangle, b)));
    look.alpha * texel >= cutoff
}

fn uv(surface: &Surface, triangle: u32, b: [f32; 3]) -> [f32; 2] {
    let c = surface.triangles[triangle as usize].map(|v| surface.uvs[v as usize]);
    [0, 1].map(|k| b[0] * c[0][k] + b[1] * c[1][k] + b[2] * c[2][k])
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
    let scene = Posed {
        surface,
        screen: project(camera, positions),
        normals: posed_normals(&surface.normals, positions, &surface.triangles),
    };
    let mut rgb = vec![background; raster.triangle.len()];
    let row = |(y, out): (usize, &mut [[f32; 3]])| {
        scene.each_fragment(raster, y, |x, fragment| {
            let look = fragment.look;
            let albedo = fragment.albedo();
            let e = if look.unlit { [1.0; 3] } else { irradiance(light, fragment.normal).map(|e| e.max(0.0) as f32) };
            out[x] = [0, 1, 2].map(|c| encode(albedo[c] * e[c] + look.emissive[c]));
        });
    };
    let width = raster.width.max(1);
    if parallel {
        rgb.par_chunks_mut(width).enumerate().for_each(row);
    } else {
        rgb.chunks_mut(width).enumerate().for_each(row);
    }
    rgb
}

/// A surface in a pose, seen from a camera.
pub(crate) struct Posed<'a> {
    pub surface: &'a Surface,
    pub screen: Vec<ScreenPoint>,
    pub normals: Normals,
}

/// One visible pixel of a surface.
pub(crate) struct Fragment<'a> {
    pub look: &'a SurfaceLook,
    pub uv: [f32; 2],
    pub lod: f32,
    /// Base colour times vertex colour, linear.
    pub tint: [f32; 3],
    /// Unit normal on the viewer's side.
    pub normal: DVec3,
}

impl Fragment<'_> {
    /// Linear albedo.
    pub fn albedo(&self) -> [f32; 3] {
        match &self.look.texture {
            Some(texture) => {
                let t = texture.sample(self.uv, self.lod).rgb;
                [0, 1, 2].map(|c| t[c] * self.tint[c])
            }
            None => self.tint,
        }
    }
}

impl Posed<'_> {
    /// Calls `visit` with column and fragment for every covered pixel of row `y`.
    pub fn each_fragment<'s>(&'s self, raster: &Raster, y: usize, mut visit: impl FnMut(usize, Fragment<'s>)) {
        let mut current: Option<(u32, Corners<'s>)> = None;
        for x in 0..raster.width {
            let pixel = y * raster.width + x;
            let id = raster.triangle[pixel];
            if id == NONE {
                continue;
            }
            if current.as_ref().is_none_or(|(t, _)| *t != id) {
                current = Some((id, self.corners(id)));
            }
            if let Some((_, corners)) = &current {
                visit(x, corners.fragment(raster.bary[pixel], raster.inv_z[pixel]));
            }
        }
    }

    fn corners(&self, id: u32) -> Corners<'_> {
        let s = self.surface;
        let v = s.triangles[id as usize].map(|v| v as usize);
        let p = v.map(|v| self.screen[v]);
        let back = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y) > 0.0;
        let side = if back { -1.0 } else { 1.0 };
        let look = s.look(id);
        Corners {
            look,
            weights: if look.texture.is_some() { Weights::new(p) } else { None },
            uv: if s.uvs.is_empty() { [[0.0; 2]; 3] } else { v.map(|v| s.uvs[v]) },
            color: if s.colors.is_empty() { [[1.0; 3]; 3] } else { v.map(|v| s.colors[v]) },
            normal: match &self.normals {
                Normals::Smooth(n) => v.map(|v| n[v] * side),
                Normals::Flat(n) => [n[id as usize] * side; 3],
            },
            flat: matches!(self.normals, Normals::Flat(_)),
        }
    }
}

struct Corners<'a> {
    look: &'a SurfaceLook,
    weights: Option<Weights>,
    uv: [[f32; 2]; 3],
    color: [[f32; 3]; 3],
    normal: [DVec3; 3],
    flat: bool,
}

impl<'a> Corners<'a> {
    fn fragment(&self, [b0, b1]: [f32; 2], q: f32) -> Fragment<'a> {
        let b = [b0, b1, 1.0 - b0 - b1];
        let uv = [0, 1].map(|k| b[0] * self.uv[0][k] + b[1] * self.uv[1][k] + b[2] * self.uv[2][k]);
        let tint = [0, 1, 2].map(|c| {
            let color = b[0] * self.color[0][c] + b[1] * self.color[1][c] + b[2] * self.color[2][c];
            self.look.base[c] * color
        });
        let normal = if self.flat {
            self.normal[0]
        } else {
            let w = b.map(f64::from);
            (self.normal[0] * w[0] + self.normal[1] * w[1] + self.normal[2] * w[2]).normalize_or_zero()
        };
        Fragment { look: self.look, uv, lod: self.lod([b0, b1], q), tint, normal }
    }

    fn lod(&self, b: [f32; 2], q: f32) -> f32 {
        let (Some(weights), Some(texture)) = (&self.weights, &self.look.texture) else { return 0.0 };
        let slopes = weights.slopes(b, q);
        let along = |axis: usize| {
            [0, 1].map(|k| {
                let (d0, d1) = (self.uv[0][k] - self.uv[2][k], self.uv[1][k] - self.uv[2][k]);
                d0 * slopes[0][axis] + d1 * slopes[1][axis]
            })
        };
        texture.level_of_detail(along(0), along(1))
    }
}
