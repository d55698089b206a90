//! Which colours are the object's: two histograms over RGB.

use animimic_scene::Image;

/// Levels per bin, bins per channel.
const LEVELS: usize = 16;
const BINS: usize = 256 / LEVELS;
/// What a frame weighs when the next one comes: colours seen long ago count less.
const MEMORY: f32 = 0.9;
/// Share of evenly spread colour in both histograms, so that unseen colours say nothing.
const EVEN: f32 = 0.05;

/// Counts of the object's and the background's colours.
#[derive(Clone, Debug)]
pub(super) struct Colors {
    counts: [Vec<f32>; 2],
}

fn bin(p: [u8; 3]) -> usize {
    (usize::from(p[0]) / LEVELS * BINS + usize::from(p[1]) / LEVELS) * BINS + usize::from(p[2]) / LEVELS
}

impl Colors {
    /// Has seen nothing.
    pub fn empty() -> Self {
        Self { counts: [vec![0.0; BINS.pow(3)], vec![0.0; BINS.pow(3)]] }
    }

    /// Takes in a frame: `label(pixel)` is `Some(true)` on the object, `Some(false)` on the background.
    pub fn learn(&mut self, frame: &Image, label: impl Fn(usize) -> Option<bool>) {
        self.counts.iter_mut().flatten().for_each(|c| *c *= MEMORY);
        for (i, &p) in frame.rgb.iter().enumerate() {
            if let Some(inside) = label(i) {
                self.counts[usize::from(inside)][bin(p)] += 1.0;
            }
        }
    }

    /// ln(p(colour | object) / p(colour | background)) per bin, over histograms smoothed by one bin.
    pub fn log_ratios(&self) -> Vec<f32> {
        let [background, object] = [&self.counts[0], &self.counts[1]].map(|c| smoothed(c));
        let sums = [background.iter().sum::<f32>().max(1.0), object.iter().sum::<f32>().max(1.0)];
        let even = EVEN / BINS.pow(3) as f32;
        let share = |count: f32, sum: f32| (1.0 - EVEN) * count / sum + even;
        object.iter().zip(&background).map(|(o, b)| (share(*o, sums[1]) / share(*b, sums[0])).ln()).collect()
    }

    /// The entry of [`Colors::log_ratios`] for a colour.
    pub fn look_up(ratios: &[f32], p: [u8; 3]) -> f32 {
        ratios[bin(p)]
    }
}

/// Binomial smoothing (1 2 1) along the three axes.
fn smoothed(counts: &[f32]) -> Vec<f32> {
    let mut out = counts.to_vec();
    for stride in [1, BINS, BINS * BINS] {
        let old = out.clone();
        for (i, v) in out.iter_mut().enumerate() {
            let k = i / stride % BINS;
            let below = if k > 0 { old[i - stride] } else { old[i] };
            let above = if k + 1 < BINS { old[i + stride] } else { old[i] };
            *v = 0.25 * (below + 2.0 * old[i] + above);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_the_object_speak_for_it_and_unseen_ones_for_nobody() {
        let mut image = Image::filled(20, 20, [40, 60, 200]);
        image.rgb[..100].fill([200, 30, 30]);
        let mut colors = Colors::empty();
        colors.learn(&image, |i| Some(i < 100));
        let ratios = colors.log_ratios();
        let of = |p| Colors::look_up(&ratios, p);
        println!("{} {} {}", of([198, 28, 29]), of([41, 61, 199]), of([120, 240, 120]));
        assert!(of([198, 28, 29]) > 2.0 && of([41, 61, 199]) < -2.0 && of([120, 240, 120]).abs() < 1e-3);
    }
}
