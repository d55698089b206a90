//! The background behind a moving object as far as it has been seen: a picture that grows with every frame and follows the
//! camera's motion.
//!
//! The motion of the background between two frames is the affine part v(x) = A (1, x, y) of the flow outside the object,
//! fitted with Tukey's weights.

use crate::flow::Flow;
use animimic_scene::Image;

/// Colour of the background where it has been seen.
#[derive(Clone, Debug)]
pub(super) struct Plate {
    width: usize,
    height: usize,
    /// Colour [levels]; NaN where nothing is known yet.
    color: Vec<[f32; 3]>,
}

/// Share of the newest frame in what the plate remembers.
const RATE: f32 = 0.5;
/// Motions that move no pixel farther than this leave the plate as it is [px].
const STILL: f32 = 0.25;
/// Distance between the flow samples of the background's motion [px], and its robust scale [px].
const STEP: usize = 8;
const TUKEY: [f32; 4] = [20.0, 8.0, 4.0, 2.0];

impl Plate {
    /// Knows nothing.
    pub fn empty(width: usize, height: usize) -> Self {
        Self { width, height, color: vec![[f32::NAN; 3]; width * height] }
    }

    /// Colour at pixel `i`, if known.
    pub fn at(&self, i: usize) -> Option<[f32; 3]> {
        Some(self.color[i]).filter(|c| !c[0].is_nan())
    }

    /// Takes in the pixels of a frame that are background.
    pub fn learn(&mut self, frame: &Image, is_background: impl Fn(usize) -> bool) {
        for i in 0..self.color.len() {
            if is_background(i) {
                let new = frame.rgb[i].map(f32::from);
                let rate = if self.color[i][0].is_nan() { 1.0 } else { RATE };
                let old = if rate == 1.0 { new } else { self.color[i] };
                self.color[i] = std::array::from_fn(|c| old[c] + rate * (new[c] - old[c]));
            }
        }
    }

    /// Follows the background's motion; `flow` leads from the new frame to the old one, `outside` says where it is
    /// background.
    pub fn follow(&mut self, flow: &Flow, outside: impl Fn(usize) -> bool) {
        let Some(motion) = affine(flow, outside) else { return };
        let (w, h) = (self.width, self.height);
        let shift = |x: usize, y: usize| {
            let (x, y) = (x as f32, y as f32);
            motion.map(|m| m[0] + m[1] * x + m[2] * y)
        };
        let corners = [(0, 0), (w - 1, 0), (0, h - 1), (w - 1, h - 1)];
        if corners.iter().all(|&(x, y)| shift(x, y).iter().all(|v| v.abs() < STILL)) {
            return;
        }
        let old = std::mem::take(&mut self.color);
        self.color = (0..w * h)
            .map(|i| {
                let (x, y) = (i % w, i / w);
                let [u, v] = shift(x, y);
                bilinear(&old, w, h, x as f32 + u, y as f32 + v)
            })
            .collect();
    }

    /// Steepness of the plate at a pixel [levels/px]: how much a slight shift of the background would show.
    pub fn slope(&self, i: usize) -> f32 {
        let (x, y) = (i % self.width, i / self.width);
        let Some(own) = self.at(i) else { return 0.0 };
        let mut steepest = 0.0f32;
        let mut look = |j: usize| {
            if let Some(other) = self.at(j) {
                steepest = steepest.max((0..3).map(|c| (own[c] - other[c]).abs()).fold(0.0, f32::max));
            }
        };
        if x + 1 < self.width {
            look(i + 1);
        }
        if x > 0 {
            look(i - 1);
        }
        if y + 1 < self.height {
            look(i + self.width);
        }
        if y > 0 {
            look(i - self.width);
        }
        steepest
    }

    /// The plate as a picture; what was never seen takes the colour of the nearest seen pixel in its row or column.
    pub fn picture(&self) -> Image {
        let (w, h) = (self.width, self.height);
        let mut out = Image::filled(w, h, [128; 3]);
        for y in 0..h {
            for x in 0..w {
                let near = (0..w.max(h)).find_map(|d| {
                    let places = [
                        (x.checked_sub(d), Some(y)),
                        (Some(x + d), Some(y)),
                        (Some(x), y.checked_sub(d)),
                        (Some(x), Some(y + d)),
                    ];
                    places.into_iter().find_map(|(u, v)| {
                        let (u, v) = (u?, v?);
                        if u < w && v < h { self.at(v * w + u) } else { None }
                    })
                });
                if let Some(color) = near {
                    out.rgb[y * w + x] = color.map(|v| v.round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        out
    }
}

/// Bilinear colour in index space; NaN outside and beside unknown pixels.
fn bilinear(color: &[[f32; 3]], w: usize, h: usize, x: f32, y: f32) -> [f32; 3] {
    if !(x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32) {
        return [f32::NAN; 3];
    }
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    std::array::from_fn(|c| {
        let top = color[y0 * w + x0][c] * (1.0 - fx) + color[y0 * w + x1][c] * fx;
        let bottom = color[y1 * w + x0][c] * (1.0 - fx) + color[y1 * w + x1][c] * fx;
        top * (1.0 - fy) + bottom * fy
    })
}

/// The affine motion (rows: u, v; columns: 1, x, y) of the pixels outside; `None` where too few are left.
fn affine(flow: &Flow, outside: impl Fn(usize) -> bool) -> Option<[[f32; 3]; 2]> {
    let (w, h) = (flow.width, flow.height);
    let samples: Vec<(f32, f32, [f32; 2])> = (STEP / 2..h)
        .step_by(STEP)
        .flat_map(|y| (STEP / 2..w).step_by(STEP).map(move |x| (x, y)))
        .filter(|&(x, y)| outside(y * w + x))
        .map(|(x, y)| (x as f32, y as f32, flow.vectors[y * w + x]))
        .collect();
    if samples.len() < 20 {
        return None;
    }
    let mut motion = [[0.0f32; 3]; 2];
    for (k, row) in motion.iter_mut().enumerate() {
        let mut values: Vec<f32> = samples.iter().map(|s| s.2[k]).collect();
        let middle = values.len() / 2;
        row[0] = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    }
    for tukey in TUKEY {
        let (mut m, mut b) = (glam::DMat3::ZERO, [glam::DVec3::ZERO; 2]);
        for &(x, y, v) in &samples {
            let r: [f32; 2] = std::array::from_fn(|k| v[k] - motion[k][0] - motion[k][1] * x - motion[k][2] * y);
            let s = r[0].hypot(r[1]) / tukey;
            let weight = if s < 1.0 { f64::from((1.0 - s * s).powi(2)) } else { 0.0 };
            let phi = glam::DVec3::new(1.0, f64::from(x), f64::from(y));
            m += glam::DMat3::from_cols(phi * phi.x, phi * phi.y, phi * phi.z) * weight;
            (0..2).for_each(|k| b[k] += phi * (weight * f64::from(v[k])));
        }
        // Few or aligned samples: the motion found so far is all that they tell.
        if m.determinant().abs() < 1e-3 {
            break;
        }
        let inverse = m.inverse();
        motion = b.map(|b| (inverse * b).to_array().map(|v| v as f32));
    }
    Some(motion)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_follows_a_pan_and_keeps_what_is_hidden_meanwhile() {
        let (w, h) = (96, 48);
        let scene = |x: f32, y: f32| [128.0 + 60.0 * (0.3 * x).sin(), 128.0 + 50.0 * (0.25 * y).cos(), 90.0];
        let frame = |t: usize| {
            let rgb = (0..w * h).map(|i| scene((i % w) as f32 + 2.0 * t as f32, (i / w) as f32).map(|v| v as u8));
            Image { width: w, height: h, rgb: rgb.collect() }
        };
        // The camera moves right by 2 px a frame: what is at p was at p + (2, 0). The object stands left and grows right.
        let flow = Flow { width: w, height: h, vectors: vec![[2.0, 0.0]; w * h] };
        let mut plate = Plate::empty(w, h);
        for t in 0..4 {
            if t > 0 {
                plate.follow(&flow, |i| i % w > 40);
            }
            plate.learn(&frame(t), |i| i % w > 20 + 3 * t);
        }
        let (at, truth) = (plate.at(20 * w + 26).expect("seen in frame 0"), scene(26.0 + 6.0, 20.0));
        println!("{at:?}, truth {truth:?}");
        assert!((0..3).all(|c| (at[c] - truth[c]).abs() < 4.0));
        assert!(plate.at(20 * w + 3).is_none());
    }
}
