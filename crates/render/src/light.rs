//! Light: nine spherical-harmonic coefficients per colour channel.
//!
//! A matt surface under distant light receives E(n) = Σₖ cₖ Yₖ(n) to within about a percent with the nine harmonics of order
//! ≤ 2 (Ramamoorthi and Hanrahan 2001, eq. 13). The basis here is not normalised: 1, y, z, x, xy, yz, 3z²−1, xz, x²−y², so
//! the first coefficient *is* the ambient light. World axes, linear RGB; a white surface under E = 1 is white.

use glam::DVec3;

/// Number of harmonics.
pub const HARMONICS: usize = 9;

/// Distant light as spherical harmonics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Coefficients \[harmonic\]\[channel\].
    pub sh: [[f64; 3]; HARMONICS],
}

impl Light {
    /// The same light from everywhere.
    pub fn ambient(level: f64) -> Self {
        let mut sh = [[0.0; 3]; HARMONICS];
        sh[0] = [level; 3];
        Self { sh }
    }

    /// White light from everywhere and more of it from one side: a key light's cosine lobe, max(0, n·d) to second order
    /// (1/4 + 1/2 n·d + 5/16 (n·d)² − 5/48 …, Ramamoorthi and Hanrahan 2001).
    pub fn ambient_and_key(ambient: f64, key: f64, towards: DVec3) -> Self {
        let d = towards.normalize_or(DVec3::Y);
        let mut light = Self::ambient(ambient);
        // max(0, c) ≈ 1/4 + c/2 + (5/32)(3c² − 1); the quadratic part written in the basis.
        let quadratic = 15.0 / 32.0;
        let zz = d.z * d.z - 0.5 * (d.x * d.x + d.y * d.y);
        let terms = [
            0.25,
            0.5 * d.y,
            0.5 * d.z,
            0.5 * d.x,
            quadratic * 2.0 * d.x * d.y,
            quadratic * 2.0 * d.y * d.z,
            quadratic * zz / 3.0,
            quadratic * 2.0 * d.x * d.z,
            quadratic * 0.5 * (d.x * d.x - d.y * d.y),
        ];
        for (row, term) in light.sh.iter_mut().zip(terms) {
            row.iter_mut().for_each(|c| *c += key * term);
        }
        light
    }

    /// The light scaled per channel (exposure).
    pub fn scaled(&self, gain: [f64; 3]) -> Self {
        Self { sh: self.sh.map(|row| [row[0] * gain[0], row[1] * gain[1], row[2] * gain[2]]) }
    }
}

impl Default for Light {
    /// A soft studio light from above left of a viewer on +Z.
    fn default() -> Self {
        Self::ambient_and_key(0.45, 0.75, DVec3::new(-0.4, 0.8, 0.7))
    }
}

/// The harmonics at a unit normal.
pub fn harmonics(n: DVec3) -> [f64; HARMONICS] {
    let DVec3 { x, y, z } = n;
    [1.0, y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y]
}

/// Adjoint of [`harmonics`]: Σₖ dₖ ∂Yₖ/∂n.
pub fn harmonics_vjp(n: DVec3, d: &[f64; HARMONICS]) -> DVec3 {
    let DVec3 { x, y, z } = n;
    DVec3::new(
        d[3] + d[4] * y + d[7] * z + 2.0 * d[8] * x,
        d[1] + d[4] * x + d[5] * z - 2.0 * d[8] * y,
        d[2] + d[5] * y + 6.0 * d[6] * z + d[7] * x,
    )
}

/// Light received at a unit normal, linear RGB, before the clamp at zero.
pub fn irradiance(light: &Light, n: DVec3) -> [f64; 3] {
    let y = harmonics(n);
    let mut e = [0.0; 3];
    for (row, y) in light.sh.iter().zip(y) {
        (0..3).for_each(|c| e[c] += row[c] * y);
    }
    e
}

/// Adjoint of [`irradiance`]: `d` = ∂L/∂E → ∂L/∂n, and ∂L/∂coefficients added to `d_light`.
pub fn irradiance_vjp(light: &Light, n: DVec3, d: [f64; 3], d_light: &mut Light) -> DVec3 {
    let y = harmonics(n);
    let mut d_y = [0.0; HARMONICS];
    for k in 0..HARMONICS {
        for c in 0..3 {
            d_light.sh[k][c] += d[c] * y[k];
            d_y[k] += d[c] * light.sh[k][c];
        }
    }
    harmonics_vjp(n, &d_y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::{SplitMix64, gradient_error};

    #[test]
    fn a_key_light_is_a_cosine_lobe_to_within_a_tenth() {
        let d = DVec3::new(0.3, 0.5, -0.8).normalize();
        let light = Light::ambient_and_key(0.0, 1.0, d);
        let mut rng = SplitMix64(4);
        let mut worst = 0.0f64;
        for _ in 0..500 {
            let n = DVec3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            worst = worst.max((irradiance(&light, n)[0] - n.dot(d).max(0.0)).abs());
        }
        println!("worst difference to max(0, cos) {worst:.3}");
        assert!(worst < 0.1);
    }

    #[test]
    fn irradiance_has_an_exact_gradient_to_the_normal_and_the_light() {
        let mut rng = SplitMix64(9);
        let mut x: Vec<f64> = (0..3 + 27).map(|_| rng.normal()).collect();
        x[..3].iter_mut().for_each(|v| *v *= 0.5);
        let d = [0.3, -1.1, 0.7];
        let unpack = |x: &[f64]| {
            let sh = std::array::from_fn(|k| [x[3 + 3 * k], x[4 + 3 * k], x[5 + 3 * k]]);
            (DVec3::from_slice(&x[..3]), Light { sh })
        };
        let (n, light) = unpack(&x);
        let mut d_light = Light::ambient(0.0);
        let d_n = irradiance_vjp(&light, n, d, &mut d_light);
        let mut g = d_n.to_array().to_vec();
        g.extend(d_light.sh.iter().flatten());
        let f = |x: &[f64]| {
            let (n, light) = unpack(x);
            let e = irradiance(&light, n);
            e[0] * d[0] + e[1] * d[1] + e[2] * d[2]
        };
        let error = gradient_error(f, &x, &g, 10, &[1e-3, 1e-4, 1e-5], 1);
        println!("irradiance: gradient error {error:.1e}");
        assert!(error < 1e-8);
    }
}
