//! Robust losses ρ(n) of a residual norm, with their IRLS weights ρ'(n) / 2n.

/// A robust loss; all behave like n² near zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// n².
    Squared,
    /// n² below the threshold, 2hn − h² above (Huber 1964, without the ½).
    Huber(f64),
    /// c²n² / (c² + n²) (Geman & McClure 1987): outliers lose all influence.
    GemanMcClure(f64),
}

impl Robust {
    /// ρ(n).
    pub fn loss(self, n: f64) -> f64 {
        match self {
            Robust::Squared => n * n,
            Robust::Huber(h) => {
                if n < h {
                    n * n
                } else {
                    2.0 * h * n - h * h
                }
            }
            Robust::GemanMcClure(c) => c * c * n * n / (c * c + n * n),
        }
    }

    /// ρ'(n) / (2n).
    pub fn weight(self, n: f64) -> f64 {
        match self {
            Robust::Squared => 1.0,
            Robust::Huber(h) => {
                if n < h {
                    1.0
                } else {
                    h / n
                }
            }
            Robust::GemanMcClure(c) => {
                let s = c * c / (c * c + n * n);
                s * s
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn irls_weights_are_the_derivatives_of_the_losses() {
        for robust in [Robust::Squared, Robust::Huber(2.0), Robust::GemanMcClure(4.0)] {
            for n in [0.1, 1.0, 1.9, 2.1, 5.0, 30.0] {
                let numeric = (robust.loss(n + 1e-5) - robust.loss(n - 1e-5)) / 2e-5;
                let analytic = 2.0 * n * robust.weight(n);
                assert!((numeric - analytic).abs() < 1e-7 * analytic.max(1.0), "{robust:?} at {n}");
            }
        }
    }
}
