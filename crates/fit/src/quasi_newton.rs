//! L-BFGS in a given metric, on any manifold with a retraction.
//!
//! Two-loop recursion (Nocedal & Wright, Numerical Optimization, algorithm 7.4) whose initial inverse Hessian is γ P, P a
//! preconditioner and γ = sᵀy / yᵀPy. Steps of earlier iterations are taken over unchanged into the tangent space of the current
//! point: they are small, and only the model of the curvature suffers. Every accepted step descends (Armijo's rule).

use std::collections::VecDeque;

/// Curvature pairs kept.
const MEMORY: usize = 8;
/// Share of the promised decrease that a step must bring.
const SUFFICIENT: f64 = 1e-4;
/// Factor on a step that was refused.
const SHRINK: f64 = 0.4;
/// Refusals after which the search ends.
const MAX_SHRINKS: usize = 6;

/// A function at a point.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// What its value is the sum of.
    pub parts: Vec<f64>,
    /// Its gradient in the tangent space at the point.
    pub gradient: Vec<f64>,
}

impl Evaluation {
    fn value(&self) -> f64 {
        self.parts.iter().sum()
    }

    fn is_finite(&self) -> bool {
        self.value().is_finite() && self.gradient.iter().all(|g| g.is_finite())
    }
}

/// A function to be made small.
pub trait Objective {
    /// Where it lives.
    type Point;
    /// Value and gradient. Most first steps are accepted, so both are asked for at once.
    fn evaluate(&self, at: &Self::Point) -> Evaluation;
    /// An approximate inverse Hessian, symmetric and positive definite, the same for all points.
    fn precondition(&self, gradient: &[f64]) -> Vec<f64>;
    /// Moves along a tangent vector.
    fn retract(&self, at: &Self::Point, step: &[f64]) -> Self::Point;
}

/// Where a descent ended, and how it came there.
pub struct Descent<P> {
    /// The last point.
    pub end: P,
    /// Parts of the value at the start and after each step.
    pub history: Vec<Vec<f64>>,
    /// Steps to where value or gradient is not a number: each was taken back and tried shorter.
    pub not_finite: usize,
}

/// Steps to where something is not a number after which the search ends with the best so far.
const MAX_NOT_FINITE: usize = 3;

/// Goes down from a point in at most `iterations` steps; ends early where a step gains less than the share `tolerance` of
/// the value.
pub fn minimise<O: Objective>(objective: &O, start: O::Point, iterations: usize, tolerance: f64) -> Descent<O::Point> {
    let mut at = start;
    let mut here = objective.evaluate(&at);
    let mut history = vec![here.parts.clone()];
    let mut pairs: VecDeque<Pair> = VecDeque::new();
    let mut not_finite = usize::from(!here.is_finite());
    if not_finite > 0 {
        return Descent { end: at, history, not_finite };
    }
    for _ in 0..iterations {
        let mut step = direction(objective, &pairs, &here.gradient);
        let mut slope = dot(&step, &here.gradient);
        if slope >= 0.0 {
            pairs.clear();
            step = objective.precondition(&here.gradient).iter().map(|v| -v).collect();
            slope = dot(&step, &here.gradient);
        }
        let found = search(objective, &at, here.value(), &step, slope, &mut not_finite);
        let Some((scale, next, there)) = found else { break };
        let gain = here.value() - there.value();
        history.push(there.parts.clone());
        let s: Vec<f64> = step.iter().map(|v| scale * v).collect();
        let y: Vec<f64> = there.gradient.iter().zip(&here.gradient).map(|(a, b)| a - b).collect();
        (at, here) = (next, there);
        if gain < tolerance * here.value().abs() {
            break;
        }
        let sy = dot(&s, &y);
        if sy > 1e-12 * dot(&s, &s).sqrt() * dot(&y, &y).sqrt() {
            if pairs.len() == MEMORY {
                pairs.pop_front();
            }
            pairs.push_back(Pair { s, y, sy });
        }
    }
    Descent { end: at, history, not_finite }
}

/// A step, the change of the gradient along it, and their product.
struct Pair {
    s: Vec<f64>,
    y: Vec<f64>,
    sy: f64,
}

fn direction<O: Objective>(objective: &O, pairs: &VecDeque<Pair>, gradient: &[f64]) -> Vec<f64> {
    let mut q = gradient.to_vec();
    let mut alphas = Vec::new();
    for p in pairs.iter().rev() {
        let alpha = dot(&p.s, &q) / p.sy;
        add(&mut q, &p.y, -alpha);
        alphas.push(alpha);
    }
    let mut r = objective.precondition(&q);
    if let Some(last) = pairs.back() {
        let gamma = last.sy / dot(&last.y, &objective.precondition(&last.y));
        r.iter_mut().for_each(|v| *v *= gamma);
    }
    for (p, alpha) in pairs.iter().zip(alphas.iter().rev()) {
        let beta = dot(&p.y, &r) / p.sy;
        add(&mut r, &p.s, alpha - beta);
    }
    r.iter_mut().for_each(|v| *v = -*v);
    r
}

/// The first of ever shorter steps that descends enough: its length, where it leads, and what is there.
fn search<O: Objective>(
    objective: &O,
    at: &O::Point,
    value: f64,
    step: &[f64],
    slope: f64,
    not_finite: &mut usize,
) -> Option<(f64, O::Point, Evaluation)> {
    let mut scale = 1.0;
    for _ in 0..=MAX_SHRINKS {
        let scaled: Vec<f64> = step.iter().map(|v| scale * v).collect();
        let next = objective.retract(at, &scaled);
        let there = objective.evaluate(&next);
        if !there.is_finite() {
            *not_finite += 1;
            if *not_finite >= MAX_NOT_FINITE {
                return None;
            }
        } else if there.value() <= value + SUFFICIENT * scale * slope && there.value() < value {
            return Some((scale, next, there));
        }
        scale *= SHRINK;
    }
    None
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn add(a: &mut [f64], b: &[f64], scale: f64) {
    a.iter_mut().zip(b).for_each(|(x, y)| *x += scale * y);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stiff bowl with Rosenbrock's bend in every pair; the preconditioner knows the bowl's stiffness or not.
    struct Bowl {
        knows: bool,
    }

    fn stiffness(i: usize) -> f64 {
        10f64.powi((i % 5) as i32)
    }

    impl Objective for Bowl {
        type Point = Vec<f64>;
        fn evaluate(&self, x: &Vec<f64>) -> Evaluation {
            let mut gradient = vec![0.0; x.len()];
            let mut value = 0.0;
            for i in 0..x.len() {
                let bend = if i % 2 == 1 { 0.3 * x[i - 1] * x[i - 1] } else { 0.0 };
                let r = x[i] - 1.0 - bend;
                value += stiffness(i) * r * r;
                gradient[i] += 2.0 * stiffness(i) * r;
                if i % 2 == 1 {
                    gradient[i - 1] -= 2.0 * stiffness(i) * r * 0.6 * x[i - 1];
                }
            }
            Evaluation { parts: vec![0.25 * value, 0.75 * value], gradient }
        }
        fn precondition(&self, g: &[f64]) -> Vec<f64> {
            g.iter().enumerate().map(|(i, v)| if self.knows { 0.5 * v / stiffness(i) } else { 1e-3 * v }).collect()
        }
        fn retract(&self, x: &Vec<f64>, step: &[f64]) -> Vec<f64> {
            x.iter().zip(step).map(|(a, b)| a + b).collect()
        }
    }

    #[test]
    fn it_descends_always_and_soon_where_the_metric_is_known() {
        let run = |knows: bool| -> Vec<f64> {
            let history = minimise(&Bowl { knows }, vec![-1.0; 40], 200, 1e-12).history;
            let values: Vec<f64> = history.iter().map(|parts| parts.iter().sum()).collect();
            assert!(values.windows(2).all(|w| w[1] < w[0]), "every step descends");
            values
        };
        let (with, without) = (run(true), run(false));
        println!("{} steps to {:.1e} with the metric", with.len(), with[with.len() - 1]);
        println!("{} steps to {:.1e} without", without.len(), without[without.len() - 1]);
        assert!(with[with.len() - 1] < 1e-6 && with.len() < 80);
        assert!(with.len() < without.len());
    }

    /// A bowl whose value, or gradient alone, is not a number beyond a distance from the origin.
    struct Cliff {
        at: f64,
        gradient_only: bool,
    }

    impl Objective for Cliff {
        type Point = f64;
        fn evaluate(&self, x: &f64) -> Evaluation {
            let beyond = if x.abs() > self.at { f64::NAN } else { 0.0 };
            let value = (x - 1.0).powi(2) + if self.gradient_only { 0.0 } else { beyond };
            Evaluation { parts: vec![value], gradient: vec![2.0 * (x - 1.0) + beyond] }
        }
        fn precondition(&self, g: &[f64]) -> Vec<f64> {
            vec![0.5 * g[0]]
        }
        fn retract(&self, x: &f64, step: &[f64]) -> f64 {
            x + step[0]
        }
    }

    #[test]
    fn what_is_not_a_number_is_stepped_back_from_and_told() {
        for (at, gradient_only) in [(0.5, false), (0.5, true), (0.01, false), (-1.0, false)] {
            let found = minimise(&Cliff { at, gradient_only }, 0.0, 50, 1e-9);
            println!("cliff at {at}: ends at {} after {} not finite", found.end, found.not_finite);
            assert!((1..=MAX_NOT_FINITE).contains(&found.not_finite) && found.end <= at.max(0.0));
            // Where shortening helps, it goes on; else it stays where it was.
            assert_eq!(found.end > 0.0, at == 0.5);
        }
    }
}
