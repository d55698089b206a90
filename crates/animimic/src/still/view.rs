//! The view that shows most of a model: its surface, and every part that a joint moves.

use crate::Error;
use animimic_render::rasterize_parallel;
use animimic_scene::{Asset, Camera, Mesh};
use glam::{DVec2, DVec3};

/// Azimuths tried, evenly around, and elevations [deg].
const AZIMUTHS: usize = 24;
const ELEVATIONS_DEG: [f64; 3] = [0.0, 10.0, 20.0];
/// Vertical field of view [deg]: long enough to keep limbs in proportion, short enough to show depth.
const FOV_DEG: f64 = 40.0;
/// Share of the picture, in width or height, that the model fills at rest: the rest is room to move.
const FILL: f64 = 0.62;
/// Height of the pictures that views are judged by [px].
const JUDGED_PX: u32 = 192;
/// A part that shows this share of its surface is seen.
const PART_SEEN: f64 = 0.25;
/// What lies farther behind the picture's depth than this is hidden [rest diagonal].
const HIDDEN_BEHIND: f64 = 0.01;
/// What a view loses when it looks from straight behind, against one from the front: faces matter to people and to video models.
const FROM_BEHIND: f64 = 0.2;

/// The view that shows most, and why in words.
pub fn best(asset: &Asset, positions: &[DVec3], width: u32, height: u32) -> Result<(Camera, String), Error> {
    let mesh = &asset.mesh;
    let parts = parts(asset);
    let mut best: Option<(f64, Camera, String)> = None;
    for elevation in ELEVATIONS_DEG {
        for k in 0..AZIMUTHS {
            let azimuth = 360.0 * k as f64 / AZIMUTHS as f64;
            let camera = framed(positions, azimuth.to_radians(), elevation.to_radians(), width, height);
            let seen = seen(mesh, &camera, positions, &parts);
            let behind = 0.5 * (1.0 - azimuth.to_radians().cos());
            let score = seen.surface + seen.parts - FROM_BEHIND * behind;
            if best.as_ref().is_none_or(|b| score > b.0) {
                let shows = format!("{:.0} % of the surface", 100.0 * seen.surface);
                let all = if parts.count > 1 {
                    format!(" and {:.0} % of the parts", 100.0 * seen.parts)
                } else {
                    String::new()
                };
                let words = format!("azimuth {azimuth:.0}°, elevation {elevation:.0}°: shows {shows}{all}");
                best = Some((score, camera, words));
            }
        }
    }
    best.map(|b| (b.1, b.2)).ok_or_else(|| Error::Input("a model without vertices cannot be seen".into()))
}

/// A camera at some angles, in which the model fills its share of the picture and stands in its middle.
fn framed(positions: &[DVec3], azimuth: f64, elevation: f64, width: u32, height: u32) -> Camera {
    let (low, high) = animimic_scene::mesh::bounds(positions);
    let center = 0.5 * (low + high);
    let radius = positions.iter().map(|p| p.distance(center)).fold(1e-9, f64::max);
    let orbit = |target: DVec3, distance: f64| {
        Camera::orbit(target, distance, azimuth, elevation, FOV_DEG.to_radians(), width, height)
    };
    let (mut target, mut distance) = (center, 4.0 * radius);
    // A few steps of centring and scaling: perspective makes neither exact in one.
    for _ in 0..6 {
        let camera = orbit(target, distance);
        let pixels: Vec<DVec2> = positions.iter().map(|p| camera.project(*p)).collect();
        let (low, high) = pixels.iter().fold((pixels[0], pixels[0]), |(l, h), p| (l.min(*p), h.max(*p)));
        let middle = 0.5 * (low + high) - DVec2::new(camera.cx, camera.cy);
        let share = ((high - low) / DVec2::new(f64::from(width), f64::from(height))).max_element();
        let rotation = camera.view_from_world.matrix3;
        target +=
            rotation.row(0) * (middle.x * distance / camera.fx) + rotation.row(1) * (middle.y * distance / camera.fy);
        distance = (distance * share / FILL).max(1.2 * radius);
    }
    orbit(target, distance)
}

/// Which part of the model each triangle belongs to.
struct Parts {
    of_triangle: Vec<usize>,
    count: usize,
    area: Vec<f64>,
}

fn parts(asset: &Asset) -> Parts {
    let main_joint = |v: u32| asset.rig.skin.main_joint(v as usize).unwrap_or(0);
    let of_triangle: Vec<usize> = asset.mesh.triangles.iter().map(|t| main_joint(t[0])).collect();
    let count = of_triangle.iter().copied().max().map_or(1, |m| m + 1);
    let mut area = vec![0.0; count];
    for (t, &part) in of_triangle.iter().enumerate() {
        area[part] += triangle_area(&asset.mesh.triangles[t], &asset.mesh.positions);
    }
    Parts { of_triangle, count: area.iter().filter(|a| **a > 0.0).count(), area }
}

/// Shares in [0, 1].
struct Seen {
    surface: f64,
    parts: f64,
}

fn seen(mesh: &Mesh, camera: &Camera, positions: &[DVec3], parts: &Parts) -> Seen {
    let visible = visible_triangles(mesh, camera, positions);
    let mut shown = vec![0.0; parts.area.len()];
    for (t, _) in visible.iter().enumerate().filter(|(_, v)| **v) {
        shown[parts.of_triangle[t]] += triangle_area(&mesh.triangles[t], positions);
    }
    let total: f64 = parts.area.iter().sum();
    let moved = shown.iter().zip(&parts.area).filter(|(_, a)| **a > 0.0);
    let seen = moved.filter(|(s, a)| **s > PART_SEEN * **a).count();
    Seen { surface: shown.iter().sum::<f64>() / total.max(1e-300), parts: seen as f64 / parts.count.max(1) as f64 }
}

/// Share of a model's surface, in [0, 1], that a camera sees.
pub fn surface_seen(mesh: &Mesh, camera: &Camera, positions: &[DVec3]) -> f64 {
    let area = |t: usize| triangle_area(&mesh.triangles[t], positions);
    let visible = visible_triangles(mesh, camera, positions);
    let shown: f64 = (0..visible.len()).filter(|&t| visible[t]).map(area).sum();
    shown / (0..visible.len()).map(area).sum::<f64>().max(1e-300)
}

/// Triangles whose middle nothing hides.
fn visible_triangles(mesh: &Mesh, camera: &Camera, positions: &[DVec3]) -> Vec<bool> {
    let small = camera.resized((JUDGED_PX * camera.width).div_ceil(camera.height), JUDGED_PX);
    let raster = rasterize_parallel(&small, positions, &mesh.triangles);
    let (low, high) = animimic_scene::mesh::bounds(positions);
    let behind = HIDDEN_BEHIND * (high - low).length();
    let visible = |t: &[u32; 3]| {
        let middle = t.map(|i| positions[i as usize]).iter().sum::<DVec3>() / 3.0;
        let pixel = small.project(middle).floor();
        let inside =
            pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(small.width) && pixel.y < f64::from(small.height);
        let depth = || raster.depth(pixel.y as usize * small.width as usize + pixel.x as usize);
        let z = small.to_view(middle).z;
        z > 0.0 && inside && depth().is_none_or(|d| z < d + behind)
    };
    mesh.triangles.iter().map(visible).collect()
}

fn triangle_area(t: &[u32; 3], x: &[DVec3]) -> f64 {
    let [a, b, c] = t.map(|i| x[i as usize]);
    0.5 * (b - a).cross(c - a).length()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square tile in the plane z = 0 seen best from ±Z, subdivided.
    fn tile() -> Asset {
        let n = 8;
        let mut asset = Asset::default();
        for y in 0..=n {
            for x in 0..=n {
                asset.mesh.positions.push(DVec3::new(x as f64, y as f64, 0.02 * f64::from(x % 2)));
            }
        }
        for y in 0..n {
            for x in 0..n {
                let i = y * (n + 1) + x;
                asset.mesh.triangles.extend([[i, i + 1, i + n + 2], [i, i + n + 2, i + n + 1]]);
            }
        }
        asset
    }

    #[test]
    fn a_tile_is_looked_at_from_its_face_and_stands_in_the_middle_with_room_around() {
        let asset = tile();
        let positions = asset.mesh.positions.clone();
        let (camera, words) = best(&asset, &positions, 640, 360).expect("can be seen");
        println!("{words}");
        let forward = camera.view_from_world.matrix3.row(2);
        assert!(forward.z < -0.7, "from the front: {forward}");
        let pixels: Vec<DVec2> = positions.iter().map(|p| camera.project(*p)).collect();
        let (low, high) = pixels.iter().fold((pixels[0], pixels[0]), |(l, h), p| (l.min(*p), h.max(*p)));
        println!("from {low} to {high}");
        assert!((0.5 * (low + high)).distance(DVec2::new(320.0, 180.0)) < 2.0);
        assert!(((high.y - low.y) / 360.0 - FILL).abs() < 0.02);
    }
}
