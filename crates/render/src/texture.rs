//! Texture lookup: bilinear within a mip level, linear between two levels (glTF 2.0, 3.8.4; OpenGL ES 3.0, 3.8.9–10).
//!
//! Levels are kept as 8-bit sRGB, as a graphics card keeps them, and decoded to linear light at lookup.

use animimic_scene::Texture;
use animimic_scene::image::{linear_from_srgb, srgb_from_linear};
use std::sync::LazyLock;
use wide::f32x4;

/// sRGB byte → linear light.
pub(crate) static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb(byte as f32 / 255.0)));

/// A texture with its mip levels.
#[derive(Clone, Debug)]
pub struct MipTexture {
    /// Level 0 is the texture itself; each further one is half as large, down to 1×1.
    pub levels: Vec<Level>,
    repeat: [bool; 2],
    nearest: bool,
}

/// One mip level.
#[derive(Clone, Debug)]
pub struct Level {
    /// Width [texel].
    pub width: usize,
    /// Height [texel].
    pub height: usize,
    /// sRGB-encoded RGB and linear alpha, row by row.
    pub texels: Vec<[u8; 4]>,
}

/// A looked-up colour and how it changes with the texture coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Linear RGB.
    pub rgb: [f32; 3],
    /// ∂rgb/∂u.
    pub d_u: [f32; 3],
    /// ∂rgb/∂v.
    pub d_v: [f32; 3],
}

/// A texel and its share in a lookup.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tap {
    /// Mip level.
    pub level: u8,
    /// Texel index in the level.
    pub texel: u32,
    /// Share; a lookup's shares sum to 1.
    pub weight: f32,
}

impl MipTexture {
    /// Builds the levels. Textures without pixels become one white texel.
    pub fn new(texture: &Texture) -> Self {
        let image = &texture.image;
        let texels: Vec<[u8; 4]> = image
            .rgb
            .iter()
            .enumerate()
            .map(|(k, &[r, g, b])| [r, g, b, texture.alpha.get(k).copied().unwrap_or(255)])
            .collect();
        let mut levels = vec![if texels.is_empty() || texels.len() != image.width * image.height {
            Level { width: 1, height: 1, texels: vec![[255; 4]] }
        } else {
            Level { width: image.width, height: image.height, texels }
        }];
        while let Some(next) = levels.last().and_then(halved) {
            levels.push(next);
        }
        Self { levels, repeat: texture.repeat, nearest: texture.nearest }
    }

    /// Level of detail for the larger of the two footprints of a pixel, ∂(u, v)/∂x and ∂(u, v)/∂y: log₂ of texels per pixel.
    pub fn level_of_detail(&self, along_x: [f32; 2], along_y: [f32; 2]) -> f32 {
        let (w, h) = (self.levels[0].width as f32, self.levels[0].height as f32);
        let square = |d: [f32; 2]| (d[0] * w).powi(2) + (d[1] * h).powi(2);
        0.5 * square(along_x).max(square(along_y)).max(1e-12).log2()
    }

    /// Looks up linear RGB with its derivative; `lod` as [`MipTexture::level_of_detail`], held fixed in the derivative.
    #[inline(always)]
    pub fn sample(&self, uv: [f32; 2], lod: f32) -> Sample {
        let (level, fraction) = self.split(lod);
        let a = self.bilinear(level, uv, lod);
        if fraction == 0.0 {
            return a;
        }
        let b = self.bilinear(level + 1, uv, lod);
        let mix = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|c| a[c] + fraction * (b[c] - a[c]));
        Sample { rgb: mix(a.rgb, b.rgb), d_u: mix(a.d_u, b.d_u), d_v: mix(a.d_v, b.d_v) }
    }

    /// Adjoint of the looked-up colour with respect to the uv coordinates.
    pub fn sample_vjp_uv(sample: &Sample, d_rgb: [f32; 3]) -> [f32; 2] {
        let dot = |a: [f32; 3]| a[0] * d_rgb[0] + a[1] * d_rgb[1] + a[2] * d_rgb[2];
        [dot(sample.d_u), dot(sample.d_v)]
    }

    /// The texels of a lookup with their shares: ∂rgb/∂(linear texel). Unused entries have no weight.
    pub fn taps(&self, uv: [f32; 2], lod: f32) -> [Tap; 8] {
        let (level, fraction) = self.split(lod);
        let mut taps = [Tap::default(); 8];
        for (k, share) in [1.0 - fraction, fraction].into_iter().enumerate() {
            if share == 0.0 {
                continue;
            }
            let at = self.corners(level + k, uv, lod);
            let [fx, fy] = at.fraction;
            let shares = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
            for c in 0..4 {
                taps[4 * k + c] =
                    Tap { level: (level + k) as u8, texel: at.texel[c] as u32, weight: share * shares[c] };
            }
        }
        taps
    }

    /// Alpha in \[0, 1\] at full resolution.
    pub fn alpha(&self, uv: [f32; 2]) -> f32 {
        let at = self.corners(0, uv, 0.0);
        let a = at.texel.map(|t| f32::from(self.levels[0].texels[t][3]) / 255.0);
        let [fx, fy] = at.fraction;
        let (top, bottom) = (a[0] + fx * (a[1] - a[0]), a[2] + fx * (a[3] - a[2]));
        top + fy * (bottom - top)
    }

    fn split(&self, lod: f32) -> (usize, f32) {
        let last = (self.levels.len() - 1) as f32;
        let lod = if lod > 0.0 { lod.min(last) } else { 0.0 };
        let level = lod.floor();
        (level as usize, lod - level)
    }

    #[inline(always)]
    fn bilinear(&self, level: usize, uv: [f32; 2], lod: f32) -> Sample {
        let at = self.corners(level, uv, lod);
        let l = &self.levels[level];
        let linear = &*LINEAR;
        // Not `map`: it is called, not inlined, and this is where a drawing spends its time.
        let texel = |k: usize| {
            let [r, g, b, _] = l.texels[at.texel[k]];
            f32x4::new([linear[r as usize], linear[g as usize], linear[b as usize], 0.0])
        };
        let t = [texel(0), texel(1), texel(2), texel(3)];
        let [fx, fy] = at.fraction;
        let (w, h) = if at.stepped { (0.0, 0.0) } else { (l.width as f32, l.height as f32) };
        let (dx0, dx1) = (t[1] - t[0], t[3] - t[2]);
        let (top, bottom) = (t[0] + dx0 * fx, t[2] + dx1 * fx);
        let down = bottom - top;
        let rgb = |v: f32x4| {
            let [r, g, b, _] = v.to_array();
            [r, g, b]
        };
        Sample { rgb: rgb(top + down * fy), d_u: rgb((dx0 + (dx1 - dx0) * fy) * w), d_v: rgb(down * h) }
    }

    #[inline(always)]
    fn corners(&self, level: usize, uv: [f32; 2], lod: f32) -> Corners {
        let l = &self.levels[level];
        let size = [l.width, l.height];
        let stepped = self.nearest && lod <= 0.0;
        let mut low = [0; 2];
        let mut high = [0; 2];
        let mut fraction = [0.0; 2];
        for k in 0..2 {
            let n = size[k] as f32;
            let c = if self.repeat[k] { uv[k] - uv[k].floor() } else { uv[k].clamp(0.0, 1.0) };
            // Not finite coordinates land on texel 0.
            let x = if c.is_finite() { c * n - 0.5 } else { 0.0 };
            let floor = if stepped { (x + 0.5).floor() } else { x.floor() };
            fraction[k] = if stepped { 0.0 } else { x - floor };
            // At most one texel outside, on either side.
            let (i, n) = (floor as i32, size[k] as i32);
            let wrap = |i: i32| {
                let inside = if self.repeat[k] { [n - 1, 0] } else { [0, n - 1] };
                (if i < 0 {
                    inside[0]
                } else if i >= n {
                    inside[1]
                } else {
                    i
                }) as usize
            };
            low[k] = wrap(i);
            high[k] = wrap(i + 1);
        }
        let w = l.width;
        let texel = [low[1] * w + low[0], low[1] * w + high[0], high[1] * w + low[0], high[1] * w + high[0]];
        Corners { texel, fraction, stepped }
    }
}

struct Corners {
    texel: [usize; 4],
    fraction: [f32; 2],
    stepped: bool,
}

/// ∂L/∂(linear texel) for all levels of a texture.
#[derive(Clone, Debug, Default)]
pub struct TexelAdjoint {
    /// Cotangents \[level\]\[texel\].
    levels: Vec<Vec<[f32; 3]>>,
}

impl TexelAdjoint {
    /// Zeros for a texture; nothing for no texture.
    pub fn new(texture: Option<&MipTexture>) -> Self {
        let levels = texture.map_or(Vec::new(), |t| t.levels.iter().map(|l| vec![[0.0; 3]; l.texels.len()]).collect());
        Self { levels }
    }

    /// Adjoint of one lookup.
    pub fn add(&mut self, taps: [Tap; 8], d_rgb: [f32; 3]) {
        for tap in taps.iter().filter(|t| t.weight != 0.0) {
            let d = &mut self.levels[tap.level as usize][tap.texel as usize];
            (0..3).for_each(|c| d[c] += tap.weight * d_rgb[c]);
        }
    }

    /// Adjoint of the mip levels as means of each other: ∂L/∂(linear texel) of the texture itself. The rounding of each level
    /// to 8 bits counts as the identity.
    pub fn collapsed(mut self, texture: &MipTexture) -> Vec<[f32; 3]> {
        while self.levels.len() > 1 {
            let Some(coarse) = self.levels.pop() else { break };
            let fine = self.levels.len() - 1;
            let (level, next) = (&texture.levels[fine], &texture.levels[fine + 1]);
            for (cell, d) in coarse.iter().enumerate() {
                for texel in quad(level, cell % next.width, cell / next.width) {
                    (0..3).for_each(|c| self.levels[fine][texel][c] += 0.25 * d[c]);
                }
            }
        }
        self.levels.pop().unwrap_or_default()
    }
}

/// The four texels under a texel of the next level (repeated where the level is one texel thin).
fn quad(level: &Level, x: usize, y: usize) -> [usize; 4] {
    [(0, 0), (1, 0), (0, 1), (1, 1)]
        .map(|(dx, dy)| (2 * y + dy).min(level.height - 1) * level.width + (2 * x + dx).min(level.width - 1))
}

/// The next mip level: means of 2×2 texels in linear light.
fn halved(level: &Level) -> Option<Level> {
    if level.width == 1 && level.height == 1 {
        return None;
    }
    let (width, height) = ((level.width / 2).max(1), (level.height / 2).max(1));
    let mut texels = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0f32; 4];
            for texel in quad(level, x, y) {
                let [r, g, b, a] = level.texels[texel];
                let linear = [LINEAR[r as usize], LINEAR[g as usize], LINEAR[b as usize], f32::from(a) / 255.0];
                (0..4).for_each(|c| sum[c] += 0.25 * linear[c]);
            }
            let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
            let encoded = [0, 1, 2].map(|c| byte(srgb_from_linear(sum[c])));
            texels.push([encoded[0], encoded[1], encoded[2], byte(sum[3])]);
        }
    }
    Some(Level { width, height, texels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::painted;

    fn texture(nearest: bool) -> MipTexture {
        let mut t = painted(64).texture.expect("painted looks have a texture");
        t.nearest = nearest;
        MipTexture::new(&t)
    }

    #[test]
    fn a_texel_centre_returns_the_texel_and_wrapping_repeats() {
        let t = texture(false);
        let texel = t.levels[0].texels[5 * 64 + 7];
        let uv = [7.5 / 64.0, 5.5 / 64.0];
        for uv in [uv, [uv[0] + 3.0, uv[1] - 2.0]] {
            let s = t.sample(uv, -1.0);
            (0..3).for_each(|c| assert!((s.rgb[c] - LINEAR[texel[c] as usize]).abs() < 1e-4));
        }
    }

    #[test]
    fn lookups_have_an_exact_gradient_to_coordinates_and_their_shares_reproduce_them() {
        let t = texture(false);
        let mut worst = 0.0f32;
        for k in 0..50 {
            let uv = [0.013 + 0.0197 * k as f32, 0.41 + 0.0071 * k as f32];
            let lod = -0.5 + 0.06 * k as f32;
            let s = t.sample(uv, lod);
            let taps = t.taps(uv, lod);
            let step = 1e-4;
            for c in 0..3 {
                let sum: f32 = taps
                    .iter()
                    .map(|p| p.weight * LINEAR[t.levels[p.level as usize].texels[p.texel as usize][c] as usize])
                    .sum();
                worst = worst.max((sum - s.rgb[c]).abs());
                let at = |u: f32, v: f32| t.sample([u, v], lod).rgb[c];
                let numeric = (at(uv[0] + step, uv[1]) - at(uv[0] - step, uv[1])) / (2.0 * step);
                // A step across a texel border sees two slopes: compare only away from one.
                let x = uv[0] * 64.0 - 0.5;
                if lod <= 0.0 && (x - x.round()).abs() > 0.02 {
                    assert!((numeric - s.d_u[c]).abs() < 2e-2 * s.d_u[c].abs().max(0.5), "{numeric} {}", s.d_u[c]);
                }
            }
        }
        println!("worst difference of the sum of shares {worst:.1e}");
        assert!(worst < 1e-6);
    }

    #[test]
    fn nearest_textures_do_not_blend_and_the_last_level_is_the_mean() {
        let t = texture(true);
        let a = t.sample([7.1 / 64.0, 5.9 / 64.0], -1.0);
        assert_eq!(a.rgb, t.sample([7.5 / 64.0, 5.5 / 64.0], -1.0).rgb);
        assert_eq!(a.d_u, [0.0; 3]);
        let mean: f32 = t.levels[0].texels.iter().map(|p| LINEAR[p[0] as usize]).sum::<f32>() / 4096.0;
        let last = t.sample([0.3, 0.3], 20.0).rgb[0];
        println!("mean {mean} last level {last}");
        assert!((mean - last).abs() < 0.01);
    }
}
