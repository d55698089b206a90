//! Sums over all tets: energy, forces, Hessian, and directional derivatives, in parallel over chunks.
//!
//! Each chunk adds into buffers of its own; a second pass adds the chunks' slots per vertex and per block in a fixed
//! order. No atomics: the same bytes for any number of threads.

use crate::body::{Body, Chunk};
use crate::damping;
use crate::element::{self, Lame, add_blocks, add_forces, deformation_gradient, gradient_difference, local_field};
use crate::filter::{Eigenvalues, filtered_blocks};
use crate::models::{Energy, Model, with_model};
use animimic_math::lanes::{Mat3x4, splat};
use animimic_math::sparse::BlockMatrix;
use glam::DVec3;
use rayon::prelude::*;

/// Chunk-wise results before they are gathered; kept between calls to avoid allocation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    forces: Vec<DVec3>,
    second: Vec<DVec3>,
    blocks: Vec<[f64; 9]>,
}

/// One chunk with its part of the flat buffers.
struct Part<'a> {
    chunk: &'a Chunk,
    forces: &'a mut [DVec3],
    second: &'a mut [DVec3],
    blocks: &'a mut [[f64; 9]],
}

/// Everything a sum over tets depends on besides positions.
#[derive(Clone, Copy)]
pub(crate) struct Medium<'a> {
    pub body: &'a Body,
    pub model: Model,
    pub lame: &'a Lame,
    /// Start positions and β/h where stiffness damping is on.
    pub damper: Option<(&'a [DVec3], f64)>,
}

impl Scratch {
    /// Runs `f` on every chunk, in parallel, and returns its results in chunk order.
    fn for_chunks<T: Send>(&mut self, body: &Body, blocks: bool, f: impl Fn(Part) -> T + Sync + Send) -> Vec<T> {
        let vertices = body.chunks.iter().map(|c| c.vertices.len()).sum();
        let block_count = if blocks { body.chunks.iter().map(|c| c.blocks.len()).sum() } else { 0 };
        for buffer in [&mut self.forces, &mut self.second] {
            buffer.clear();
            buffer.resize(vertices, DVec3::ZERO);
        }
        self.blocks.clear();
        self.blocks.resize(block_count, [0.0; 9]);
        let (mut forces, mut second, mut block) = (&mut self.forces[..], &mut self.second[..], &mut self.blocks[..]);
        let mut parts = Vec::with_capacity(body.chunks.len());
        for chunk in &body.chunks {
            let n = chunk.vertices.len();
            let (own_forces, own_second, own_blocks);
            (own_forces, forces) = forces.split_at_mut(n);
            (own_second, second) = second.split_at_mut(n);
            (own_blocks, block) = block.split_at_mut(if blocks { chunk.blocks.len() } else { 0 });
            parts.push(Part { chunk, forces: own_forces, second: own_second, blocks: own_blocks });
        }
        parts.into_par_iter().map(&f).collect()
    }
}

/// Sums slots per vertex.
fn gather_vertices(body: &Body, flat: &[DVec3], out: &mut [DVec3]) {
    let sum = |v: usize| body.vertex_slots.of(v).iter().fold(DVec3::ZERO, |s, &slot| s + flat[slot as usize]);
    out.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, o)| *o = sum(v));
}

/// Ψ(x) [J] plus the damper's potential divided by h².
pub(crate) fn energy(medium: &Medium, x: &[DVec3], scratch: &mut Scratch) -> f64 {
    with_model!(medium.model, M => energy_of::<M>(medium, x, scratch))
}

fn energy_of<M: Energy>(medium: &Medium, x: &[DVec3], scratch: &mut Scratch) -> f64 {
    let sums = scratch.for_chunks(medium.body, false, |part| {
        let (mut local, mut start) = (vec![], vec![]);
        local_field(part.chunk, x, &mut local);
        if let Some((from, _)) = medium.damper {
            local_field(part.chunk, from, &mut start);
        }
        let mut sum = splat(0.0);
        for batch in &part.chunk.batches {
            let (mu, lambda) = medium.lame.lanes(&batch.tet);
            let k = element::kinematics::<M>(deformation_gradient(batch, &local));
            sum += batch.volume * M::energy(&k, mu, lambda);
            if let Some((_, rate)) = medium.damper {
                let frame = damping::frame(medium.model, &deformation_gradient(batch, &start));
                let d = gradient_difference(batch, &local, &start);
                sum += batch.volume * splat(rate) * damping::potential(&frame.r, &d, mu, lambda);
            }
        }
        sum.reduce_add()
    });
    sums.iter().sum()
}

/// Ψ(x), ∂Ψ/∂x per vertex into `gradient`, weight × ∂²Ψ on the free vertices into `matrix`; damper included.
pub(crate) fn hessian(
    medium: &Medium,
    x: &[DVec3],
    filter: Eigenvalues,
    weight: f64,
    scratch: &mut Scratch,
    gradient: &mut [DVec3],
    matrix: &mut BlockMatrix,
) -> f64 {
    with_model!(medium.model, M => hessian_of::<M>(medium, x, filter, weight, scratch, gradient, matrix))
}

fn hessian_of<M: Energy>(
    medium: &Medium,
    x: &[DVec3],
    filter: Eigenvalues,
    weight: f64,
    scratch: &mut Scratch,
    gradient: &mut [DVec3],
    matrix: &mut BlockMatrix,
) -> f64 {
    let body = medium.body;
    let weight = splat(weight);
    // Linear elasticity has a semidefinite Hessian already.
    let filter = if medium.model == Model::Linear { Eigenvalues::True } else { filter };
    let sums = scratch.for_chunks(body, true, |part| {
        let (mut local, mut start) = (vec![], vec![]);
        local_field(part.chunk, x, &mut local);
        if let Some((from, _)) = medium.damper {
            local_field(part.chunk, from, &mut start);
        }
        let mut sum = splat(0.0);
        for batch in &part.chunk.batches {
            let (mu, lambda) = medium.lame.lanes(&batch.tet);
            let k = element::kinematics::<M>(deformation_gradient(batch, &local));
            let (s, h) = (M::stress(&k, mu, lambda), M::curvature(&k, mu, lambda));
            sum += batch.volume * M::energy(&k, mu, lambda);
            let mut p = element::stress_tensor::<M>(&k, &s);
            let mut blocks = match filter {
                Eigenvalues::True => element::true_blocks::<M>(batch, &k, &s, &h, weight),
                _ => filtered_blocks(batch, &k, &s, &h, weight, filter),
            };
            if let Some((_, rate)) = medium.damper {
                let rate = splat(rate);
                let frame = damping::frame(medium.model, &deformation_gradient(batch, &start));
                let d = gradient_difference(batch, &local, &start);
                sum += batch.volume * rate * damping::potential(&frame.r, &d, mu, lambda);
                p = p.plus(&damping::stress(&frame.r, &d, mu, lambda).scaled(rate));
                damping::add_blocks(batch, &frame.r, mu, lambda, weight * rate, &mut blocks);
            }
            add_forces(batch, &p, part.forces);
            add_blocks(batch, &blocks, part.blocks);
        }
        sum.reduce_add()
    });
    gather_vertices(body, &scratch.forces, gradient);
    let flat = &scratch.blocks;
    let sum = |k: usize, out: &mut [f64; 9]| {
        let slots = body.block_slots.of(k);
        *out = flat[slots[0] as usize];
        slots[1..].iter().for_each(|&s| (0..9).for_each(|e| out[e] += flat[s as usize][e]));
    };
    matrix.blocks.par_iter_mut().enumerate().with_min_len(8192).for_each(|(k, out)| sum(k, out));
    sums.iter().sum()
}

/// ∂Ψ/∂x at `x` (damper excluded) into `gradient` and (∂²Ψ) u into `product`, for a field u on all vertices.
pub(crate) fn gradient_and_product(
    medium: &Medium,
    x: &[DVec3],
    u: &[DVec3],
    scratch: &mut Scratch,
    gradient: &mut [DVec3],
    product: &mut [DVec3],
) {
    with_model!(medium.model, M => {
        scratch.for_chunks(medium.body, false, |part| {
            let (mut local, mut direction) = (vec![], vec![]);
            local_field(part.chunk, x, &mut local);
            local_field(part.chunk, u, &mut direction);
            for batch in &part.chunk.batches {
                let (mu, lambda) = medium.lame.lanes(&batch.tet);
                let k = element::kinematics::<M>(deformation_gradient(batch, &local));
                let (s, h) = (M::stress(&k, mu, lambda), M::curvature(&k, mu, lambda));
                add_forces(batch, &element::stress_tensor::<M>(&k, &s), part.forces);
                let du = deformation_gradient(batch, &direction);
                add_forces(batch, &element::stress_differential::<M>(&k, &s, &h, &du), part.second);
            }
        });
    });
    gather_vertices(medium.body, &scratch.forces, gradient);
    gather_vertices(medium.body, &scratch.second, product);
}

/// What a step's internal force owes to everything but the free positions, contracted with a field `a`.
pub(crate) struct Contraction {
    /// a · ∂(∂Ψ/∂x)/∂ln E per tet, damper included [J].
    pub by_ln_youngs: Vec<f64>,
    /// a · ∂(∂Ψ/∂x)/∂ν, damper included [J].
    pub by_poisson: f64,
    /// a · ∂(damper force)/∂β × β [J].
    pub by_damping: f64,
    /// (∂²Ψ) a per vertex, damper included [N].
    pub product: Vec<DVec3>,
    /// ∂(a · damper force)/∂xⁿ per vertex [N]; empty without damper.
    pub by_start: Vec<DVec3>,
}

/// Contracts the derivatives of the internal force at `x` with `a`; `by_poisson` holds ∂(μ, λ)/∂ν per tet.
pub(crate) fn contract(
    medium: &Medium,
    by_poisson: &Lame,
    x: &[DVec3],
    a: &[DVec3],
    scratch: &mut Scratch,
) -> Contraction {
    with_model!(medium.model, M => contract_of::<M>(medium, by_poisson, x, a, scratch))
}

fn contract_of<M: Energy>(
    medium: &Medium,
    by_poisson: &Lame,
    x: &[DVec3],
    a: &[DVec3],
    scratch: &mut Scratch,
) -> Contraction {
    let body = medium.body;
    let parts = scratch.for_chunks(body, false, |part| {
        let (mut local, mut direction, mut start) = (vec![], vec![], vec![]);
        local_field(part.chunk, x, &mut local);
        local_field(part.chunk, a, &mut direction);
        if let Some((from, _)) = medium.damper {
            local_field(part.chunk, from, &mut start);
        }
        let mut per_tet = Vec::with_capacity(part.chunk.batches.len() * 4);
        let (mut poisson, mut damping_sum) = (splat(0.0), splat(0.0));
        for batch in &part.chunk.batches {
            let (mu, lambda) = medium.lame.lanes(&batch.tet);
            let (dmu, dlambda) = by_poisson.lanes(&batch.tet);
            let k = element::kinematics::<M>(deformation_gradient(batch, &local));
            let (s, h) = (M::stress(&k, mu, lambda), M::curvature(&k, mu, lambda));
            let z = deformation_gradient(batch, &direction);
            let mut p = element::stress_tensor::<M>(&k, &s);
            let mut p_poisson = element::stress_tensor::<M>(&k, &M::stress(&k, dmu, dlambda));
            let mut dp = element::stress_differential::<M>(&k, &s, &h, &z);
            if let Some((_, rate)) = medium.damper {
                let rate = splat(rate);
                let frame = damping::frame(medium.model, &deformation_gradient(batch, &start));
                let d = gradient_difference(batch, &local, &start);
                let viscous = damping::stress(&frame.r, &d, mu, lambda).scaled(rate);
                damping_sum += batch.volume * viscous.ddot(&z);
                p = p.plus(&viscous);
                p_poisson = p_poisson.plus(&damping::stress(&frame.r, &d, dmu, dlambda).scaled(rate));
                dp = dp.plus(&damping::stress(&frame.r, &z, mu, lambda).scaled(rate));
                let back: Mat3x4 = damping::start_gradient(&frame, &d, &z, mu, lambda).scaled(rate);
                add_forces(batch, &back, part.second);
            }
            add_forces(batch, &dp, part.forces);
            poisson += batch.volume * p_poisson.ddot(&z);
            let by_e = (batch.volume * p.ddot(&z)).to_array();
            (0..batch.used).for_each(|l| per_tet.push((batch.tet[l], by_e[l])));
        }
        (per_tet, poisson.reduce_add(), damping_sum.reduce_add())
    });
    let mut result = Contraction {
        by_ln_youngs: vec![0.0; body.volume.len()],
        by_poisson: 0.0,
        by_damping: 0.0,
        product: vec![DVec3::ZERO; body.rest.len()],
        by_start: vec![],
    };
    for (per_tet, poisson, damping) in parts {
        per_tet.iter().for_each(|&(tet, v)| result.by_ln_youngs[tet as usize] = v);
        result.by_poisson += poisson;
        result.by_damping += damping;
    }
    gather_vertices(body, &scratch.forces, &mut result.product);
    if medium.damper.is_some() {
        result.by_start = vec![DVec3::ZERO; body.rest.len()];
        gather_vertices(body, &scratch.second, &mut result.by_start);
    }
    result
}

/// ∂(∂Ψ/∂x)/∂ln E_c per cluster, on free vertices in elimination order: \[cluster\]\[3 × free\] \[N\]; damper included.
pub(crate) fn forces_by_cluster(medium: &Medium, cluster: &[u32], clusters: usize, x: &[DVec3]) -> Vec<Vec<f64>> {
    let body = medium.body;
    let mut position = vec![u32::MAX; body.rest.len()];
    body.free.iter().enumerate().for_each(|(p, &v)| position[v as usize] = p as u32);
    let mut out = vec![vec![0.0; 3 * body.free.len()]; clusters];
    with_model!(medium.model, M => for chunk in &body.chunks {
        let (mut local, mut start) = (vec![], vec![]);
        local_field(chunk, x, &mut local);
        if let Some((from, _)) = medium.damper {
            local_field(chunk, from, &mut start);
        }
        for batch in &chunk.batches {
            let (mu, lambda) = medium.lame.lanes(&batch.tet);
            let k = element::kinematics::<M>(deformation_gradient(batch, &local));
            let mut p = element::stress_tensor::<M>(&k, &M::stress(&k, mu, lambda));
            if let Some((_, rate)) = medium.damper {
                let frame = damping::frame(medium.model, &deformation_gradient(batch, &start));
                let d = gradient_difference(batch, &local, &start);
                p = p.plus(&damping::stress(&frame.r, &d, mu, lambda).scaled(splat(rate)));
            }
            let forces = element::corner_forces(batch, &p);
            for l in 0..batch.used {
                let target = &mut out[cluster[batch.tet[l] as usize] as usize];
                for (corner, f) in batch.corner[l].iter().zip(&forces[l]) {
                    let at = position[chunk.vertices[*corner as usize] as usize];
                    if at != u32::MAX {
                        (0..3).for_each(|c| target[3 * at as usize + c] += f[c]);
                    }
                }
            }
        }
    });
    out
}
