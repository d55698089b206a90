//! The generic gradient check: central differences along random directions, best over several step sizes.

/// Deterministic pseudo-random numbers for tests and sampling (SplitMix64, Steele et al. 2014).
#[derive(Clone, Debug)]
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    /// Next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in \[0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let (u, v) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// Largest relative error between an analytic gradient and central differences along random directions.
///
/// For each of `directions` unit directions d, compares ⟨g, d⟩ with (f(x + εd) − f(x − εd)) / 2ε for ε in `steps` and keeps
/// the best; the error is relative to max(|⟨g, d⟩|, |g|/√n), so that directions almost orthogonal to g do not dominate.
pub fn gradient_error(
    mut f: impl FnMut(&[f64]) -> f64,
    x: &[f64],
    gradient: &[f64],
    directions: usize,
    steps: &[f64],
    seed: u64,
) -> f64 {
    assert_eq!(x.len(), gradient.len(), "gradient has one entry per parameter");
    let mut rng = SplitMix64(seed);
    let scale = gradient.iter().map(|g| g * g).sum::<f64>().sqrt() / (x.len() as f64).sqrt();
    let mut worst = 0.0f64;
    for _ in 0..directions {
        let mut d: Vec<f64> = x.iter().map(|_| rng.normal()).collect();
        let norm = d.iter().map(|v| v * v).sum::<f64>().sqrt();
        d.iter_mut().for_each(|v| *v /= norm);
        let analytic: f64 = gradient.iter().zip(&d).map(|(g, v)| g * v).sum();
        let best = steps
            .iter()
            .map(|&step| {
                let moved = |s: f64| -> Vec<f64> { x.iter().zip(&d).map(|(a, b)| a + s * b).collect() };
                let numeric = (f(&moved(step)) - f(&moved(-step))) / (2.0 * step);
                (numeric - analytic).abs() / analytic.abs().max(scale).max(1e-300)
            })
            .fold(f64::INFINITY, f64::min);
        worst = worst.max(best);
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_right_gradient_passes_and_a_wrong_one_does_not() {
        let f = |x: &[f64]| x[0].sin() * x[1] + x[1].powi(3);
        let x = [0.4_f64, -1.3];
        let g = [x[0].cos() * x[1], x[0].sin() + 3.0 * x[1] * x[1]];
        assert!(gradient_error(f, &x, &g, 8, &[1e-3, 1e-4, 1e-5], 1) < 1e-8);
        assert!(gradient_error(f, &x, &[g[0] * 1.01, g[1]], 8, &[1e-3, 1e-4, 1e-5], 1) > 1e-4);
    }
}
