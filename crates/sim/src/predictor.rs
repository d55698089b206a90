//! Where Newton starts: the best of a few guesses, by the objective itself.
//!
//! The chosen predictor comes first. The linear one is no guide out of collapsed tets, so the inertial one may replace it;
//! and where the step starts from tets that are flat or inverted, the rest shape moved rigidly to where the body is may
//! replace both. At F = 0 stable neo-Hookean has neither force nor stiffness: without that third guess a body collapsed to a
//! point would stay one.

use crate::assembly;
use crate::body::Body;
use crate::filter::Eigenvalues;
use crate::settings::{Predictor, StepReport};
use crate::stepper::{Assembled, Objective, Stepper};
use animimic_math::lanes::{Mat3x4, splat};
use animimic_math::polar3::polar3;
use glam::DVec3;

impl Stepper<'_> {
    /// The best first guess, driven vertices in place, and what was assembled there.
    pub(crate) fn first_guess(
        &mut self,
        objective: &Objective,
        driven: &[DVec3],
        report: &mut StepReport,
    ) -> (Vec<DVec3>, Assembled) {
        let mut y = match self.settings.predictor {
            Predictor::Inertial => objective.target.clone(),
            Predictor::Rest => objective.start.positions.clone(),
            Predictor::Linear => self.predict_linear(objective, driven, report),
        };
        self.place_driven(&mut y, driven);
        let now = self.assemble(objective, &y, self.eigenvalues());
        let mut others = vec![];
        if self.settings.predictor == Predictor::Linear {
            others.push(objective.target.clone());
        }
        // A start that is in order is never left for the rest shape: it may have buckled.
        if self.count_inverted(&objective.start.positions) > 0 {
            others.push(rest_shape_at(self.body, &objective.target, driven));
        }
        let mut best: Option<(f64, Vec<DVec3>)> = None;
        for mut guess in others {
            self.place_driven(&mut guess, driven);
            let value = self.value(objective, &guess);
            let lowest = best.as_ref().map_or(now.value, |b| b.0);
            // A guess whose value is not a number is worse than any.
            if value < lowest || lowest.is_nan() {
                best = Some((value, guess));
            }
        }
        let Some((_, guess)) = best else { return (y, now) };
        let now = self.assemble(objective, &guess, self.eigenvalues());
        (guess, now)
    }

    fn place_driven(&self, y: &mut [DVec3], driven: &[DVec3]) {
        self.body.driven.iter().zip(driven).for_each(|(&v, d)| y[v as usize] = *d);
    }

    /// xⁿ + u, u the driven displacement on driven vertices and the linear response to it and to inertia elsewhere.
    fn predict_linear(&mut self, objective: &Objective, driven: &[DVec3], report: &mut StepReport) -> Vec<DVec3> {
        let start = &objective.start.positions;
        if self.factor.is_none() {
            // Clamped: the start may be anything, and a predictor need not be exact.
            self.assemble(objective, start, Eigenvalues::Clamped);
            report.factorizations += 1;
            if !self.factorize(0.0) {
                return objective.target.clone();
            }
        }
        let mut u = vec![DVec3::ZERO; start.len()];
        self.body.driven.iter().zip(driven).for_each(|(&v, d)| u[v as usize] = *d - start[v as usize]);
        let (mut forces, mut coupling) = (u.clone(), u.clone());
        let mut scratch = std::mem::take(&mut self.scratch);
        let medium = self.medium(start);
        assembly::gradient_and_product(&medium, start, &u, &mut scratch, &mut forces, &mut coupling);
        self.scratch = scratch;
        self.add_tether_forces(start, objective.ends, &mut forces);
        let h = self.settings.step_time();
        let mut rhs = Vec::with_capacity(3 * self.body.free.len());
        for (&v, m) in self.body.free.iter().zip(&self.free_mass) {
            let v = v as usize;
            let pull = *m * (objective.target[v] - start[v]) - h * h * (forces[v] + coupling[v]);
            rhs.extend(pull.to_array());
        }
        self.solve(&mut rhs);
        let mut y = start.clone();
        self.add_free(&mut y, 1.0, &rhs);
        y
    }
}

/// The rest shape moved rigidly: onto the driven vertices' places if they fix it, else onto `target`.
fn rest_shape_at(body: &Body, target: &[DVec3], driven: &[DVec3]) -> Vec<DVec3> {
    let on_driven =
        body.driven.iter().zip(driven).map(|(&v, d)| (body.lumped_volume[v as usize], body.rest[v as usize], *d));
    let everywhere = body.lumped_volume.iter().zip(&body.rest).zip(target).map(|((w, r), t)| (*w, *r, *t));
    let pairs: Vec<(f64, DVec3, DVec3)> = if driven.len() >= 3 { on_driven.collect() } else { everywhere.collect() };
    let weight: f64 = pairs.iter().map(|p| p.0).sum();
    let mean = |f: &dyn Fn(&(f64, DVec3, DVec3)) -> DVec3| pairs.iter().map(|p| p.0 * f(p)).sum::<DVec3>() / weight;
    let (from, to) = (mean(&|p| p.1), mean(&|p| p.2));
    // The rotation of the covariance Σ w (t − t̄)(r − r̄)ᵀ, scaled to order one.
    let size = pairs.iter().map(|p| p.0 * (p.1 - from).length_squared()).sum::<f64>();
    let mut covariance = Mat3x4::zero();
    for (w, r, t) in &pairs {
        let (r, t) = ((*r - from).to_array(), (*t - to).to_array());
        for j in 0..3 {
            (0..3).for_each(|i| covariance.cols[j][i] += splat(3.0 * w * t[i] * r[j] / size));
        }
    }
    let rotation = polar3(&covariance).r;
    let turned = |r: DVec3| -> DVec3 {
        let image = rotation.times(&r.to_array().map(splat));
        DVec3::from_array(image.map(|c| c.to_array()[0]))
    };
    body.rest.iter().map(|r| to + turned(*r - from)).collect()
}
