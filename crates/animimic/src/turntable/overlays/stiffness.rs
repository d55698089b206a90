use super::{Overlay, Seen};
use animimic_render::overlay::{fill, text, text_size};
use animimic_scene::image::linear_from_srgb;
use animimic_scene::{Asset, Image, Look};

/// How stiff the flesh at the surface is, in the colours of a logarithmic scale.
pub struct Stiffness;

impl Overlay for Stiffness {
    fn name(&self) -> &'static str {
        "stiffness"
    }

    fn summary(&self) -> &'static str {
        "Young's modulus of the flesh, soft (violet) to stiff (yellow), of a model that soften or animate wrote"
    }

    fn colours_the_surface(&self) -> bool {
        true
    }

    fn lacks(&self, asset: &Asset) -> Option<&'static str> {
        let known = asset.mesh.youngs.iter().any(|y| *y > 0.0);
        (!known)
            .then_some("it does not say how stiff it is: draw the soft.glb of animate or the softened.glb of soften")
    }

    fn repainted(&self, asset: &Asset) -> Option<Asset> {
        let scale = Scale::of(&asset.mesh.youngs);
        let mut mesh = asset.mesh.clone();
        mesh.colors = mesh.youngs.iter().map(|y| scale.color(*y).map(linear_from_srgb)).collect();
        mesh.parts.iter_mut().for_each(|p| p.look = 0);
        Some(Asset { mesh, looks: vec![Look { double_sided: true, ..Look::default() }], ..Asset::default() })
    }

    fn paint(&self, picture: &mut Image, seen: &Seen) {
        legend(picture, &Scale::of(&seen.asset.mesh.youngs));
    }
}

/// Colours from soft to stiff, sRGB-encoded: equally spaced points of the map viridis (Smith and van der Walt, public domain).
const MAP: [[f32; 3]; 5] =
    [[0.267, 0.005, 0.329], [0.230, 0.322, 0.546], [0.128, 0.567, 0.551], [0.369, 0.789, 0.383], [0.993, 0.906, 0.144]];
/// Of surface whose stiffness is not known.
const UNKNOWN: [f32; 3] = [0.6; 3];
const INK: [u8; 3] = [40, 40, 48];

/// Whole decades that hold all moduli, as exponents of ten.
struct Scale {
    low: i32,
    high: i32,
}

impl Scale {
    fn of(youngs: &[f32]) -> Self {
        let known = || youngs.iter().filter(|y| **y > 0.0).map(|y| y.log10());
        // What lies on a decade to the last bit of f32 is on it.
        let low = (known().fold(f32::INFINITY, f32::min) + 1e-4).floor() as i32;
        let high = (known().fold(f32::NEG_INFINITY, f32::max) - 1e-4).ceil() as i32;
        // One modulus alone stands in the middle.
        if low >= high { Self { low: low - 1, high: low + 1 } } else { Self { low, high } }
    }

    /// Where a modulus lies between the ends, in \[0, 1\].
    fn share(&self, young: f32) -> f32 {
        ((young.log10() - self.low as f32) / (self.high - self.low) as f32).clamp(0.0, 1.0)
    }

    /// Colour of a modulus [Pa], sRGB-encoded.
    fn color(&self, young: f32) -> [f32; 3] {
        if young > 0.0 { mapped(self.share(young)) } else { UNKNOWN }
    }
}

fn mapped(share: f32) -> [f32; 3] {
    let at = share * (MAP.len() - 1) as f32;
    let k = (at as usize).min(MAP.len() - 2);
    let t = at - k as f32;
    std::array::from_fn(|c| (1.0 - t) * MAP[k][c] + t * MAP[k + 1][c])
}

/// The scale as a bar at the lower left, with its decades.
fn legend(picture: &mut Image, scale: &Scale) {
    let size = (picture.height / 400).max(1);
    let (width, height, margin) = (picture.width / 3, 6 * size, 8 * size);
    let letters = text_size("0", size).1;
    let Some(top) = picture.height.checked_sub(height + letters + margin + 4 * size) else { return };
    for x in 0..width {
        let share = x as f32 / (width.max(2) - 1) as f32;
        let color = mapped(share).map(|v| (255.0 * v).round() as u8);
        fill(picture, margin + x, top, 1, height, color);
    }
    for decade in scale.low..=scale.high {
        let x = margin + ((decade - scale.low) as usize * (width - 1)) / (scale.high - scale.low) as usize;
        fill(picture, x, top, size, height + 2 * size, INK);
        let label = if decade == scale.high { format!("1e{decade} Pa") } else { format!("1e{decade}") };
        text(picture, x.saturating_sub(margin / 2), top + height + 4 * size, &label, size, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_decades_hold_the_moduli_and_colours_go_by_their_logarithm() {
        let scale = Scale::of(&[0.0, 3e4, 2e6]);
        assert_eq!((scale.low, scale.high), (4, 7));
        assert_eq!((scale.color(1e4), scale.color(1e7), scale.color(0.0)), (MAP[0], MAP[4], UNKNOWN));
        let middle = (1e4f32 * 1e7).sqrt();
        assert!((scale.share(middle) - 0.5).abs() < 1e-6 && scale.color(middle)[1] > 0.56);
        let one = Scale::of(&[1e5; 3]);
        assert_eq!((one.low, one.high), (4, 6));
    }
}
