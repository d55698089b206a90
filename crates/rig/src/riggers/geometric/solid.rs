//! The solid of any surface as a graph of voxels, and shortest ways through it.
//!
//! A voxel belongs to the solid where the winding number says so, and where the surface crosses it with nothing within reach that it
//! encloses wholly: fins, ears and open sheets are there as well. Parts that hang in the air are tied to their nearest neighbour by bridges.

use super::grid::Grid;
use animimic_scene::solid::{Soup, UnionFind, WindingNumber};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// No voxel of the solid.
pub(crate) const NONE: u32 = u32::MAX;

/// Voxels of the solid that are aimed at: enough for fingers, few enough for a second.
const WANTED_CELLS: f64 = 150_000.0;

/// Voxels along the longest side: least, most, and those of the first look.
const ACROSS: [f64; 3] = [48.0, 256.0, 64.0];

/// Voxels of the whole grid at most.
const MOST_VOXELS: f64 = 2.4e7;

/// The solid.
pub(crate) struct Solid {
    pub grid: Grid,
    /// Grid number of every cell, ascending.
    pub cells: Vec<u32>,
    /// Cell of every grid voxel, or [`NONE`].
    pub cell_at: Vec<u32>,
    /// Distance from a cell's centre to the outside [model unit].
    pub depth: Vec<f64>,
    /// Which of the 26 neighbours a cell hangs together with, as bits in the order of `steps`.
    open: Vec<u32>,
    /// Grid number and length of the step to each neighbour.
    steps: Vec<(isize, f64)>,
    /// Other ends of bridges \[cell\], with their lengths.
    bridges: Vec<Vec<(u32, f64)>>,
}

impl Solid {
    /// Fills a surface. `mirror` (axis and coordinate) puts the grid symmetrically to that plane.
    pub fn new(soup: &Soup, winding: &WindingNumber, mirror: Option<(usize, f64)>) -> Self {
        let size = soup.bounds[1] - soup.bounds[0];
        let longest = size.max_element();
        let across = |n: f64| {
            let most =
                (MOST_VOXELS * longest.powi(3) / (size + 0.05 * longest).to_array().iter().product::<f64>()).cbrt();
            longest / n.clamp(ACROSS[0], ACROSS[1].min(most))
        };
        let filled = |spacing: f64| {
            let grid = Grid::over(soup.bounds, spacing, mirror);
            let crossed = grid.crossed(soup);
            let enclosed = grid.enclosed(winding, &crossed);
            (grid, crossed, enclosed)
        };
        let first = across(ACROSS[2]);
        let (_, crossed, enclosed) = filled(first);
        let count = |flags: &[bool]| flags.iter().filter(|f| **f).count() as f64;
        // Bodies grow with the third power of the resolution, shells with the second.
        let (body, shell) = (count(&enclosed), 0.5 * count(&crossed));
        let finer = ((WANTED_CELLS / body.max(1.0)).cbrt()).min((WANTED_CELLS / shell.max(1.0)).sqrt());
        let (grid, crossed, enclosed) = filled(across(ACROSS[2] * finer));
        Self::of(grid, soup, &crossed, enclosed)
    }

    fn of(grid: Grid, soup: &Soup, crossed: &[bool], mut solid: Vec<bool>) -> Self {
        add_thin_parts(&grid, crossed, &mut solid);
        if !solid.contains(&true) {
            let i = grid.index(grid.at(soup.positions[soup.triangles[0][0] as usize]));
            solid[i] = true;
        }
        let squared = grid.squared_depth(&solid);
        let cells: Vec<u32> = (0..grid.len()).filter(|&i| solid[i]).map(|i| i as u32).collect();
        let mut cell_at = vec![NONE; grid.len()];
        cells.iter().enumerate().for_each(|(c, &i)| cell_at[i as usize] = c as u32);
        // The outside begins half a voxel before the centre of its first one.
        let depth = cells.iter().map(|&i| (f64::from(squared[i as usize]).sqrt() - 0.5) * grid.spacing).collect();
        let (steps, paths) = neighbourhood(&grid);
        let open = cells.iter().map(|&i| open_steps(&solid, i as usize, &steps, &paths)).collect();
        let bridges = vec![Vec::new(); cells.len()];
        let mut out = Self { grid, cells, cell_at, depth, open, steps, bridges };
        out.tie_loose_parts();
        out
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Centre of a cell.
    pub fn center(&self, cell: u32) -> DVec3 {
        self.grid.center(self.cells[cell as usize] as usize)
    }

    /// Calls `visit` with every neighbour of a cell and the length of the way to it.
    pub fn each_neighbour(&self, cell: u32, mut visit: impl FnMut(u32, f64)) {
        let (i, mut open) = (self.cells[cell as usize] as isize, self.open[cell as usize]);
        while open != 0 {
            let (step, length) = self.steps[open.trailing_zeros() as usize];
            visit(self.cell_at[(i + step) as usize], length);
            open &= open - 1;
        }
        self.bridges[cell as usize].iter().for_each(|&(n, length)| visit(n, length));
    }

    /// The cell nearest to a point, by rings of voxels around it.
    pub fn nearest(&self, p: DVec3) -> u32 {
        let at = self.grid.at(p);
        let most = self.grid.size.into_iter().max().unwrap_or(1);
        let mut best = (f64::INFINITY, 0);
        let mut last = most;
        for ring in 0..=most {
            if ring > last {
                break;
            }
            self.each_in_ring(at, ring, |i| {
                let cell = self.cell_at[i];
                if cell != NONE {
                    let d = self.grid.center(i).distance_squared(p);
                    if d < best.0 {
                        best = (d, cell);
                    }
                }
            });
            if best.0 < f64::INFINITY && last == most {
                // A corner of this ring may be farther than a face of the next ones.
                last = (ring as f64 * 1.75).ceil() as usize + 1;
            }
        }
        best.1
    }

    fn each_in_ring(&self, at: [usize; 3], ring: usize, mut visit: impl FnMut(usize)) {
        let r = ring as isize;
        let range = |k: usize| (at[k] as isize - r).max(0)..=(at[k] as isize + r).min(self.grid.size[k] as isize - 1);
        for z in range(2) {
            for y in range(1) {
                let face = (z - at[2] as isize).abs() == r || (y - at[1] as isize).abs() == r;
                for x in range(0) {
                    if face || (x - at[0] as isize).abs() == r {
                        visit(self.grid.index([x as usize, y as usize, z as usize]));
                    }
                }
            }
        }
    }

    /// Cheapest ways from sources (cell, cost to begin with) to all cells that cost at most `limit`: cost and the cell before.
    pub fn ways(
        &self,
        sources: &[(u32, f64)],
        limit: f64,
        cost: impl Fn(u32, u32, f64) -> f64,
    ) -> (Vec<f64>, Vec<u32>) {
        let mut best = vec![f64::INFINITY; self.len()];
        let mut before = vec![NONE; self.len()];
        let mut heap = BinaryHeap::new();
        for &(cell, start) in sources {
            if start < best[cell as usize] {
                best[cell as usize] = start;
                heap.push(Reverse((Ordered(start), cell)));
            }
        }
        while let Some(Reverse((Ordered(d), cell))) = heap.pop() {
            if d > best[cell as usize] {
                continue;
            }
            self.each_neighbour(cell, |next, length| {
                let through = d + cost(cell, next, length);
                if through < best[next as usize] && through <= limit {
                    best[next as usize] = through;
                    before[next as usize] = cell;
                    heap.push(Reverse((Ordered(through), next)));
                }
            });
        }
        (best, before)
    }

    /// Numbers the parts that hang together.
    fn parts(&self) -> (Vec<u32>, usize) {
        let mut part = vec![NONE; self.len()];
        let mut count = 0;
        for first in 0..self.len() as u32 {
            if part[first as usize] != NONE {
                continue;
            }
            let mut stack = vec![first];
            part[first as usize] = count;
            while let Some(c) = stack.pop() {
                self.each_neighbour(c, |n, _| {
                    if part[n as usize] == NONE {
                        part[n as usize] = count;
                        stack.push(n);
                    }
                });
            }
            count += 1;
        }
        (part, count as usize)
    }

    /// Bridges between parts: the spanning tree of shortest gaps (Kruskal), found where the parts' waves through the outside meet.
    fn tie_loose_parts(&mut self) {
        let (part, count) = self.parts();
        if count == 1 {
            return;
        }
        let grid = self.grid;
        let offsets = grid.strides().map(|s| s as isize);
        // A wave from all cells through the grid: the nearest cell of every voxel, nearly.
        let mut origin: Vec<u32> = self.cell_at.clone();
        let mut wave: Vec<usize> = self.cells.iter().map(|&i| i as usize).collect();
        let mut gaps: Vec<(Ordered, u32, u32)> = Vec::new();
        while !wave.is_empty() {
            let mut next = Vec::new();
            for i in wave {
                let here = origin[i];
                let at = grid.voxel(i);
                for (axis, side) in (0..3).flat_map(|a| [(a, -1isize), (a, 1)]) {
                    let edge = if side < 0 { at[axis] == 0 } else { at[axis] + 1 == grid.size[axis] };
                    if edge {
                        continue;
                    }
                    let n = (i as isize + side * offsets[axis]) as usize;
                    let there = origin[n];
                    if there == NONE {
                        origin[n] = here;
                        next.push(n);
                    } else if part[there as usize] != part[here as usize] {
                        let (a, b) = (here.min(there), here.max(there));
                        gaps.push((Ordered(self.center(a).distance(self.center(b))), a, b));
                    }
                }
            }
            wave = next;
        }
        gaps.sort_unstable();
        gaps.dedup();
        let mut joined = UnionFind::new(count);
        for (Ordered(length), a, b) in gaps {
            let (p, q) = (part[a as usize] as usize, part[b as usize] as usize);
            if !joined.same(p, q) {
                joined.join(p, q);
                self.bridges[a as usize].push((b, length));
                self.bridges[b as usize].push((a, length));
            }
        }
    }
}

/// Numbers that are never NaN, in order.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Ordered(pub f64);

impl Eq for Ordered {}

impl PartialOrd for Ordered {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ordered {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Adds crossed voxels that have no inner voxel (enclosed, not crossed) around them, and those that tie such parts to what they grow from.
fn add_thin_parts(grid: &Grid, crossed: &[bool], solid: &mut [bool]) {
    let (steps, _) = neighbourhood(grid);
    let inner = |i: usize| solid[i] && !crossed[i];
    let near = |i: usize| steps.iter().any(|s| inner((i as isize + s.0) as usize));
    let thin: Vec<usize> = (0..grid.len()).filter(|&i| crossed[i] && !solid[i] && !near(i)).collect();
    thin.iter().for_each(|&i| solid[i] = true);
    let mut sets = UnionFind::new(grid.len());
    let faces = grid.strides().map(|s| s as isize);
    let around = |i: usize| faces.into_iter().flat_map(|s| [-s, s]).map(move |s| (i as isize + s) as usize);
    for i in (0..grid.len()).filter(|&i| solid[i]) {
        around(i).filter(|&n| solid[n]).for_each(|n| sets.join(i, n));
    }
    let rest: Vec<usize> = (0..grid.len()).filter(|&i| crossed[i] && !solid[i]).collect();
    for i in rest {
        let mut roots: Vec<usize> = around(i).filter(|&n| solid[n]).map(|n| sets.find(n)).collect();
        roots.sort_unstable();
        roots.dedup();
        if roots.len() > 1 {
            solid[i] = true;
            roots.into_iter().for_each(|r| sets.join(i, r));
        }
    }
}

/// Steps to the 26 neighbours and their lengths; for each the steps whose voxels must be solid, one of each pair or more.
fn neighbourhood(grid: &Grid) -> (Vec<(isize, f64)>, Vec<Vec<isize>>) {
    let strides = grid.strides().map(|s| s as isize);
    let (mut steps, mut between) = (Vec::new(), Vec::new());
    for z in -1..=1isize {
        for y in -1..=1isize {
            for x in -1..=1isize {
                let d = [x, y, z];
                let moved: Vec<isize> = (0..3).filter(|&k| d[k] != 0).map(|k| d[k] * strides[k]).collect();
                if moved.is_empty() {
                    continue;
                }
                steps.push((moved.iter().sum(), (moved.len() as f64).sqrt() * grid.spacing));
                between.push(moved);
            }
        }
    }
    (steps, between)
}

/// Which neighbours are solid and reached by a way of faces within the block: what meets at an edge or a corner alone stays apart.
fn open_steps(solid: &[bool], i: usize, steps: &[(isize, f64)], between: &[Vec<isize>]) -> u32 {
    let at = |offset: isize| solid[(i as isize + offset) as usize];
    let mut open = 0;
    for (k, (step, _)) in steps.iter().enumerate() {
        let reached = match between[k][..] {
            [_] => true,
            [a, b] => at(a) || at(b),
            [a, b, c] => {
                (at(a) && (at(a + b) || at(a + c)))
                    || (at(b) && (at(a + b) || at(b + c)))
                    || (at(c) && (at(a + c) || at(b + c)))
            }
            _ => false,
        };
        if at(*step) && reached {
            open |= 1 << k;
        }
    }
    open
}
