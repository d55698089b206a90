//! Adam with weight decay in the gradient and clipping, and the rate that halves on plateaus.

/// First rate.
const RATE: f64 = 1e-3;
/// Decay of the two moments, and what keeps the quotient finite (Kingma & Ba 2015).
const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;
/// Share of the parameters added to the gradient.
const WEIGHT_DECAY: f64 = 1e-4;
/// Largest length of the gradient.
const CLIP: f64 = 1.0;

/// Adam's moments.
#[derive(Clone, Debug)]
pub struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: i32,
}

impl Adam {
    /// At rest.
    pub fn new(parameters: usize) -> Self {
        Self { first: vec![0.0; parameters], second: vec![0.0; parameters], steps: 0 }
    }

    /// One step down `gradient`, clipped to length 1, with decay.
    pub fn step(&mut self, parameters: &mut [f64], mut gradient: Vec<f64>, rate: f64) {
        let length = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        if length > CLIP {
            gradient.iter_mut().for_each(|g| *g *= CLIP / length);
        }
        gradient.iter_mut().zip(parameters.iter()).for_each(|(g, p)| *g += WEIGHT_DECAY * p);
        parameters.iter_mut().zip(self.direction(&gradient)).for_each(|(p, d)| *p -= rate * d);
    }

    /// Takes note of a gradient; what is to be subtracted from the parameters at rate 1.
    pub fn direction(&mut self, gradient: &[f64]) -> Vec<f64> {
        self.steps += 1;
        let correction = BETA.map(|b| 1.0 - b.powi(self.steps));
        let moments = self.first.iter_mut().zip(&mut self.second);
        let toward = |(&g, (first, second)): (&f64, (&mut f64, &mut f64))| {
            *first += (1.0 - BETA[0]) * (g - *first);
            *second += (1.0 - BETA[1]) * (g * g - *second);
            (*first / correction[0]) / ((*second / correction[1]).sqrt() + EPSILON)
        };
        gradient.iter().zip(moments).map(toward).collect()
    }
}

/// The learning rate: halved when the loss has not fallen for 20 iterations.
#[derive(Clone, Debug)]
pub struct Plateau {
    rate: f64,
    best: f64,
    waited: usize,
}

/// Iterations without progress, factor, and the share by which a loss must fall to count as progress.
const PATIENCE: usize = 20;
const FACTOR: f64 = 0.5;
const THRESHOLD: f64 = 1e-4;

impl Default for Plateau {
    fn default() -> Self {
        Self { rate: RATE, best: f64::INFINITY, waited: 0 }
    }
}

impl Plateau {
    /// The rate for the next step.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Takes note of a loss.
    pub fn hear(&mut self, loss: f64) {
        if loss < self.best * (1.0 - THRESHOLD) {
            (self.best, self.waited) = (loss, 0);
            return;
        }
        self.waited += 1;
        if self.waited > PATIENCE {
            (self.rate, self.waited) = (self.rate * FACTOR, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_as_long_as_the_rate_and_a_bowl_is_descended() {
        let mut x = vec![0.5, -0.3];
        let mut adam = Adam::new(2);
        let slope = |x: &[f64]| vec![2.0 * x[0], 20.0 * x[1]];
        let first = slope(&x);
        adam.step(&mut x, first, RATE);
        assert!((x[0] - 0.499).abs() < 1e-6 && (x[1] + 0.299).abs() < 1e-6, "{x:?}");
        for _ in 0..2000 {
            let g = slope(&x);
            adam.step(&mut x, g, RATE);
        }
        println!("{x:?}");
        assert!(x.iter().all(|v| v.abs() < 1e-2));
    }

    #[test]
    fn the_rate_halves_after_twenty_iterations_without_progress() {
        let mut plateau = Plateau::default();
        plateau.hear(1.0);
        (0..20).for_each(|_| plateau.hear(1.0));
        assert_eq!(plateau.rate(), RATE);
        plateau.hear(1.0);
        assert_eq!(plateau.rate(), RATE * FACTOR);
        plateau.hear(0.5);
        (0..20).for_each(|_| plateau.hear(0.5));
        assert_eq!(plateau.rate(), RATE * FACTOR);
    }
}
