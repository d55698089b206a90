//! From local components to one mesh: a copy of a lattice tet for each, glued where they continue each other.
//!
//! Two copies at a common face are glued when a sample point of the face lies in both, or a triangle passes from one to the other. Gluing
//! makes the face's three vertices one each; nothing else does (the virtual nodes of Molino, Bao and Fedkiw 2004, on a solid known by samples).

use super::lattice::{Barycentric, Cell, Lattice, Point};
use super::pieces::{Piece, pieces};
use super::regions::{Context, GRID, Regions, regions, sample_grid, sample_pairs};
use animimic_scene::solid::Soup;
use animimic_scene::solid::UnionFind;
use animimic_scene::solid::{Enclosure, WindingNumber};
use animimic_scene::{Embedding, TetMesh};
use glam::DVec3;
use rayon::prelude::*;

/// A lattice tet that the solid or the surface meets.
struct Filled {
    cell: Cell,
    /// Its pieces in the list of all.
    pieces: std::ops::Range<usize>,
    /// Local components; `None` for a tet that is all inside.
    regions: Option<Regions>,
    /// Index of its first copy.
    first_copy: u32,
}

impl Filled {
    fn count(&self) -> u32 {
        self.regions.as_ref().map_or(1, |r| r.count)
    }
}

/// All filled tets of a lattice.
pub(crate) struct Filling<'a> {
    soup: &'a Soup,
    lattice: Lattice,
    pieces: Vec<Piece>,
    filled: Vec<Filled>,
    grid: Vec<[usize; 4]>,
    /// Copies in all.
    copies: usize,
}

impl<'a> Filling<'a> {
    /// Fills a lattice.
    pub fn new(soup: &'a Soup, winding: &WindingNumber, joints_of: &[Vec<u32>], lattice: Lattice) -> Self {
        let pieces = pieces(soup, &lattice);
        let mut groups: Vec<std::ops::Range<usize>> = Vec::new();
        let mut start = 0;
        for same in pieces.chunk_by(|a, b| a.cell == b.cell) {
            groups.push(start..start + same.len());
            start += same.len();
        }
        let grid = sample_grid();
        let pairs = sample_pairs(&grid);
        let samples = Samples::new(&lattice, winding, &grid, groups.iter().map(|g| pieces[g.start].cell));
        let context = Context { soup, winding, lattice: &lattice, pairs: &pairs, joints_of };
        let crossed: Vec<Filled> = groups
            .into_par_iter()
            .map(|range| {
                let cell = pieces[range.start].cell;
                let points: Vec<(DVec3, Enclosure)> =
                    sample_ids(&cell, &grid).iter().map(|&id| samples.get(&lattice, id)).collect();
                let regions = Some(regions(&context, &pieces[range.clone()], &points));
                Filled { cell, pieces: range, regions, first_copy: 0 }
            })
            .collect();
        let mut filled = inner(&lattice, winding, &crossed);
        filled.extend(crossed);
        filled.sort_by_key(|f| f.cell);
        let mut copies = 0;
        for f in &mut filled {
            f.first_copy = copies;
            copies += f.count();
        }
        Self { soup, lattice, pieces, filled, grid, copies: copies as usize }
    }

    /// The mesh, and where each welded surface vertex is in it.
    pub fn assemble(&self) -> (TetMesh, Embedding) {
        let mut corners = UnionFind::new(4 * self.copies);
        for same in self.faces().chunk_by(|a, b| a.0 == b.0) {
            if let [(_, a, ka), (_, b, kb)] = *same {
                self.glue((a as usize, ka as usize), (b as usize, kb as usize), &mut corners);
            }
        }
        let mut number = vec![u32::MAX; 4 * self.copies];
        let mut mesh = TetMesh::default();
        let mut tet_of = Vec::with_capacity(self.copies);
        for f in &self.filled {
            let x = self.lattice.corners(&f.cell);
            let first = mesh.tets.len();
            for copy in f.first_copy..f.first_copy + f.count() {
                let tet = std::array::from_fn(|k| {
                    let root = corners.find(4 * copy as usize + k);
                    if number[root] == u32::MAX {
                        number[root] = mesh.positions.len() as u32;
                        mesh.positions.push(x[k]);
                    }
                    number[root]
                });
                // Copies that their neighbours hold together at all four vertices are one tet.
                let known = mesh.tets[first..].iter().position(|t| *t == tet);
                tet_of.push((first + known.unwrap_or(mesh.tets.len() - first)) as u32);
                if known.is_none() {
                    mesh.tets.push(tet);
                }
            }
        }
        let embedding = self.embed(&mesh, &tet_of);
        (mesh, embedding)
    }

    /// (the face's vertices, filled tet, opposite vertex), sorted.
    fn faces(&self) -> Vec<([Point; 3], u32, u8)> {
        let mut faces = Vec::with_capacity(4 * self.filled.len());
        for (index, f) in self.filled.iter().enumerate() {
            let v = f.cell.vertices();
            for k in 0..4 {
                let mut face = [v[(k + 1) % 4], v[(k + 2) % 4], v[(k + 3) % 4]];
                face.sort_unstable();
                faces.push((face, index as u32, k as u8));
            }
        }
        faces.par_sort_unstable();
        faces
    }

    /// Glues the copies of two tets at their common face.
    fn glue(&self, (a, ka): (usize, usize), (b, kb): (usize, usize), corners: &mut UnionFind) {
        let (fa, fb) = (&self.filled[a], &self.filled[b]);
        let mut pairs: Vec<(u32, u32)> = match (&fa.regions, &fb.regions) {
            (None, None) => vec![(0, 0)],
            (Some(ra), None) => self.on_face(fa, ra, ka).into_iter().map(|(_, c)| (c, 0)).collect(),
            (None, Some(rb)) => self.on_face(fb, rb, kb).into_iter().map(|(_, c)| (0, c)).collect(),
            (Some(ra), Some(rb)) => {
                let (sa, sb) = (self.on_face(fa, ra, ka), self.on_face(fb, rb, kb));
                let mut pairs: Vec<(u32, u32)> = sa
                    .iter()
                    .filter_map(|(id, c)| sb.binary_search_by_key(id, |s| s.0).ok().map(|k| (*c, sb[k].1)))
                    .collect();
                let (pa, pb) = (&self.pieces[fa.pieces.clone()], &self.pieces[fb.pieces.clone()]);
                for (i, p) in pa.iter().enumerate() {
                    if let Ok(j) = pb.binary_search_by_key(&p.triangle, |q| q.triangle)
                        && (p.reaches[ka] || pb[j].reaches[kb])
                    {
                        pairs.push((ra.of_piece[i], rb.of_piece[j]));
                    }
                }
                pairs
            }
        };
        pairs.sort_unstable();
        pairs.dedup();
        let (va, vb) = (fa.cell.vertices(), fb.cell.vertices());
        for (ca, cb) in pairs {
            for (i, v) in va.iter().enumerate().filter(|&(i, _)| i != ka) {
                let j = vb.iter().position(|w| w == v).expect("both tets have the face's vertices");
                corners.join(4 * (fa.first_copy + ca) as usize + i, 4 * (fb.first_copy + cb) as usize + j);
            }
        }
    }

    /// Samples in the face opposite vertex `k` that are inside, with their components, sorted by sample.
    fn on_face(&self, f: &Filled, regions: &Regions, k: usize) -> Vec<(Point, u32)> {
        let ids = sample_ids(&f.cell, &self.grid);
        let mut out: Vec<(Point, u32)> = (0..ids.len())
            .filter(|&s| self.grid[s][k] == 0 && regions.of_sample[s] != u32::MAX)
            .map(|s| (ids[s], regions.of_sample[s]))
            .collect();
        out.sort_unstable();
        out
    }

    fn embed(&self, mesh: &TetMesh, tet_of: &[u32]) -> Embedding {
        // Per welded vertex the best tet so far: how far inside, copy, coordinates.
        let mut best: Vec<(f64, u32, [f64; 4])> = vec![(f64::NEG_INFINITY, 0, [0.25; 4]); self.soup.positions.len()];
        for f in &self.filled {
            let Some(regions) = &f.regions else { continue };
            let barycentric = Barycentric::new(self.lattice.corners(&f.cell));
            for (piece, component) in self.pieces[f.pieces.clone()].iter().zip(&regions.of_piece) {
                for &v in &self.soup.triangles[piece.triangle as usize] {
                    let b = barycentric.at(self.soup.positions[v as usize]);
                    let inside = b.iter().copied().fold(f64::INFINITY, f64::min);
                    if inside > best[v as usize].0 {
                        best[v as usize] = (inside, tet_of[(f.first_copy + component) as usize], b);
                    }
                }
            }
        }
        // Vertices of no triangle that counts go with the nearest tet.
        for (v, best) in best.iter_mut().enumerate().filter(|(_, b)| b.0 == f64::NEG_INFINITY) {
            let p = self.soup.positions[v];
            let corners = |t: usize| mesh.tets[t].map(|k| mesh.positions[k as usize]);
            let distance = |t: usize| corners(t).iter().map(|x| x.distance_squared(p)).sum::<f64>();
            let nearest = (0..mesh.tets.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            if let Some(t) = nearest {
                *best = (0.0, t as u32, Barycentric::new(corners(t)).at(p));
            }
        }
        let of = |&w: &u32| best[w as usize];
        Embedding {
            tet: self.soup.welded.iter().map(|w| of(w).1).collect(),
            barycentric: self.soup.welded.iter().map(|w| of(w).2).collect(),
        }
    }
}

/// Tets without surface that lie inside: reached from those with surface through faces.
fn inner(lattice: &Lattice, winding: &WindingNumber, crossed: &[Filled]) -> Vec<Filled> {
    let is_crossed = |cell: &Cell| crossed.binary_search_by_key(cell, |f| f.cell).is_ok();
    let mut known: std::collections::BTreeMap<Cell, bool> = std::collections::BTreeMap::new();
    let mut front: Vec<Cell> = crossed.iter().map(|f| f.cell).collect();
    while !front.is_empty() {
        let mut next: Vec<Cell> = front.par_iter().flat_map_iter(|cell| neighbours(lattice, cell)).collect();
        next.par_sort_unstable();
        next.dedup();
        next.retain(|cell| !known.contains_key(cell) && !is_crossed(cell));
        let inside: Vec<bool> = next
            .par_iter()
            .map(|cell| {
                let x = lattice.corners(cell);
                winding.at(0.25 * (x[0] + x[1] + x[2] + x[3])).total > 0.5
            })
            .collect();
        known.extend(next.iter().copied().zip(inside.iter().copied()));
        front = next.into_iter().zip(inside).filter(|n| n.1).map(|n| n.0).collect();
    }
    let solid = known.into_iter().filter(|k| k.1);
    solid.map(|(cell, _)| Filled { cell, pieces: 0..0, regions: None, first_copy: 0 }).collect()
}

/// The four tets at a tet's faces.
fn neighbours(lattice: &Lattice, cell: &Cell) -> Vec<Cell> {
    let x = lattice.corners(cell);
    let middle = 0.25 * (x[0] + x[1] + x[2] + x[3]);
    let mut out = Vec::with_capacity(4);
    for k in 0..4 {
        // A little beyond the face's centre.
        let face = (4.0 * middle - x[k]) / 3.0;
        let p = face + 0.1 * (face - middle);
        lattice.each_cell(p, p, |other| {
            if Barycentric::new(lattice.corners(&other)).at(p).iter().all(|&b| b > 0.0) {
                out.push(other);
            }
        });
    }
    out
}

/// A sample's exact coordinates, in units of a side over twice [`GRID`].
fn sample_ids(cell: &Cell, grid: &[[usize; 4]]) -> Vec<Point> {
    let v = cell.vertices();
    grid.iter().map(|g| [0, 1, 2].map(|c| (0..4).map(|k| g[k] as i32 * v[k][c]).sum())).collect()
}

/// All samples of the tets with surface, each evaluated once.
struct Samples {
    ids: Vec<Point>,
    enclosures: Vec<Enclosure>,
}

impl Samples {
    fn new(lattice: &Lattice, winding: &WindingNumber, grid: &[[usize; 4]], cells: impl Iterator<Item = Cell>) -> Self {
        let mut ids: Vec<Point> = cells.flat_map(|cell| sample_ids(&cell, grid)).collect();
        ids.par_sort_unstable();
        ids.dedup();
        let enclosures = ids.par_iter().map(|&id| winding.at(place(lattice, id))).collect();
        Self { ids, enclosures }
    }

    fn get(&self, lattice: &Lattice, id: Point) -> (DVec3, Enclosure) {
        let enclosure = self.ids.binary_search(&id).map_or(Enclosure::default(), |k| self.enclosures[k]);
        (place(lattice, id), enclosure)
    }
}

fn place(lattice: &Lattice, id: Point) -> DVec3 {
    let [x, y, z] = id.map(f64::from);
    lattice.origin + DVec3::new(x, y, z) * (0.5 * lattice.spacing / GRID as f64)
}
