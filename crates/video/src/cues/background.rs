//! A plain but uneven background: one quadratic surface per colour channel for the video, one offset per frame.
//!
//! c(x, y, t) = Σ_k β_k φ_k(x, y) + o_t, φ = (1, x, y, x², xy, y²), x and y in \[−1, 1\]; fitted by least squares with
//! Tukey's weights, because the object may touch the border.

use animimic_scene::{Image, Video};

/// Colour of the background everywhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Background {
    /// Coefficients β \[channel\]\[k\] [levels].
    pub coefficients: [[f64; 6]; 3],
    /// Offset \[frame\]\[channel\] [levels].
    pub drift: Vec<[f64; 3]>,
    /// Median absolute residual at the border \[frame\] [levels].
    pub residual: Vec<f64>,
    /// Pictures of a background that is not plain \[frame\]; empty for a plain one.
    pub plates: Vec<Image>,
}

/// Width of the border that is taken for background, as a share of the shorter side.
const BORDER_SHARE: f64 = 0.03;
/// Samples per frame at most; frames that enter the fit at most.
const SAMPLES: usize = 1_500;
const FRAMES: usize = 24;
/// Tukey's constant [levels]: residuals beyond have no weight.
const TUKEY: [f64; 4] = [60.0, 30.0, 15.0, 10.0];

fn basis(x: f64, y: f64) -> [f64; 6] {
    [1.0, x, y, x * x, x * y, y * y]
}

/// Pixel → [−1, 1]².
fn normalised(image: &Image, x: usize, y: usize) -> (f64, f64) {
    ((2 * x + 1) as f64 / image.width as f64 - 1.0, (2 * y + 1) as f64 / image.height as f64 - 1.0)
}

impl Background {
    /// Colour at a pixel of a frame [levels].
    pub fn at(&self, image: &Image, t: usize, x: usize, y: usize) -> [f32; 3] {
        if let Some(plate) = self.plates.get(t) {
            return plate.at(x, y).map(f32::from);
        }
        let (u, v) = normalised(image, x, y);
        let phi = basis(u, v);
        std::array::from_fn(|c| {
            (self.drift[t][c] + self.coefficients[c].iter().zip(phi).map(|(b, p)| b * p).sum::<f64>()) as f32
        })
    }

    /// Fits the model to the pixels for which `is_background(frame, x, y)` holds.
    fn fit(video: &Video, start: Self, is_background: &dyn Fn(usize, usize, usize) -> bool) -> Self {
        let (w, h) = (video.frames[0].width, video.frames[0].height);
        let n = video.frames.len();
        let step = ((w * h) as f64 / (4.0 * SAMPLES as f64)).sqrt().floor().max(1.0) as usize;
        let used: Vec<usize> = (0..n).step_by(n.div_ceil(FRAMES)).collect();
        let samples: Vec<(usize, usize, usize)> = used
            .iter()
            .flat_map(|&t| (0..h).step_by(step).flat_map(move |y| (0..w).step_by(step).map(move |x| (t, x, y))))
            .filter(|&(t, x, y)| is_background(t, x, y))
            .collect();
        if samples.len() < 50 {
            return start;
        }
        let mut model = start;
        for tukey in TUKEY {
            for c in 0..3 {
                let mut system = [[0.0f64; 7]; 6];
                for &(t, x, y) in &samples {
                    let image = &video.frames[t];
                    let value = f64::from(image.at(x, y)[c]);
                    let r = (value - f64::from(model.at(image, t, x, y)[c])) / tukey;
                    let weight = if r.abs() < 1.0 { (1.0 - r * r).powi(2) } else { 0.0 };
                    let (u, v) = normalised(image, x, y);
                    let phi = basis(u, v);
                    for i in 0..6 {
                        for j in 0..6 {
                            system[i][j] += weight * phi[i] * phi[j];
                        }
                        system[i][6] += weight * phi[i] * (value - model.drift[t][c]);
                    }
                }
                if let Some(solution) = solve(system) {
                    model.coefficients[c] = solution;
                }
            }
            model.update_drift(video, is_background, step);
        }
        model
    }

    /// Offsets: medians of the residuals near the model.
    fn update_drift(&mut self, video: &Video, is_background: &dyn Fn(usize, usize, usize) -> bool, step: usize) {
        for (t, image) in video.frames.iter().enumerate() {
            let mut residuals: [Vec<f64>; 3] = Default::default();
            for y in (0..image.height).step_by(step) {
                for x in (0..image.width).step_by(step) {
                    if is_background(t, x, y) {
                        let expected = self.at(image, t, x, y);
                        for c in 0..3 {
                            residuals[c].push(f64::from(image.at(x, y)[c]) - f64::from(expected[c]));
                        }
                    }
                }
            }
            for c in 0..3 {
                self.drift[t][c] += median(&mut residuals[c]);
            }
            let mut spread: Vec<f64> = residuals.iter().flatten().map(|r| r.abs()).collect();
            self.residual[t] = median(&mut spread);
        }
    }

    /// Fits to the border of all frames.
    pub fn from_border(video: &Video) -> Self {
        let image = &video.frames[0];
        let (w, h) = (image.width, image.height);
        let border = ((BORDER_SHARE * w.min(h) as f64).round() as usize).max(2);
        let inside = move |_: usize, x: usize, y: usize| x < border || y < border || x + border >= w || y + border >= h;
        let mut model = Self {
            coefficients: [[0.0; 6]; 3],
            drift: vec![[0.0; 3]; video.frames.len()],
            residual: vec![0.0; video.frames.len()],
            plates: Vec::new(),
        };
        for c in 0..3 {
            let mut values = Vec::new();
            for y in 0..h {
                for x in (0..w).filter(|&x| inside(0, x, y)) {
                    values.push(f64::from(image.at(x, y)[c]));
                }
            }
            model.coefficients[c][0] = median(&mut values);
        }
        Self::fit(video, model, &inside)
    }

    /// Fits again to all pixels outside the objects found so far (`inside(frame, x, y)`, with a margin).
    pub fn refitted(self, video: &Video, inside: &dyn Fn(usize, usize, usize) -> bool) -> Self {
        Self::fit(video, self, &|t, x, y| !inside(t, x, y))
    }
}

fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Gaussian elimination with partial pivoting; `None` when singular.
fn solve(mut m: [[f64; 7]; 6]) -> Option<[f64; 6]> {
    for i in 0..6 {
        let pivot = (i..6).max_by(|&a, &b| m[a][i].abs().total_cmp(&m[b][i].abs()))?;
        if m[pivot][i].abs() < 1e-9 {
            return None;
        }
        m.swap(i, pivot);
        for row in 0..6 {
            if row != i {
                let factor = m[row][i] / m[i][i];
                for k in i..7 {
                    m[row][k] -= factor * m[i][k];
                }
            }
        }
    }
    Some(std::array::from_fn(|i| m[i][6] / m[i][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shaded_drifting_background_is_recovered_although_an_object_touches_the_border() {
        let (w, h) = (90, 70);
        let truth = |t: usize, x: usize, y: usize| {
            let (u, v) = (x as f64 / 90.0, y as f64 / 70.0);
            200.0 + 20.0 * u - 15.0 * v * v + 2.0 * t as f64
        };
        let frames = (0..6)
            .map(|t| {
                let mut image = Image::filled(w, h, [0; 3]);
                for y in 0..h {
                    for x in 0..w {
                        let value = if (20..45).contains(&x) && y > 10 { 90.0 } else { truth(t, x, y) };
                        image.rgb[y * w + x] = [value.round() as u8; 3];
                    }
                }
                image
            })
            .collect();
        let video = Video { fps: 24.0, frames, ..Video::default() };
        let model = Background::from_border(&video);
        let mut worst = 0.0f64;
        for t in 0..6 {
            for y in 0..h {
                for x in 0..w {
                    worst = worst.max((f64::from(model.at(&video.frames[t], t, x, y)[1]) - truth(t, x, y)).abs());
                }
            }
        }
        println!("worst residual {worst:.2} levels");
        assert!(worst < 2.0);
    }
}
