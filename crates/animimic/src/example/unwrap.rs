//! Texture coordinates: faces grouped by the axis they face, connected groups laid flat side by side, and paint baked in.

use super::surface_net::Surface;
use animimic_scene::{Image, Mesh, Texture};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Width and height of the texture [px].
const ATLAS_PX: usize = 512;
/// Empty border around each chart [px]: bilinear lookup and two mip levels stay inside.
const BORDER_PX: f64 = 3.0;
/// Rounds in which a face takes the direction of most of its neighbours, so that charts have calm outlines.
const CALMING_ROUNDS: usize = 6;

/// The mesh split at chart borders, the surface vertex that each of its vertices came from, and the texture.
pub fn unwrap(
    surface: &Surface,
    normal: impl Fn(DVec3) -> DVec3,
    color: impl Fn(DVec3, DVec3) -> [f64; 3],
) -> (Mesh, Vec<u32>, Texture) {
    let (charts, mut boxes) = charts(surface);
    let scale = pack(&mut boxes);
    let mut mesh = Mesh { welded_count: surface.positions.len(), ..Mesh::default() };
    let mut split: BTreeMap<(usize, u32), u32> = BTreeMap::new();
    for (triangle, &(chart, direction)) in surface.triangles.iter().zip(&charts) {
        mesh.triangles.push(triangle.map(|v| {
            *split.entry((chart, v)).or_insert_with(|| {
                let p = surface.positions[v as usize];
                let flat = boxes[chart].place + (flatten(p, direction) - boxes[chart].low) * scale;
                mesh.positions.push(p);
                mesh.normals.push(normal(p));
                mesh.uvs.push(flat / ATLAS_PX as f64);
                mesh.welded.push(v);
                mesh.positions.len() as u32 - 1
            })
        }));
    }
    let image = bake(&mesh, color);
    let source_vertex = mesh.welded.clone();
    (mesh, source_vertex, Texture { image, alpha: Vec::new(), repeat: [false; 2], nearest: false })
}

/// A chart: its flat bounds [m], and where it lies in the atlas [px].
struct Chart {
    low: DVec2,
    high: DVec2,
    place: DVec2,
}

/// Drops the coordinate along the direction: ±x, ±y, ±z = 0..6. Mirrored where seen from behind.
fn flatten(p: DVec3, direction: u8) -> DVec2 {
    let (u, v) = match direction / 2 {
        0 => (p.z, p.y),
        1 => (p.x, p.z),
        _ => (p.x, p.y),
    };
    DVec2::new(if direction.is_multiple_of(2) { u } else { -u }, -v)
}

/// Chart and direction of each face, and the charts' bounds.
fn charts(surface: &Surface) -> (Vec<(usize, u8)>, Vec<Chart>) {
    let faces = &surface.triangles;
    let adjacent = adjacent_faces(faces);
    let mut direction: Vec<u8> = faces
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| surface.positions[i as usize]);
            let n = (b - a).cross(c - a);
            let m = n.abs();
            // Sides first: the creature is seen from the side, its seams should not be.
            let axis = if m.x >= 0.8 * m.y && m.x >= 0.8 * m.z {
                0
            } else if m.y >= m.z {
                1
            } else {
                2
            };
            2 * axis as u8 + u8::from(n[axis] < 0.0)
        })
        .collect();
    for _ in 0..CALMING_ROUNDS {
        let before = direction.clone();
        for (f, around) in adjacent.iter().enumerate() {
            let [a, b, c] = around.map(|g| before[g as usize]);
            if a == b || a == c {
                direction[f] = a;
            } else if b == c {
                direction[f] = b;
            }
        }
    }
    let mut chart = vec![usize::MAX; faces.len()];
    let mut boxes = Vec::new();
    for seed in 0..faces.len() {
        if chart[seed] != usize::MAX {
            continue;
        }
        let (mut stack, id) = (vec![seed], boxes.len());
        let mut bounds = Chart { low: DVec2::INFINITY, high: DVec2::NEG_INFINITY, place: DVec2::ZERO };
        chart[seed] = id;
        while let Some(f) = stack.pop() {
            for i in faces[f] {
                let flat = flatten(surface.positions[i as usize], direction[seed]);
                (bounds.low, bounds.high) = (bounds.low.min(flat), bounds.high.max(flat));
            }
            for g in adjacent[f].map(|g| g as usize) {
                if chart[g] == usize::MAX && direction[g] == direction[seed] {
                    chart[g] = id;
                    stack.push(g);
                }
            }
        }
        boxes.push(bounds);
    }
    (chart.into_iter().zip(direction).collect(), boxes)
}

/// The faces across the three edges of each face of a closed mesh.
fn adjacent_faces(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let directed: BTreeMap<(u32, u32), u32> =
        faces.iter().enumerate().flat_map(|(f, t)| (0..3).map(move |k| ((t[k], t[(k + 1) % 3]), f as u32))).collect();
    faces.iter().map(|t| [0, 1, 2].map(|k| directed[&(t[(k + 1) % 3], t[k])])).collect()
}

/// Shelves the charts, highest first, at the largest scale [px/m] that fits; returns the scale.
fn pack(charts: &mut [Chart]) -> f64 {
    let mut order: Vec<usize> = (0..charts.len()).collect();
    let height = |c: &Chart| c.high.y - c.low.y;
    order.sort_by(|&a, &b| height(&charts[b]).total_cmp(&height(&charts[a])).then(a.cmp(&b)));
    let (mut fits, mut too_large) = (1.0, 4.0 * ATLAS_PX as f64);
    for _ in 0..24 {
        let scale = 0.5 * (fits + too_large);
        if shelve(charts, &order, scale) {
            fits = scale;
        } else {
            too_large = scale;
        }
    }
    shelve(charts, &order, fits);
    fits
}

fn shelve(charts: &mut [Chart], order: &[usize], scale: f64) -> bool {
    let side = ATLAS_PX as f64;
    let (mut pen, mut shelf) = (DVec2::ZERO, 0.0);
    for &c in order {
        let size = (charts[c].high - charts[c].low) * scale + 2.0 * BORDER_PX;
        if pen.x + size.x > side {
            pen = DVec2::new(0.0, pen.y + shelf);
            shelf = 0.0;
        }
        if size.x > side || pen.y + size.y > side {
            return false;
        }
        charts[c].place = pen + BORDER_PX;
        pen.x += size.x;
        shelf = f64::max(shelf, size.y);
    }
    true
}

/// Colours all texels under a face by its rest position there, then lets colour flow into the empty borders.
fn bake(mesh: &Mesh, color: impl Fn(DVec3, DVec3) -> [f64; 3]) -> Image {
    let mut texels: Vec<Option<[u8; 3]>> = vec![None; ATLAS_PX * ATLAS_PX];
    for t in &mesh.triangles {
        let uv = t.map(|i| mesh.uvs[i as usize] * ATLAS_PX as f64);
        let area = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
        if area == 0.0 {
            continue;
        }
        let low = uv[0].min(uv[1]).min(uv[2]).floor().max(DVec2::ZERO);
        let high = uv[0].max(uv[1]).max(uv[2]).ceil().min(DVec2::splat(ATLAS_PX as f64));
        for y in low.y as usize..high.y as usize {
            for x in low.x as usize..high.x as usize {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let b = [1, 2, 0].map(|k: usize| (uv[(k + 1) % 3] - uv[k]).perp_dot(p - uv[k]) / area);
                if b.iter().all(|w| *w >= -1e-9) {
                    let at = |values: &[DVec3]| (0..3).map(|k| values[t[k] as usize] * b[k]).sum::<DVec3>();
                    let c = color(at(&mesh.positions), at(&mesh.normals).normalize());
                    texels[y * ATLAS_PX + x] = Some(c.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
                }
            }
        }
    }
    for _ in 0..8 {
        let before = texels.clone();
        for y in 0..ATLAS_PX {
            for x in 0..ATLAS_PX {
                if before[y * ATLAS_PX + x].is_none() {
                    let around = [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(|(dx, dy)| {
                        let (u, v) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
                        (u < ATLAS_PX && v < ATLAS_PX).then(|| before[v * ATLAS_PX + u])?
                    });
                    texels[y * ATLAS_PX + x] = around.into_iter().next();
                }
            }
        }
    }
    let rgb = texels.into_iter().map(|t| t.unwrap_or([128; 3])).collect();
    Image { width: ATLAS_PX, height: ATLAS_PX, rgb }
}
