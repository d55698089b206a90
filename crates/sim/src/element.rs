//! Element kernels: energy, force, Hessian and directional derivatives of chunks of tets, four at a time.
//!
//! With ρ_a = R g_a, φ_a = F g_a, c_a = cof F g_a (g_a the rest gradient of corner a) and q_ab = F (g_a × g_b), the 3×3 block
//! of ∂²Ψ for corners a, b follows from the coefficients of `models` as
//!     K_ab = V [ (a g_a·g_b) I + d g_b g_aᵀ + h_F φ_a φ_bᵀ + h_R ρ_a ρ_bᵀ + h_C c_a c_bᵀ + h_I g_a g_bᵀ
//!                − c [q_ab]× − b [ρ_a]× T [ρ_b]× ],
//! which needs no singular vector and no 9×9 matrix. Corner 0 is minus the sum of the others.

use crate::body::{Batch, Chunk, NO_BLOCK, PAIRS};
use crate::models::{Curvature, Energy, Kinematics, Stress};
use animimic_math::lanes::{LANES, Lanes, Mat3x4, Vec3x4, add, cross, dot, scale, splat, sub};
use animimic_math::polar3::polar3;
use glam::DVec3;

/// Lamé parameters per tet [Pa].
#[derive(Clone, Debug, Default)]
pub(crate) struct Lame {
    pub mu: Vec<f64>,
    pub lambda: Vec<f64>,
}

impl Lame {
    #[inline(always)]
    pub fn lanes(&self, tet: &[u32; LANES]) -> (Lanes, Lanes) {
        let pick = |v: &[f64]| Lanes::new(std::array::from_fn(|l| v[tet[l] as usize]));
        (pick(&self.mu), pick(&self.lambda))
    }
}

/// Corner differences x_a − x_0, a = 1..3, of a vertex field.
#[inline(always)]
pub(crate) fn edges(batch: &Batch, x: &[DVec3]) -> [Vec3x4; 3] {
    let p: [[DVec3; 4]; LANES] = batch.corner.map(|c| c.map(|i| x[i as usize]));
    std::array::from_fn(|a| {
        let d: [DVec3; LANES] = std::array::from_fn(|l| p[l][a + 1] - p[l][0]);
        [Lanes::new(d.map(|v| v.x)), Lanes::new(d.map(|v| v.y)), Lanes::new(d.map(|v| v.z))]
    })
}

/// Gradient Σ_a d_a g_aᵀ of a vertex field from its corner differences.
#[inline(always)]
pub(crate) fn field_gradient(batch: &Batch, d: &[Vec3x4; 3]) -> Mat3x4 {
    let g = &batch.gradient;
    Mat3x4 {
        cols: std::array::from_fn(|j| {
            std::array::from_fn(|i| d[0][i].mul_add(g[0][j], d[1][i].mul_add(g[1][j], d[2][i] * g[2][j])))
        }),
    }
}

/// F and what model `M` derives from it.
#[inline(always)]
pub(crate) fn kinematics<M: Energy>(f: Mat3x4) -> Kinematics {
    let cof = f.cofactor();
    let j = dot(&f.cols[0], &cof.cols[0]);
    let (r, t) = if M::ROTATES {
        let polar = polar3(&f);
        (polar.r, polar.t)
    } else {
        (Mat3x4::zero(), Mat3x4::zero())
    };
    Kinematics { f, cof, j, r, t, stretch: r.ddot(&f) }
}

/// P from its coefficients.
#[inline(always)]
pub(crate) fn stress_tensor<M: Energy>(k: &Kinematics, s: &Stress) -> Mat3x4 {
    let mut p = k.f.scaled(s.f).plus(&k.cof.scaled(s.cof));
    if M::ROTATES {
        p = p.plus(&k.r.scaled(s.r));
    }
    p = p.plus(&k.f.transpose().scaled(s.ft));
    (0..3).for_each(|i| p.cols[i][i] += s.id);
    p
}

/// P : Z from the coefficients of P, which is never formed.
#[inline(always)]
pub(crate) fn stress_work<M: Energy>(k: &Kinematics, s: &Stress, z: &Mat3x4) -> Lanes {
    let w = s.f * k.f.ddot(z) + s.cof * k.cof.ddot(z) + s.ft * k.f.transpose().ddot(z) + s.id * z.trace();
    if M::ROTATES { w + s.r * k.r.ddot(z) } else { w }
}

/// Axial vector Σ_j A_j × B_j of two matrices' columns.
#[inline(always)]
pub(crate) fn axial(a: &Mat3x4, b: &Mat3x4) -> Vec3x4 {
    let c: [Vec3x4; 3] = std::array::from_fn(|j| cross(&a.cols[j], &b.cols[j]));
    add(&add(&c[0], &c[1]), &c[2])
}

/// dP = ∂P/∂F : dF.
#[inline(always)]
pub(crate) fn stress_differential<M: Energy>(k: &Kinematics, s: &Stress, h: &Curvature, df: &Mat3x4) -> Mat3x4 {
    let (f, d) = (&k.f.cols, &df.cols);
    let dcof = |a: usize, b: usize| add(&cross(&d[a], &f[b]), &cross(&f[a], &d[b]));
    let dcof = Mat3x4 { cols: [dcof(1, 2), dcof(2, 0), dcof(0, 1)] };
    let mut p = df
        .scaled(s.f)
        .plus(&dcof.scaled(s.cof))
        .plus(&df.transpose().scaled(s.ft))
        .plus(&k.f.scaled(h.ff * k.f.ddot(df)))
        .plus(&k.cof.scaled(h.cc * k.cof.ddot(df)));
    if M::ROTATES {
        let omega = scale(&k.t.times(&axial(&k.r, df)), s.r);
        let dr = Mat3x4 { cols: std::array::from_fn(|j| cross(&omega, &k.r.cols[j])) };
        p = p.plus(&dr).plus(&k.r.scaled(h.rr * k.r.ddot(df)));
    }
    let trace = h.ii * df.trace();
    (0..3).for_each(|i| p.cols[i][i] += trace);
    p
}

/// Forces V P g_a of the four corners, \[lane\]\[corner\]; corner 0 gets minus the sum.
#[inline(always)]
pub(crate) fn corner_forces(batch: &Batch, p: &Mat3x4) -> [[DVec3; 4]; LANES] {
    let f: [Vec3x4; 3] = std::array::from_fn(|a| scale(&p.times(&batch.gradient[a]), batch.volume));
    let sum = add(&add(&f[0], &f[1]), &f[2]);
    let corner = [[-sum[0], -sum[1], -sum[2]], f[0], f[1], f[2]].map(|v| v.map(|c| c.to_array()));
    std::array::from_fn(|l| std::array::from_fn(|a| DVec3::new(corner[a][0][l], corner[a][1][l], corner[a][2][l])))
}

/// Adds the corners' forces to the chunk's vertices.
#[inline(always)]
pub(crate) fn add_forces(batch: &Batch, p: &Mat3x4, out: &mut [DVec3]) {
    let forces = corner_forces(batch, p);
    for l in 0..batch.used {
        (0..4).for_each(|a| out[batch.corner[l][a] as usize] += forces[l][a]);
    }
}

/// The six Hessian blocks of corners (1,1), (2,1), (3,1), (2,2), (3,2), (3,3); entry \[3 i + j\] of K_ab.
pub(crate) type FreeBlocks = [[Lanes; 9]; 6];
const FREE_PAIRS: [(usize, usize); 6] = [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)];

/// Blocks of the true Hessian, times `weight`.
#[inline(always)]
pub(crate) fn true_blocks<M: Energy>(
    batch: &Batch,
    k: &Kinematics,
    s: &Stress,
    h: &Curvature,
    weight: Lanes,
) -> FreeBlocks {
    let g = &batch.gradient;
    let w = batch.volume * weight;
    let scaled = |m: &Mat3x4, c: Lanes| -> [Vec3x4; 3] { std::array::from_fn(|a| scale(&m.times(&g[a]), c)) };
    let (phi, cof) = (scaled(&k.f, splat(1.0)), scaled(&k.cof, splat(1.0)));
    let (rho, t_rho) = if M::ROTATES {
        let rho = scaled(&k.r, splat(1.0));
        // Columns of −b T [ρ_b]×.
        let t = k.t.scaled(-(s.r * w));
        let t_rho: [Mat3x4; 3] = std::array::from_fn(|b| {
            let [x, y, z] = rho[b];
            let o = splat(0.0);
            Mat3x4 { cols: [t.times(&[o, z, -y]), t.times(&[-z, o, x]), t.times(&[y, -x, o])] }
        });
        (rho, t_rho)
    } else {
        ([[splat(0.0); 3]; 3], [Mat3x4::zero(); 3])
    };
    let (sf, sc, st) = (s.f * w, s.cof * w, s.ft * w);
    let (ff, rr, cc, ii) = (h.ff * w, h.rr * w, h.cc * w, h.ii * w);
    FREE_PAIRS.map(|(a, b)| {
        let mut m = if M::ROTATES {
            let t = &t_rho[b].cols;
            [cross(&rho[a], &t[0]), cross(&rho[a], &t[1]), cross(&rho[a], &t[2])]
        } else {
            [[splat(0.0); 3]; 3]
        };
        for j in 0..3 {
            let (x, y, z, u) = (ff * phi[b][j], rr * rho[b][j], cc * cof[b][j], ii * g[b][j]);
            let v = st * g[a][j];
            for i in 0..3 {
                let r = if M::ROTATES { rho[a][i].mul_add(y, m[j][i]) } else { m[j][i] };
                m[j][i] = phi[a][i].mul_add(x, cof[a][i].mul_add(z, r));
                m[j][i] = g[a][i].mul_add(u, g[b][i].mul_add(v, m[j][i]));
            }
        }
        let diagonal = sf * dot(&g[a], &g[b]);
        (0..3).for_each(|i| m[i][i] += diagonal);
        if a != b {
            let q = scale(&k.f.times(&cross(&g[a], &g[b])), sc);
            // −[q]×: entries (0,1) = q_z, (0,2) = −q_y, (1,2) = q_x.
            m[1][0] += q[2];
            m[0][1] -= q[2];
            m[2][0] -= q[1];
            m[0][2] += q[1];
            m[2][1] += q[0];
            m[1][2] -= q[0];
        }
        std::array::from_fn(|e| m[e % 3][e / 3])
    })
}

/// Scatters blocks (corner 0 included) into the chunk's block list.
#[inline(always)]
pub(crate) fn add_blocks(batch: &Batch, k: &FreeBlocks, out: &mut [[f64; 9]]) {
    // Index of K_ab (row ≥ column) in FreeBlocks, and whether it is stored transposed.
    let entry = |a: usize, b: usize, e: usize| -> Lanes {
        const INDEX: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        if a >= b { k[INDEX[a][b]][e] } else { k[INDEX[a][b]][(e % 3) * 3 + e / 3] }
    };
    let first: [[Lanes; 9]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|e| -(entry(a, 0, e) + entry(a, 1, e) + entry(a, 2, e))));
    let corner0: [Lanes; 9] = std::array::from_fn(|e| -(first[0][e] + first[1][e] + first[2][e]));
    let all = [&corner0, &first[0], &first[1], &first[2], &k[0], &k[1], &k[2], &k[3], &k[4], &k[5]];
    for (p, block) in all.iter().enumerate() {
        let low = Lanes::transpose([block[0], block[1], block[2], block[3]]);
        let high = Lanes::transpose([block[4], block[5], block[6], block[7]]);
        let last = block[8].to_array();
        for l in 0..LANES {
            let slot = batch.block[l][p];
            if slot != NO_BLOCK {
                let target = &mut out[slot as usize];
                let (a, b) = (low[l].to_array(), high[l].to_array());
                (0..4).for_each(|i| target[i] += a[i]);
                (0..4).for_each(|i| target[4 + i] += b[i]);
                target[8] += last[l];
            }
        }
    }
    debug_assert_eq!(PAIRS.len(), all.len());
}

/// The chunk's part of a vertex field.
pub(crate) fn local_field(chunk: &Chunk, x: &[DVec3]) -> Vec<DVec3> {
    chunk.vertices.iter().map(|&v| x[v as usize]).collect()
}

/// F of a batch from the chunk's positions.
#[inline(always)]
pub(crate) fn deformation_gradient(batch: &Batch, x: &[DVec3]) -> Mat3x4 {
    field_gradient(batch, &edges(batch, x))
}

/// Difference of two fields' gradients.
#[inline(always)]
pub(crate) fn gradient_difference(batch: &Batch, x: &[DVec3], y: &[DVec3]) -> Mat3x4 {
    let (a, b) = (edges(batch, x), edges(batch, y));
    field_gradient(batch, &std::array::from_fn(|i| sub(&a[i], &b[i])))
}
