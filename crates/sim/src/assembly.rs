//! Sums over all tets: energy, forces, Hessian, and directional derivatives, in parallel over chunks.
//!
//! Each chunk adds into buffers of its own; a second pass adds the chunks' slots per vertex and per block in a fixed
//! order. No atomics: the same bytes for any number of threads.

use crate::body::{Batch, Body, Chunk};
use crate::damping::Damper;
use crate::element::{self, Lame, add_blocks, add_forces, deformation_gradient, gradient_difference, local_field};
use crate::filter::{Eigenvalues, filtered_blocks};
use crate::models::{Energy, Kinematics, Model, with_model};
use animimic_math::lanes::{Lanes, Mat3x4, splat};
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

/// What every sum knows of four tets before it begins.
struct Point<'a> {
    mu: Lanes,
    lambda: Lanes,
    k: Kinematics,
    /// Borrowed: within the point it would keep the kinematics out of registers.
    damper: Option<&'a Damper>,
}

impl Medium<'_> {
    /// Visits the chunk's batches with their kinematics at `x`.
    #[inline(always)]
    fn for_batches<M: Energy>(&self, chunk: &Chunk, x: &[DVec3], mut visit: impl FnMut(&Batch, Point)) {
        let x = local_field(chunk, x);
        let damper = self.damper.map(|(start, rate)| (local_field(chunk, start), splat(rate)));
        for batch in &chunk.batches {
            let (mu, lambda) = self.lame.lanes(&batch.tet);
            let k = element::kinematics::<M>(deformation_gradient(batch, &x));
            let damper = damper.as_ref().map(|(start, rate)| {
                let d = gradient_difference(batch, &x, start);
                Damper::new(self.model, &deformation_gradient(batch, start), d, *rate, mu, lambda)
            });
            visit(batch, Point { mu, lambda, k, damper: damper.as_ref() });
        }
    }
}

impl Point<'_> {
    /// ψ per unit rest volume, damper included.
    #[inline(always)]
    fn energy<M: Energy>(&self) -> Lanes {
        let elastic = M::energy(&self.k, self.mu, self.lambda);
        self.damper.map_or(elastic, |d| elastic + d.potential())
    }

    /// P, damper included.
    #[inline(always)]
    fn stress<M: Energy>(&self) -> Mat3x4 {
        let p = element::stress_tensor::<M>(&self.k, &M::stress(&self.k, self.mu, self.lambda));
        self.damper.map_or(p, |d| p.plus(&d.stress()))
    }

    /// P : Z with any Lamé parameters, damper included: by linearity also what ∂P to anything they depend on does.
    #[inline(always)]
    fn work<M: Energy>(&self, mu: Lanes, lambda: Lanes, z: &Mat3x4) -> Lanes {
        let elastic = element::stress_work::<M>(&self.k, &M::stress(&self.k, mu, lambda), z);
        self.damper.map_or(elastic, |d| elastic + d.stress_with(mu, lambda).ddot(z))
    }

    /// ∂P/∂F : dF, damper included.
    #[inline(always)]
    fn differential<M: Energy>(&self, df: &Mat3x4) -> Mat3x4 {
        let (s, h) = (M::stress(&self.k, self.mu, self.lambda), M::curvature(&self.k, self.mu, self.lambda));
        let dp = element::stress_differential::<M>(&self.k, &s, &h, df);
        self.damper.map_or(dp, |d| dp.plus(&d.differential(df)))
    }

    /// Blocks of weight × ∂²Ψ, damper included.
    #[inline(always)]
    fn blocks<M: Energy>(&self, batch: &Batch, filter: Eigenvalues, weight: Lanes) -> element::FreeBlocks {
        let (s, h) = (M::stress(&self.k, self.mu, self.lambda), M::curvature(&self.k, self.mu, self.lambda));
        let mut blocks = match filter {
            Eigenvalues::True => element::true_blocks::<M>(batch, &self.k, &s, &h, weight),
            _ => filtered_blocks(batch, &self.k, &s, &h, weight, filter),
        };
        if let Some(d) = self.damper {
            d.add_blocks(batch, weight, &mut blocks);
        }
        blocks
    }
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

/// Sum of one vertex's slots.
fn sum_slots(body: &Body, flat: &[DVec3], v: usize) -> DVec3 {
    body.vertex_slots.of(v).iter().fold(DVec3::ZERO, |s, &slot| s + flat[slot as usize])
}

/// Sums slots per vertex.
fn gather_vertices(body: &Body, flat: &[DVec3], out: &mut [DVec3]) {
    out.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, o)| *o = sum_slots(body, flat, v));
}

/// Ψ(x) [J] plus the damper's potential divided by h².
pub(crate) fn energy(medium: &Medium, x: &[DVec3], scratch: &mut Scratch) -> f64 {
    with_model!(medium.model, M => {
        let sums = scratch.for_chunks(medium.body, false, |part| {
            let mut sum = splat(0.0);
            medium.for_batches::<M>(part.chunk, x, |batch, point| sum += batch.volume * point.energy::<M>());
            sum.reduce_add()
        });
        sums.iter().sum()
    })
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
    let (body, weight) = (medium.body, splat(weight));
    // Linear elasticity has a semidefinite Hessian already.
    let filter = if medium.model == Model::Linear { Eigenvalues::True } else { filter };
    let sums = with_model!(medium.model, M => scratch.for_chunks(body, true, |part| {
        let mut sum = splat(0.0);
        medium.for_batches::<M>(part.chunk, x, |batch, point| {
            sum += batch.volume * point.energy::<M>();
            add_forces(batch, &point.stress::<M>(), part.forces);
            add_blocks(batch, &point.blocks::<M>(batch, filter, weight), part.blocks);
        });
        sum.reduce_add()
    }));
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

/// ∂Ψ/∂x at `x` into `gradient` and (∂²Ψ) u into `product`, for a field u on all vertices; damper included.
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
            let direction = local_field(part.chunk, u);
            medium.for_batches::<M>(part.chunk, x, |batch, point| {
                add_forces(batch, &point.stress::<M>(), part.forces);
                let du = deformation_gradient(batch, &direction);
                add_forces(batch, &point.differential::<M>(&du), part.second);
            });
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
    /// (∂²Ψ) a, damper included, on driven vertices in their order [N].
    pub on_driven: Vec<DVec3>,
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
    let body = medium.body;
    let parts = with_model!(medium.model, M => scratch.for_chunks(body, false, |part| {
        let direction = local_field(part.chunk, a);
        let mut per_tet = Vec::with_capacity(part.chunk.batches.len() * 4);
        let (mut poisson, mut damping) = (splat(0.0), splat(0.0));
        medium.for_batches::<M>(part.chunk, x, |batch, point| {
            let z = deformation_gradient(batch, &direction);
            let (dmu, dlambda) = by_poisson.lanes(&batch.tet);
            poisson += batch.volume * point.work::<M>(dmu, dlambda, &z);
            let by_e = (batch.volume * point.work::<M>(point.mu, point.lambda, &z)).to_array();
            (0..batch.used).for_each(|l| per_tet.push((batch.tet[l], by_e[l])));
            if batch.touches_driven() {
                add_forces(batch, &point.differential::<M>(&z), part.forces);
            }
            if let Some(damper) = point.damper {
                damping += batch.volume * damper.stress().ddot(&z);
                add_forces(batch, &damper.start_gradient(&z), part.second);
            }
        });
        (per_tet, poisson.reduce_add(), damping.reduce_add())
    }));
    let mut result = Contraction {
        by_ln_youngs: vec![0.0; body.volume.len()],
        by_poisson: 0.0,
        by_damping: 0.0,
        on_driven: body.driven.iter().map(|&v| sum_slots(body, &scratch.forces, v as usize)).collect(),
        by_start: vec![],
    };
    for (per_tet, poisson, damping) in parts {
        per_tet.iter().for_each(|&(tet, v)| result.by_ln_youngs[tet as usize] = v);
        result.by_poisson += poisson;
        result.by_damping += damping;
    }
    if medium.damper.is_some() {
        result.by_start = vec![DVec3::ZERO; body.rest.len()];
        gather_vertices(body, &scratch.second, &mut result.by_start);
    }
    result
}

/// ∂(damper force)/∂xⁿ u per vertex [N], for a field u on all vertices: the forward counterpart of
/// [`Contraction::by_start`]. Zero without damper.
pub(crate) fn start_product(medium: &Medium, x: &[DVec3], u: &[DVec3], scratch: &mut Scratch, out: &mut [DVec3]) {
    with_model!(medium.model, M => {
        scratch.for_chunks(medium.body, false, |part| {
            let direction = local_field(part.chunk, u);
            medium.for_batches::<M>(part.chunk, x, |batch, point| {
                if let Some(damper) = point.damper {
                    let du = deformation_gradient(batch, &direction);
                    add_forces(batch, &damper.start_differential(&du), part.forces);
                }
            });
        });
    });
    gather_vertices(medium.body, &scratch.forces, out);
}

/// ∂(∂Ψ/∂x)/∂ln E_c per cluster and vertex [N]; damper included.
pub(crate) fn forces_by_cluster(medium: &Medium, cluster: &[u32], clusters: usize, x: &[DVec3]) -> Vec<Vec<DVec3>> {
    let mut out = vec![vec![DVec3::ZERO; x.len()]; clusters];
    with_model!(medium.model, M => for chunk in &medium.body.chunks {
        medium.for_batches::<M>(chunk, x, |batch, point| {
            let forces = element::corner_forces(batch, &point.stress::<M>());
            for l in 0..batch.used {
                let target = &mut out[cluster[batch.tet[l] as usize] as usize];
                let corners = batch.corner[l].iter().map(|&c| chunk.vertices[c as usize] as usize);
                corners.zip(&forces[l]).for_each(|(v, f)| target[v] += *f);
            }
        });
    });
    out
}
