//! The creature's colours as a function of rest position: teal above, cream below, coral ears and tail tip, spots, stripes
//! and eyes.

use glam::DVec3;

const TEAL: [f64; 3] = [0.16, 0.56, 0.58];
const DEEP: [f64; 3] = [0.06, 0.27, 0.38];
const CREAM: [f64; 3] = [0.97, 0.90, 0.74];
const CORAL: [f64; 3] = [0.95, 0.47, 0.36];
const GOLD: [f64; 3] = [0.98, 0.76, 0.32];
const INK: [f64; 3] = [0.07, 0.07, 0.11];
const WHITE: [f64; 3] = [1.0, 1.0, 1.0];

/// sRGB-encoded colour at a rest position [m] with its outward normal.
pub fn color(p: DVec3, n: DVec3) -> [f64; 3] {
    let mut c = TEAL;
    // A slow mottle keeps large plain areas from being featureless.
    c = mix(c, DEEP, 0.22 * noise(p * 9.0) + 0.10 * noise(p * 23.0));
    c = stripes_and_spots(p, c);
    c = mix(c, CREAM, below(p, n));
    c = ears(p, n, c);
    c = mix(c, CORAL, step(1.075, 1.095, p.y - 0.25 * (p.z + 1.0) + 0.018 * noise(p * 18.0)) * step(-0.8, -0.85, p.z));
    c = paws(p, c);
    face(p, n, c)
}

/// Share of cream: chest, belly and the underside of the tail and muzzle, with a ragged border.
fn below(p: DVec3, n: DVec3) -> f64 {
    let ragged = 0.16 * noise(p * 14.0);
    let trunk = step(0.30, 0.48, -n.y + ragged) * step(0.28, 0.34, p.y);
    let bib = step(0.35, 0.55, n.z - 0.25 * n.y + ragged)
        * step(0.10, 0.16, p.z)
        * step(0.84, 0.78, p.y)
        * step(0.40, 0.44, p.y);
    let muzzle = step(0.955, 0.935, p.y + 0.03 * noise(p * 20.0)) * step(0.57, 0.61, p.z) * step(0.80, 0.82, p.y);
    trunk.max(bib).max(muzzle)
}

fn stripes_and_spots(p: DVec3, c: [f64; 3]) -> [f64; 3] {
    // Bands across the tail.
    let along = (p - DVec3::new(0.0, 0.68, -0.46)).dot(DVec3::new(0.0, 0.55, -0.835));
    if p.z < -0.52 && p.y > 0.55 {
        let band = (along * 34.0 + 1.6 * noise(p * 8.0)).sin();
        return mix(c, DEEP, 0.9 * step(0.15, 0.45, band));
    }
    // Two kinds of round spots, from the nearest points of jittered grids.
    let (d, id) = nearest_spot(p, 0.115);
    let radius = 0.018 + 0.024 * id;
    let kind = if id > 0.62 { GOLD } else { DEEP };
    let spotted = mix(c, kind, step(radius + 0.006, radius - 0.004, d));
    let (d, id) = nearest_spot(p + DVec3::splat(7.3), 0.06);
    mix(spotted, DEEP, 0.85 * step(0.013, 0.008, d) * f64::from(id > 0.45))
}

fn ears(p: DVec3, n: DVec3, c: [f64; 3]) -> [f64; 3] {
    if p.y < 1.10 || p.z < 0.2 {
        return c;
    }
    let tip = step(1.36, 1.385, p.y + 0.02 * noise(p * 22.0));
    let center = DVec3::new(p.x.signum() * (0.12 + 0.33 * (p.y - 1.13)), p.y, p.z);
    let inner = step(0.35, 0.6, n.z)
        * step(0.062, 0.048, (p.x - center.x).abs())
        * step(1.14, 1.17, p.y)
        * step(1.37, 1.34, p.y);
    mix(mix(c, DEEP, tip), CORAL, inner)
}

fn paws(p: DVec3, c: [f64; 3]) -> [f64; 3] {
    let sock = step(0.185, 0.165, p.y + 0.03 * noise(p * 17.0));
    let ring = step(0.225, 0.215, p.y) * step(0.185, 0.195, p.y);
    mix(mix(c, GOLD, ring), DEEP, sock)
}

/// Eyes with highlights, a nose, cheeks.
fn face(p: DVec3, n: DVec3, mut c: [f64; 3]) -> [f64; 3] {
    if p.z < 0.5 || p.y < 0.8 {
        return c;
    }
    let side = p.x.signum();
    let eye = DVec3::new(0.118 * side, 1.015, 0.655);
    let d = (p - eye) * DVec3::new(1.0, 0.82, 0.9);
    let r = d.length();
    c = mix(c, CREAM, step(0.066, 0.060, r));
    c = mix(c, INK, step(0.052, 0.048, r));
    let iris = step(0.040, 0.032, (d - DVec3::new(0.0, -0.016, 0.0)).length());
    c = mix(c, [0.20, 0.42, 0.62], 0.75 * iris);
    c = mix(c, INK, step(0.024, 0.019, r));
    c = mix(c, WHITE, step(0.017, 0.013, (d - DVec3::new(0.012, 0.018, 0.01)).length()));
    let cheek = (p - DVec3::new(0.15 * side, 0.925, 0.645)).length();
    c = mix(c, CORAL, 0.75 * step(0.042, 0.026, cheek));
    let nose = (p - DVec3::new(0.0, 0.958, 0.785)).length();
    let mouth = step(0.006, 0.003, (p.y - 0.897 - 0.35 * p.x.abs()).abs())
        * step(0.05, 0.045, p.x.abs())
        * step(0.72, 0.73, p.z);
    c = mix(c, INK, 0.85 * mouth * f64::from(n.z > 0.0));
    mix(c, INK, step(0.042, 0.036, nose))
}

/// 0 at `a`, 1 at `b`, smooth between; `b` may be below `a`.
fn step(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * t)
}

/// Distance to the nearest point of a jittered grid of the given spacing, and that point's random number.
fn nearest_spot(p: DVec3, spacing: f64) -> (f64, f64) {
    let q = p / spacing;
    let base = q.floor().as_ivec3();
    let mut best = (f64::INFINITY, 0.0);
    for dz in -1..=1 {
        for dy in -1..=1 {
            for dx in -1..=1 {
                let cell = base + glam::IVec3::new(dx, dy, dz);
                let at = |salt: u32| hash(cell.x, cell.y, cell.z, salt);
                let point = cell.as_dvec3() + DVec3::new(at(1), at(2), at(3)) * 0.7 + 0.15;
                let d = point.distance(q) * spacing;
                if d < best.0 {
                    best = (d, at(4));
                }
            }
        }
    }
    best
}

/// Value noise in [−1, 1], smooth, with unit feature size.
fn noise(p: DVec3) -> f64 {
    let base = p.floor().as_ivec3();
    let f = p - p.floor();
    let s = f * f * (DVec3::splat(3.0) - 2.0 * f);
    let at = |dx: i32, dy: i32, dz: i32| hash(base.x + dx, base.y + dy, base.z + dz, 0);
    let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let face = |dz: i32| lerp(lerp(at(0, 0, dz), at(1, 0, dz), s.x), lerp(at(0, 1, dz), at(1, 1, dz), s.x), s.y);
    2.0 * lerp(face(0), face(1), s.z) - 1.0
}

/// A number in [0, 1) that depends on its arguments and nothing else.
fn hash(x: i32, y: i32, z: i32, salt: u32) -> f64 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f);
    h ^= salt.wrapping_mul(0x9e37_79b9);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    f64::from((h ^ (h >> 15)) >> 8) / f64::from(1u32 << 24)
}
