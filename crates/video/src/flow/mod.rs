//! Dense optical flow between two frames.

use animimic_scene::Image;

mod consistency;
mod dis;
mod gray;
mod relax;
mod variational;

pub use consistency::consistency;
pub use dis::{FlowOptions, dis};
pub use gray::Gray;

/// A displacement per pixel: what is at p in the first image is at p + flow(p) in the second.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flow {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Displacement [px], `[y * width + x]`.
    pub vectors: Vec<[f32; 2]>,
}

impl Flow {
    /// No motion.
    pub fn zero(width: usize, height: usize) -> Self {
        Self { width, height, vectors: vec![[0.0; 2]; width * height] }
    }

    /// Bilinear displacement at a pixel position (pixel centres at +0.5), clamped at the border.
    pub fn at(&self, p: [f32; 2]) -> [f32; 2] {
        let x = (p[0] - 0.5).clamp(0.0, (self.width - 1) as f32);
        let y = (p[1] - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let v = |x: usize, y: usize| self.vectors[y * self.width + x];
        let (a, b, c, d) = (v(x0, y0), v(x1, y0), v(x0, y1), v(x1, y1));
        std::array::from_fn(|k| {
            let top = a[k] + fx * (b[k] - a[k]);
            let bottom = c[k] + fx * (d[k] - c[k]);
            top + fy * (bottom - top)
        })
    }
}

/// Flow between all neighbours of a sequence, in parallel: (t → t + 1, t + 1 → t) \[t\].
pub fn neighbours(frames: &[Image], options: &FlowOptions) -> Vec<(Flow, Flow)> {
    use rayon::prelude::*;
    let grays: Vec<Gray> = frames.par_iter().map(Gray::from_image).collect();
    grays.par_windows(2).map(|w| (dis(&w[0], &w[1], options), dis(&w[1], &w[0], options))).collect()
}
