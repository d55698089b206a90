//! Parts of a surface that can be drawn by themselves.
//!
//! Where only a limb moves, the rest of a picture need not be drawn again: the surface is parted into the triangles that move and the
//! others, each is drawn, and pixel by pixel the nearer one is seen. The picture is that of the whole to the last bit, but where two
//! triangles have the same depth: a shading normal that triangles of both parts make is left to the part that moves.

use crate::raster::{NONE, Raster};
use crate::surface::Surface;

/// Some triangles of a surface.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// The triangles by themselves.
    pub surface: Surface,
    /// Number in the whole of each of their vertices.
    pub vertices: Vec<usize>,
}

/// A surface in two parts.
#[derive(Clone, Debug, Default)]
pub struct Parts {
    /// What moves, and what its normals depend on.
    pub moving: Part,
    /// What does not move.
    pub still: Part,
    /// Whether each triangle of `moving` looks other for the motion; the rest are there for the normals of these.
    shows: Vec<bool>,
}

impl Parts {
    /// Parts a surface by the vertices that move.
    pub fn new(surface: &Surface, moves: impl Fn(usize) -> bool) -> Self {
        let all = &surface.triangles;
        let moved: Vec<bool> = all.iter().map(|c| c.iter().any(|&v| moves(v as usize))).collect();
        // Their normals move too, and whoever has a share in those normals shows it.
        let shows = surface.normals.beside(all, &moved);
        let needed = surface.normals.beside(all, &shows);
        let moving: Vec<usize> = (0..all.len()).filter(|&t| needed[t]).collect();
        let still: Vec<usize> = (0..all.len()).filter(|&t| !moved[t]).collect();
        Self { moving: Part::new(surface, &moving), still: Part::new(surface, &still), shows: picked(&shows, &moving) }
    }

    /// Whether a pixel shows the part that moves: both parts drawn.
    pub fn shows_moving(&self, pixel: usize, moving: &Raster, still: &Raster) -> bool {
        let triangle = moving.triangle[pixel];
        triangle != NONE && self.shows[triangle as usize] && moving.inv_z[pixel] >= still.inv_z[pixel]
    }
}

impl Part {
    fn new(whole: &Surface, triangles: &[usize]) -> Self {
        let corners = picked(&whole.triangles, triangles);
        let mut vertices: Vec<u32> = corners.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let own: Vec<usize> = vertices.iter().map(|&v| v as usize).collect();
        let number = |v: u32| vertices.binary_search(&v).ok().map(|n| n as u32);
        let renumbered = |v: u32| number(v).expect("the vertices are those of the corners");
        let surface = Surface {
            vertex_count: vertices.len(),
            triangles: corners.iter().map(|c| c.map(renumbered)).collect(),
            look_of_triangle: picked(&whole.look_of_triangle, triangles),
            looks: whole.looks.clone(),
            uvs: picked(&whole.uvs, &own),
            colors: picked(&whole.colors, &own),
            normals: whole.normals.part(&own, number),
            cull_back: picked(&whole.cull_back, triangles),
            topology: Default::default(),
            plain: whole.plain,
            unlit: whole.unlit,
            has_cutouts: whole.has_cutouts,
        };
        Self { surface, vertices: own }
    }
}

/// Some of the values; none of what a surface has none of.
fn picked<T: Copy>(values: &[T], which: &[usize]) -> Vec<T> {
    which.iter().filter_map(|&k| values.get(k).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{blob, painted};
    use crate::{Light, rasterize_surface, shade};
    use animimic_scene::Camera;
    use glam::DVec3;

    #[test]
    fn two_parts_make_the_picture_of_the_whole_to_the_last_bit() {
        for flat in [false, true] {
            let mut mesh = blob(24, 18);
            if flat {
                mesh.normals.clear();
            }
            let surface = Surface::new(&mesh, &[painted(64)]).expect("a surface");
            let moves = |v: usize| mesh.positions[v].x > 0.2;
            let parts = Parts::new(&surface, moves);
            let camera = Camera::orbit(DVec3::ZERO, 4.0, 0.2, 0.15, 0.7, 160, 120);
            let pose = |turn: f64| -> Vec<DVec3> {
                let turned = |p: DVec3| glam::DQuat::from_rotation_y(turn) * p + DVec3::X * (0.2 * turn);
                let x = mesh.positions.iter().enumerate();
                x.map(|(v, &p)| if moves(v) { turned(p) } else { p }).collect()
            };
            let light = Light::default();
            let drawn = |surface: &Surface, x: &[DVec3]| {
                let raster = rasterize_surface(&camera, surface, x, false);
                let rgb = shade(&camera, surface, x, &raster, &light, [0.0; 3], false);
                (raster, rgb)
            };
            for turn in [0.0, 0.5, -0.9] {
                let x = pose(turn);
                let of = |part: &Part| part.vertices.iter().map(|&v| x[v]).collect::<Vec<_>>();
                let (whole, rgb) = drawn(&surface, &x);
                let (moving, moving_rgb) = drawn(&parts.moving.surface, &of(&parts.moving));
                let (still, still_rgb) = drawn(&parts.still.surface, &of(&parts.still));
                let mut shown = 0;
                for p in 0..rgb.len() {
                    let seen = parts.shows_moving(p, &moving, &still);
                    shown += usize::from(seen);
                    let (raster, color) = if seen { (&moving, moving_rgb[p]) } else { (&still, still_rgb[p]) };
                    assert_eq!((whole.inv_z[p], rgb[p]), (raster.inv_z[p], color), "pixel {p}, flat {flat}");
                }
                println!("turn {turn}: {shown} pixels show what moved");
                assert!(shown > 200 && shown < rgb.len() / 2);
            }
        }
    }
}
