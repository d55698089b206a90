//! Light from a reference picture.
//!
//! In linear light a matt pixel is albedo·E(n) + emitted with E linear in the nine coefficients of each channel: robust
//! linear least squares (weights refitted a few times) over the pixels that are safely inside both the model and the
//! mask. A small pull towards plain ambient light fixes what the visible normals leave open, and normals all over the
//! sphere at which E would be negative are pushed back to zero (one-sided least squares), so unseen sides never turn black.

use crate::error::RenderError;
use crate::light::{HARMONICS, Light, harmonics};
use crate::normals::posed_normals;
use crate::project::project;
use crate::raster::{NONE, Raster};
use crate::shade::Posed;
use crate::surface::Surface;
use animimic_math::small_spd::solve_spd;
use animimic_scene::image::linear_from_srgb;
use animimic_scene::{Camera, Image, Mask};
use glam::DVec3;

/// Pixels this close to the model's or the mask's outline are left out [px]: antialiasing, halo, video chroma.
const EDGE_MARGIN: usize = 2;
/// Weight of the pull towards ambient light, as a fraction of the data's mean weight per coefficient.
const AMBIENT_PULL: f64 = 1e-3;
/// Scale of the robust weights, in linear light: first Huber's, then Geman and McClure's, which forget what does not fit.
const ROBUST_SCALE: f64 = 0.03;
/// Refits of the robust weights and of the set of negative directions.
const REFITS: usize = 12;
/// Directions on the sphere at which E is kept from being negative, and their weight against the data.
const DIRECTIONS: usize = 128;
const DIRECTION_WEIGHT: f64 = 0.1;
/// Bytes from which on a pixel is taken to be saturated.
const SATURATED: u8 = 254;

/// Light that best explains `reference` as a picture of the surface at `positions`; `mask` is the object in the reference
/// (`None`: everything). `raster` is the surface drawn with the same camera, which has the reference's size.
///
/// # Errors
/// [`RenderError::Mismatch`] when sizes differ or no pixel is usable.
pub fn solve_light(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    raster: &Raster,
    reference: &Image,
    mask: Option<&Mask>,
) -> Result<Light, RenderError> {
    same_size(raster, reference, mask)?;
    let samples = gather(camera, surface, positions, raster, reference, mask);
    if samples.is_empty() {
        return Err(RenderError::Mismatch(
            "no lit pixel of the model lies inside the mask; check camera and mask".into(),
        ));
    }
    let mut light = Light::ambient(0.0);
    for channel in 0..3 {
        let c = solve_channel(&samples, channel);
        (0..HARMONICS).for_each(|k| light.sh[k][channel] = c[k]);
    }
    Ok(light)
}

/// Gain per channel, in linear light, that takes `rendered` (sRGB-encoded, one entry per pixel of `raster`) closest to
/// `reference`: Σ w a b / Σ w a² over safely inside pixels, once with all and once with the better half. 1 where nothing
/// can be said.
///
/// # Errors
/// [`RenderError::Mismatch`] when sizes differ.
pub fn solve_exposure(
    rendered: &[[f32; 3]],
    raster: &Raster,
    reference: &Image,
    mask: Option<&Mask>,
) -> Result<[f64; 3], RenderError> {
    same_size(raster, reference, mask)?;
    let usable = inside_both(raster, mask);
    let mut gain = [1.0; 3];
    for (c, gain) in gain.iter_mut().enumerate() {
        let pairs: Vec<(f64, f64)> = (0..usable.len())
            .filter(|&p| usable[p] && reference.rgb[p][c] < SATURATED && rendered[p][c] < 0.999)
            .map(|p| (linear(rendered[p][c]), linear(f32::from(reference.rgb[p][c]) / 255.0)))
            .collect();
        let ratio = |pairs: &[(f64, f64)]| {
            let (ab, aa) = pairs.iter().fold((0.0, 0.0), |(ab, aa), (a, b)| (ab + a * b, aa + a * a));
            if aa > 1e-9 { ab / aa } else { 1.0 }
        };
        let first = ratio(&pairs);
        let mut errors: Vec<f64> = pairs.iter().map(|(a, b)| (first * a - b).abs()).collect();
        let half = errors.len() / 2;
        if half == 0 {
            *gain = first;
            continue;
        }
        let (_, &mut median, _) = errors.select_nth_unstable_by(half, f64::total_cmp);
        let better: Vec<(f64, f64)> = pairs.into_iter().filter(|(a, b)| (first * a - b).abs() <= median).collect();
        *gain = ratio(&better);
    }
    Ok(gain)
}

fn linear(c: f32) -> f64 {
    f64::from(linear_from_srgb(c))
}

fn same_size(raster: &Raster, reference: &Image, mask: Option<&Mask>) -> Result<(), RenderError> {
    let size = (raster.width, raster.height);
    let others = [Some((reference.width, reference.height)), mask.map(|m| (m.width, m.height))];
    if let Some((w, h)) = others.into_iter().flatten().find(|o| *o != size) {
        let (width, height) = size;
        return Err(RenderError::Mismatch(format!("picture or mask is {w}x{h}, the camera {width}x{height}")));
    }
    Ok(())
}

/// One pixel's equation: albedo · Y(n)·c = value, per channel.
struct LightSample {
    harmonics: [f64; HARMONICS],
    albedo: [f64; 3],
    value: [f64; 3],
    /// False where the channel is saturated.
    usable: [bool; 3],
}

fn gather(
    camera: &Camera,
    surface: &Surface,
    positions: &[DVec3],
    raster: &Raster,
    reference: &Image,
    mask: Option<&Mask>,
) -> Vec<LightSample> {
    let usable = inside_both(raster, mask);
    let screen = project(camera, positions);
    let normals = posed_normals(&surface.normals, positions, &surface.triangles);
    let posed = Posed { surface, screen: &screen, normals: &normals };
    let mut samples = Vec::new();
    for y in 0..raster.height {
        posed.each_fragment(raster, y, |x, f| {
            let pixel = y * raster.width + x;
            if f.look.unlit || !usable[pixel] || f.normal == DVec3::ZERO {
                return;
            }
            let bytes = reference.rgb[pixel];
            samples.push(LightSample {
                harmonics: harmonics(f.normal),
                albedo: f.albedo().map(f64::from),
                value: [0, 1, 2].map(|c| linear(f32::from(bytes[c]) / 255.0) - f64::from(f.look.emissive[c])),
                usable: bytes.map(|b| b < SATURATED),
            });
        });
    }
    samples
}

/// Pixels covered by the model and the mask that stay so for [`EDGE_MARGIN`] pixels around.
pub(crate) fn inside_both(raster: &Raster, mask: Option<&Mask>) -> Vec<bool> {
    let (w, h) = (raster.width, raster.height);
    let mut inside: Vec<bool> =
        (0..w * h).map(|p| raster.triangle[p] != NONE && mask.is_none_or(|m| m.coverage[p] >= 128)).collect();
    for _ in 0..EDGE_MARGIN {
        let before = inside.clone();
        for y in 0..h {
            for x in 0..w {
                let all = x > 0 && y > 0 && x + 1 < w && y + 1 < h && {
                    let p = y * w + x;
                    before[p - 1] && before[p + 1] && before[p - w] && before[p + w]
                };
                inside[y * w + x] &= all;
            }
        }
    }
    inside
}

fn solve_channel(samples: &[LightSample], channel: usize) -> [f64; HARMONICS] {
    let mut c = [0.0; HARMONICS];
    c[0] = 1.0;
    for refit in 0..REFITS {
        let mut a = [[0.0; HARMONICS]; HARMONICS];
        let mut b = [0.0; HARMONICS];
        let mut total = 0.0;
        for s in samples.iter().filter(|s| s.usable[channel]) {
            let predicted = s.albedo[channel] * dot(&s.harmonics, &c);
            let error = (predicted - s.value[channel]).abs();
            let w = match refit {
                0 => 1.0,
                1..4 => (ROBUST_SCALE / error).min(1.0),
                _ => (1.0 + (error / ROBUST_SCALE).powi(2)).powi(-2),
            };
            let row = s.harmonics.map(|y| y * s.albedo[channel]);
            add(&mut a, &mut b, &row, s.value[channel], w);
            total += w * s.albedo[channel].powi(2);
        }
        let total = total.max(1e-9);
        let mean = b[0] / total;
        for k in 0..HARMONICS {
            a[k][k] += AMBIENT_PULL * total;
        }
        b[0] += AMBIENT_PULL * total * mean;
        for n in sphere(DIRECTIONS) {
            let y = harmonics(n);
            if refit > 0 && dot(&y, &c) < 0.0 {
                add(&mut a, &mut b, &y, 0.0, DIRECTION_WEIGHT * total / DIRECTIONS as f64);
            }
        }
        // The ambient pull makes the system definite.
        c = solve_spd(a, b).unwrap_or(c);
    }
    c
}

fn dot(a: &[f64; HARMONICS], b: &[f64; HARMONICS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(
    a: &mut [[f64; HARMONICS]; HARMONICS],
    b: &mut [f64; HARMONICS],
    row: &[f64; HARMONICS],
    value: f64,
    weight: f64,
) {
    for i in 0..HARMONICS {
        let wi = weight * row[i];
        (0..HARMONICS).for_each(|j| a[i][j] += wi * row[j]);
        b[i] += wi * value;
    }
}

/// Directions spread evenly over the sphere (Fibonacci spiral).
fn sphere(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |k| {
        let y = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
        let r = (1.0 - y * y).sqrt();
        let angle = golden * k as f64;
        DVec3::new(r * angle.cos(), y, r * angle.sin())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{blob, painted};
    use crate::light::irradiance;
    use crate::shade::{rasterize_surface, shade};

    fn picture(rgb: &[[f32; 3]], camera: &Camera) -> Image {
        let rgb = rgb.iter().map(|p| p.map(|c| (c * 255.0).round() as u8)).collect();
        Image { width: camera.width as usize, height: camera.height as usize, rgb }
    }

    #[test]
    fn the_light_of_a_picture_is_found_again_on_the_side_that_is_seen() {
        let mesh = blob(40, 30);
        let surface = Surface::new(&mesh, &[painted(64)]).expect("the fixture is sound");
        let camera = Camera::orbit(DVec3::ZERO, 4.0, 0.4, 0.2, 0.7, 128, 128);
        let truth = Light::ambient_and_key(0.3, 0.6, DVec3::new(0.8, 0.7, 0.6)).scaled([1.0, 0.95, 0.9]);
        let raster = rasterize_surface(&camera, &surface, &mesh.positions, false);
        let mut reference =
            picture(&shade(&camera, &surface, &mesh.positions, &raster, &truth, [1.0; 3], false), &camera);
        // A tenth of the pixels show something else.
        reference.rgb.iter_mut().step_by(10).for_each(|p| *p = [10, 200, 30]);
        let light = solve_light(&camera, &surface, &mesh.positions, &raster, &reference, None).expect("sizes agree");
        let towards = (camera.eye()).normalize();
        let mut worst = 0.0f64;
        for n in sphere(200).filter(|n| n.dot(towards) > 0.3) {
            let (a, b) = (irradiance(&light, n), irradiance(&truth, n));
            (0..3).for_each(|c| worst = worst.max((a[c] - b[c]).abs()));
        }
        println!("worst error of the light on the visible side {worst:.3}");
        assert!(worst < 0.03);
        let rendered = shade(&camera, &surface, &mesh.positions, &raster, &truth.scaled([0.8; 3]), [1.0; 3], false);
        let gain = solve_exposure(&rendered, &raster, &reference, None).expect("sizes agree");
        println!("gain {gain:?}");
        assert!(gain.iter().all(|g| (g - 1.25).abs() < 0.01));
    }
}
