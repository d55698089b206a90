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
    pub vertices: Vec<u32>,
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
        let indices = |keep: &dyn Fn(usize) -> bool| -> Vec<usize> { (0..all.len()).filter(|&t| keep(t)).collect() };
        Self {
            moving: Part::new(surface, &indices(&|t| needed[t])),
            still: Part::new(surface, &indices(&|t| !moved[t])),
            shows: indices(&|t| needed[t]).into_iter().map(|t| shows[t]).collect(),
        }
    }

    /// Whether a pixel shows the part that moves: both parts drawn.
    pub fn shows_moving(&self, pixel: usize, moving: &Raster, still: &Raster) -> bool {
        let triangle = moving.triangle[pixel];
        triangle != NONE && self.shows[triangle as usize] && moving.inv_z[pixel] >= still.inv_z[pixel]
    }
}

impl Part {
    fn new(whole: &Surface, triangles: &[usize]) -> Self {
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| whole.triangles[t]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let number = |v: u32| vertices.binary_search(&v).ok().map(|n| n as u32);
        let renumbered = |v: u32| vertices.partition_point(|&u| u < v) as u32;
        let of_vertices = |values: &[[f32; 2]]| -> Vec<[f32; 2]> {
            vertices.iter().filter_map(|&v| values.get(v as usize).copied()).collect()
        };
        let surface = Surface {
            vertex_count: vertices.len(),
            triangles: triangles.iter().map(|&t| whole.triangles[t].map(renumbered)).collect(),
            look_of_triangle: triangles.iter().map(|&t| whole.look_of_triangle[t]).collect(),
            looks: whole.looks.clone(),
            uvs: of_vertices(&whole.uvs),
            colors: vertices.iter().filter_map(|&v| whole.colors.get(v as usize).copied()).collect(),
            normals: whole.normals.part(&vertices, number),
            cull_back: triangles.iter().filter_map(|&t| whole.cull_back.get(t).copied()).collect(),
            topology: Default::default(),
            plain: whole.plain,
            unlit: whole.unlit,
            has_cutouts: whole.has_cutouts,
        };
        Self { surface, vertices }
    }
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
                let of = |part: &Part| part.vertices.iter().map(|&v| x[v as usize]).collect::<Vec<_>>();
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
