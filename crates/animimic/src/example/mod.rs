//! The shipped example: a small creature, its rig, a motion and the video of that motion, all made by code.
//!
//! The surface is the zero set of blended primitives (one group per bone), meshed by surface nets, unwrapped into planar
//! charts, painted as a function of rest position and skinned by closeness to the primitives. Its tail is soft, and simulated. `animimic example -o DIR`
//! writes the files under `examples/creature`; the fit sees the picture of the motion and never the motion.

mod blend;
mod body;
mod dance;
mod files;
mod flesh;
mod paint;
mod surface_net;
mod unwrap;

pub use dance::{motion as trot, sway};
pub use files::write;
pub use flesh::{BODY_YOUNG, LOOSE, TAIL_YOUNG, moved, surfaces};

use crate::Error;
use crate::pictures::Studio;
use animimic_render::Light;
use animimic_scene::{Asset, Camera, CameraFile, Image, Look, Motion, Part, Rig, Source};
use glam::DVec3;

/// The creature, the motion in its video and the camera that films it.
#[derive(Clone, Debug)]
pub struct Example {
    /// Mesh, texture and rig in the pose of frame 0.
    pub asset: Asset,
    /// The motion of the video; pose 0 is the rest pose.
    pub motion: Motion,
    /// The camera of the video.
    pub camera: CameraFile,
}

/// Frames and frames per second of the example's video.
pub const FRAMES: usize = 49;
/// Frames per second of the example's video.
pub const FPS: f64 = 24.0;
/// Width and height of the example's video [px].
pub const SIZE_PX: u32 = 512;
/// Background of the example's video, sRGB.
pub const BACKGROUND: [u8; 3] = [217, 217, 217];

/// Makes the creature. The same on every machine.
pub fn creature() -> Example {
    let primitives = body::primitives();
    let surface = surface_net::surface(|p| blend::distance(&primitives, p), body::LOW, body::HIGH, body::CELL);
    let skeleton = body::skeleton();
    let weights = blend::weights(&primitives, &surface, skeleton.joints.len());
    let (mut mesh, source_vertex, texture) = unwrap::unwrap(&surface, |p| blend::normal(&primitives, p), paint::color);
    mesh.parts = vec![Part {
        name: "creature".into(),
        vertices: 0..mesh.positions.len(),
        triangles: 0..mesh.triangles.len(),
        look: 0,
        skin: None,
    }];
    let look = Look { name: "skin".into(), texture: Some(texture), roughness: 0.9, ..Look::default() };
    let skin = blend::skin(&skeleton, &mesh.positions, &source_vertex, &weights);
    let motion = dance::motion(&skeleton, FRAMES, FPS);
    let asset =
        Asset { mesh, looks: vec![look], rig: Rig { skeleton, skin }, source: Source::Plain, ..Asset::default() };
    Example { asset, motion, camera: camera() }
}

/// Draws the video's frames, whose surfaces are given, one after the other, in warm light from the upper left.
///
/// # Errors
/// [`Error::Render`] never happens for the creature, which is sound.
pub fn film<'a>(example: &'a Example, surfaces: &'a [Vec<DVec3>]) -> Result<impl Iterator<Item = Image> + 'a, Error> {
    const AMBIENT: f64 = 0.62;
    const KEY: f64 = 0.62;
    const TOWARDS_LIGHT: DVec3 = DVec3::new(-0.25, 0.85, 0.6);
    let studio = Studio::with_light(&example.asset, Light::ambient_and_key(AMBIENT, KEY, TOWARDS_LIGHT))?;
    Ok(surfaces.iter().map(move |x| studio.draw(&example.camera.main, x, BACKGROUND).0))
}

/// The input view from half right, and the held-out views 45° to either side.
fn camera() -> CameraFile {
    const AZIMUTH_RAD: f64 = 0.75;
    const ELEVATION_RAD: f64 = 0.17;
    const FOV_Y_RAD: f64 = 0.61;
    const DISTANCE: f64 = 3.5;
    let target = DVec3::new(0.0, 0.66, -0.12);
    let main = Camera::orbit(target, DISTANCE, AZIMUTH_RAD, ELEVATION_RAD, FOV_Y_RAD, SIZE_PX, SIZE_PX);
    let turn = std::f64::consts::FRAC_PI_4;
    let views = vec![
        ("novel_p45".to_owned(), main.orbited(target, turn)),
        ("novel_m45".to_owned(), main.orbited(target, -turn)),
    ];
    CameraFile { main, fps: FPS, views, target: Some(target) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics;

    #[test]
    fn the_creature_is_one_closed_textured_body_with_normalised_weights_and_its_motion_starts_at_rest() {
        let e = creature();
        let (mesh, skin) = (&e.asset.mesh, &e.asset.rig.skin);
        println!(
            "{} vertices, {} welded, {} triangles, {} joints",
            mesh.positions.len(),
            mesh.welded_count,
            mesh.triangles.len(),
            e.asset.rig.skeleton.joints.len()
        );
        // Euler's formula for one closed surface of genus 0: V − E + F = 2 with E = 3F/2.
        assert_eq!(mesh.welded_count * 2, mesh.triangles.len() + 4);
        assert!(metrics::enclosed_volume(mesh, &mesh.positions) > 0.05);
        assert!((20..=25).contains(&e.asset.rig.skeleton.joints.len()));
        for influences in &skin.influences {
            assert!(!influences.is_empty() && influences.len() <= 4);
            assert!((influences.iter().map(|i| i.weight).sum::<f64>() - 1.0).abs() < 1e-12);
        }
        assert!(mesh.uvs.iter().all(|uv| uv.min_element() >= 0.0 && uv.max_element() <= 1.0));
        let first = e.asset.rig.in_pose(&e.motion.poses[0]);
        let worst = first.iter().zip(&mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        println!("frame 0 off rest by {worst:e}");
        assert!(worst < 1e-12 && e.motion.poses.len() == FRAMES);
    }

    #[test]
    fn the_creature_stays_in_the_picture_and_moves_several_percent_of_its_size() {
        let e = creature();
        let (mut moved, mut n) = (0.0, 0);
        for x in surfaces(&e).expect("a sound creature") {
            for (a, b) in x.iter().zip(&e.asset.mesh.positions) {
                let p = e.camera.main.project(*a);
                assert!(p.min_element() > 4.0 && p.max_element() < f64::from(SIZE_PX) - 4.0, "{p}");
                moved += a.distance_squared(*b);
                n += 1;
            }
        }
        let rms = (moved / f64::from(n)).sqrt() / e.asset.mesh.diagonal();
        println!("rms motion {rms:.4} of the diagonal");
        assert!(rms > 0.015);
    }
}
