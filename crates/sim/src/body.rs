//! A body: the rest shape with everything that never changes while it moves.
//!
//! Built once per mesh and set of driven vertices: rest gradients and volumes in batches of four tets, the elimination
//! order of the free vertices, the block pattern of the Hessian and its symbolic analysis.

use crate::error::{SimError, check_finite};
use crate::tethers::{Tether, TetherBlock};
use crate::winding::Edges;
use animimic_math::lanes::{LANES, Lanes, Vec3x4};
use animimic_math::sparse::{BlockPattern, Symbolic, nested_dissection};
use animimic_scene::TetMesh;
use glam::{DMat3, DVec3};

/// Tets per chunk: the unit of parallel work; its vertices and blocks stay in the second-level cache.
const CHUNK_TETS: usize = 256;
/// A tet is flat when its volume is under this share of its longest edge cubed.
const FLAT: f64 = 1e-12;
/// No local block: one of the two corners is driven.
pub(crate) const NO_BLOCK: u16 = u16::MAX;
/// Corner pairs (row ≥ column) in the order of a batch's block slots.
pub(crate) const PAIRS: [(usize, usize); 10] =
    [(0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (3, 3)];

/// Four tets. Corners are sorted by elimination order, driven ones last.
#[derive(Clone, Debug)]
pub(crate) struct Batch {
    /// Corner vertices, as indices into the chunk's vertex list, \[lane\]\[corner\].
    pub corner: [[u16; 4]; LANES],
    /// Tet of each lane; padding lanes repeat the last tet.
    pub tet: [u32; LANES],
    /// Lanes in use.
    pub used: usize,
    /// Rest gradients of the shape functions of corners 1, 2, 3 [1/m].
    pub gradient: [Vec3x4; 3],
    /// Rest volume [m³], zero in padding lanes.
    pub volume: Lanes,
    /// Block of each pair of [`PAIRS`] in the chunk's block list, [`NO_BLOCK`] where a corner is driven.
    pub block: [[u16; 10]; LANES],
}

impl Batch {
    /// Whether any of its tets has a driven corner.
    pub fn touches_driven(&self) -> bool {
        // Driven corners are last, so the last pair's block tells.
        self.block[..self.used].iter().any(|pairs| pairs[9] == NO_BLOCK)
    }
}

/// A few hundred neighbouring tets.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chunk {
    /// Vertices it touches.
    pub vertices: Vec<u32>,
    pub batches: Vec<Batch>,
    /// Hessian blocks it touches, as indices into the pattern.
    pub blocks: Vec<u32>,
}

/// For every target: the flat slots that add up to it, in a fixed order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gather {
    start: Vec<u32>,
    slot: Vec<u32>,
}

impl Gather {
    fn new(targets: usize, target_of_slot: impl Iterator<Item = u32> + Clone) -> Self {
        let mut start = vec![0u32; targets + 1];
        target_of_slot.clone().for_each(|t| start[t as usize + 1] += 1);
        (0..targets).for_each(|t| start[t + 1] += start[t]);
        let mut next = start.clone();
        let mut slot = vec![0; *start.last().expect("one more than targets") as usize];
        for (s, t) in target_of_slot.enumerate() {
            slot[next[t as usize] as usize] = s as u32;
            next[t as usize] += 1;
        }
        Self { start, slot }
    }

    /// Slots of one target.
    #[inline(always)]
    pub fn of(&self, target: usize) -> &[u32] {
        &self.slot[self.start[target] as usize..self.start[target + 1] as usize]
    }
}

/// The rest shape of a body and which of its vertices are driven.
#[derive(Clone, Debug)]
pub struct Body {
    /// Rest positions [m], per vertex.
    pub rest: Vec<DVec3>,
    /// Vertices of each tet.
    pub tets: Vec<[u32; 4]>,
    /// Rest volume [m³], per tet.
    pub volume: Vec<f64>,
    /// Volume lumped to each vertex [m³] (a quarter of each of its tets); mass = density × this.
    pub lumped_volume: Vec<f64>,
    /// Vertices that follow prescribed paths, in the order paths are given.
    pub driven: Vec<u32>,
    /// Free vertices in elimination order: the order of every solver vector.
    pub free: Vec<u32>,
    pub(crate) chunks: Vec<Chunk>,
    /// Blocks of the Hessian on the free vertices, lower triangle, in elimination order.
    pub pattern: BlockPattern,
    /// Symbolic analysis of the pattern.
    pub symbolic: Symbolic,
    pub(crate) vertex_slots: Gather,
    pub(crate) block_slots: Gather,
    pub(crate) edges: Edges,
    /// Points on springs; see [`Body::tethered`].
    pub tethers: Vec<Tether>,
    pub(crate) tether_blocks: Vec<TetherBlock>,
}

impl Body {
    /// Checks the mesh and analyses it. `driven` lists the vertices that follow prescribed paths.
    pub fn new(mesh: &TetMesh, driven: &[u32]) -> Result<Self, SimError> {
        let volume = validate(mesh, driven)?;
        let n = mesh.positions.len();
        let mut lumped_volume = vec![0.0; n];
        for (tet, v) in mesh.tets.iter().zip(&volume) {
            tet.iter().for_each(|&i| lumped_volume[i as usize] += v / 4.0);
        }
        let mut is_driven = vec![false; n];
        driven.iter().for_each(|&i| is_driven[i as usize] = true);
        let free = elimination_order(mesh, &is_driven);
        let mut position = vec![u32::MAX; n];
        free.1.iter().enumerate().for_each(|(p, &v)| position[v as usize] = p as u32);
        let mut pairs = free_pairs(mesh, &position);
        let pattern = BlockPattern::from_pairs(free.1.len(), &mut pairs);
        let symbolic = Symbolic::new(&pattern, &free.0);
        let chunks = build_chunks(mesh, &volume, &position, &pattern);
        let vertex_slots = Gather::new(n, chunks.iter().flat_map(|c| c.vertices.iter().copied()));
        let block_slots = Gather::new(pattern.row.len(), chunks.iter().flat_map(|c| c.blocks.iter().copied()));
        Ok(Self {
            rest: mesh.positions.clone(),
            tets: mesh.tets.clone(),
            volume,
            lumped_volume,
            driven: driven.to_vec(),
            free: free.1,
            chunks,
            pattern,
            symbolic,
            vertex_slots,
            block_slots,
            edges: Edges::new(&mesh.tets),
            tethers: Vec::new(),
            tether_blocks: Vec::new(),
        })
    }

    /// Bytes of one Cholesky factor of this body's Hessian.
    pub fn factor_bytes(&self) -> usize {
        8 * self.symbolic.factor_entries()
    }
}

/// Signed volume [m³] of a tet.
pub(crate) fn signed_volume(positions: &[DVec3], tet: &[u32; 4]) -> f64 {
    let [a, b, c, d] = tet.map(|i| positions[i as usize]);
    (b - a).cross(c - a).dot(d - a) / 6.0
}

/// Rest volumes, or what is wrong with the mesh and where.
fn validate(mesh: &TetMesh, driven: &[u32]) -> Result<Vec<f64>, SimError> {
    let n = mesh.positions.len();
    if mesh.tets.is_empty() || n == 0 {
        return Err(SimError::Empty);
    }
    check_finite("rest position of vertex", &mesh.positions)?;
    let mut used = vec![false; n];
    let mut volumes = Vec::with_capacity(mesh.tets.len());
    for (tet, corners) in mesh.tets.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= n) {
            return Err(SimError::VertexOutOfRange { tet, vertex, vertices: n });
        }
        corners.iter().for_each(|&v| used[v as usize] = true);
        let volume = signed_volume(&mesh.positions, corners);
        let p = corners.map(|i| mesh.positions[i as usize]);
        let longest = (0..4).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| p[i].distance(p[j]));
        let longest = longest.fold(0.0, f64::max);
        if volume.abs() <= FLAT * longest.powi(3) {
            return Err(SimError::FlatTet { tet, volume });
        }
        if volume < 0.0 {
            return Err(SimError::InvertedTet { tet, volume });
        }
        volumes.push(volume);
    }
    if let Some(vertex) = used.iter().position(|u| !u) {
        return Err(SimError::LooseVertex { vertex });
    }
    let mut seen = vec![false; n];
    for &vertex in driven {
        match seen.get_mut(vertex as usize) {
            None => return Err(SimError::DrivenVertex { vertex, problem: "not in the mesh" }),
            Some(true) => return Err(SimError::DrivenVertex { vertex, problem: "named twice" }),
            Some(s) => *s = true,
        }
    }
    Ok(volumes)
}

/// Dissection of the free vertices and their elimination order.
fn elimination_order(mesh: &TetMesh, is_driven: &[bool]) -> (animimic_math::sparse::Dissection, Vec<u32>) {
    let free: Vec<u32> = (0..mesh.positions.len() as u32).filter(|&v| !is_driven[v as usize]).collect();
    let mut compact = vec![u32::MAX; mesh.positions.len()];
    free.iter().enumerate().for_each(|(i, &v)| compact[v as usize] = i as u32);
    let mut pairs = free_pairs(mesh, &compact);
    let flipped: Vec<(u32, u32)> = pairs.iter().map(|&(a, b)| (b, a)).collect();
    pairs.extend(flipped);
    pairs.sort_unstable();
    pairs.dedup();
    let mut start = vec![0u32; free.len() + 1];
    pairs.iter().for_each(|&(a, _)| start[a as usize + 1] += 1);
    (0..free.len()).for_each(|i| start[i + 1] += start[i]);
    let neighbour: Vec<u32> = pairs.iter().map(|&(_, b)| b).collect();
    let points: Vec<[f64; 3]> = free.iter().map(|&v| mesh.positions[v as usize].to_array()).collect();
    let dissection = nested_dissection(&points, &start, &neighbour);
    let order = dissection.order.iter().map(|&i| free[i as usize]).collect();
    (dissection, order)
}

/// (higher, lower) numbers of the vertices joined by a tet edge, with repeats; `number` is `u32::MAX` for driven ones.
fn free_pairs(mesh: &TetMesh, number: &[u32]) -> Vec<(u32, u32)> {
    let mut pairs = Vec::with_capacity(6 * mesh.tets.len());
    for tet in &mesh.tets {
        let p = tet.map(|v| number[v as usize]);
        for i in 0..4 {
            for j in 0..i {
                if p[i] != u32::MAX && p[j] != u32::MAX {
                    pairs.push((p[i].max(p[j]), p[i].min(p[j])));
                }
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Tets sorted by where they are eliminated, cut into chunks of batches.
fn build_chunks(mesh: &TetMesh, volume: &[f64], position: &[u32], pattern: &BlockPattern) -> Vec<Chunk> {
    let mut sorted: Vec<(u32, u32, [u32; 4])> = (0..mesh.tets.len() as u32)
        .map(|tet| {
            let mut corners = mesh.tets[tet as usize];
            corners.sort_by_key(|&v| (position[v as usize], v));
            (position[corners[0] as usize], tet, corners)
        })
        .collect();
    sorted.sort_unstable();
    let chunk = |tets: &[(u32, u32, [u32; 4])]| {
        let mut chunk = Chunk { vertices: tets.iter().flat_map(|t| t.2).collect(), ..Chunk::default() };
        chunk.vertices.sort_unstable();
        chunk.vertices.dedup();
        let block_of = |corners: &[u32; 4], (row, column): (usize, usize)| {
            let (r, c) = (position[corners[row] as usize], position[corners[column] as usize]);
            (r != u32::MAX && c != u32::MAX).then(|| pattern.find(r, c).expect("pairs come from the tets") as u32)
        };
        chunk.blocks = tets.iter().flat_map(|t| PAIRS.iter().filter_map(|&p| block_of(&t.2, p))).collect();
        chunk.blocks.sort_unstable();
        chunk.blocks.dedup();
        let local = |list: &[u32], v: u32| list.binary_search(&v).expect("listed above") as u16;
        for lanes in tets.chunks(LANES) {
            let lane = |l: usize| lanes[l.min(lanes.len() - 1)];
            let shape: [([DVec3; 3], f64); LANES] = std::array::from_fn(|l| {
                let (_, tet, corners) = lane(l);
                let used = if l < lanes.len() { volume[tet as usize] } else { 0.0 };
                (shape_gradients(&mesh.positions, &corners), used)
            });
            chunk.batches.push(Batch {
                corner: std::array::from_fn(|l| lane(l).2.map(|v| local(&chunk.vertices, v))),
                tet: std::array::from_fn(|l| lane(l).1),
                used: lanes.len(),
                gradient: std::array::from_fn(|a| {
                    std::array::from_fn(|c| Lanes::new(std::array::from_fn(|l| shape[l].0[a][c])))
                }),
                volume: Lanes::new(std::array::from_fn(|l| shape[l].1)),
                block: std::array::from_fn(|l| match l < lanes.len() {
                    true => PAIRS.map(|p| block_of(&lane(l).2, p).map_or(NO_BLOCK, |b| local(&chunk.blocks, b))),
                    false => [NO_BLOCK; 10],
                }),
            });
        }
        chunk
    };
    sorted.chunks(CHUNK_TETS).map(chunk).collect()
}

/// Rest gradients of the shape functions of corners 1..3: the rows of (X₁−X₀, X₂−X₀, X₃−X₀)⁻¹.
fn shape_gradients(positions: &[DVec3], corners: &[u32; 4]) -> [DVec3; 3] {
    let [a, b, c, d] = corners.map(|i| positions[i as usize]);
    let inverse = DMat3::from_cols(b - a, c - a, d - a).inverse().transpose();
    [inverse.x_axis, inverse.y_axis, inverse.z_axis]
}
