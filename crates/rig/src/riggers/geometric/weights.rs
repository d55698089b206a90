//! Skin weights: each joint's share of the solid, softened within it, read off at the surface.
//!
//! A cell belongs to the joint whose medial balls are nearest, measured through the solid (geodesic voxel binding, Dionne and
//! de Lasa 2013, with distances from balls instead of bones: a belly stays with the spine although a thigh is nearer than the spine's
//! axis). The shares then diffuse through the solid over a length that follows its local thickness: smooth and local, never negative,
//! summing to one. Where gaps are finer than voxels the surface decides: a joint keeps only those of its vertices that hang together, over
//! the surface, with some that are mostly its own.

use super::solid::{NONE, Solid};
use animimic_scene::solid::{Soup, UnionFind};
use animimic_scene::{Influence, Mesh};
use glam::DVec3;
use rayon::prelude::*;

/// Standard deviation of the blend [radius of the nearest medial ball], and its least [voxels].
const BLEND: f64 = 0.5;
const LEAST_BLEND: f64 = 0.9;

/// Blends end after so many standard deviations.
const REACH: f64 = 3.0;

/// One sweep of averaging over 26 neighbours spreads by this variance along each axis [voxels²].
const SPREAD: f64 = 18.0 / 27.0;

/// Influences of a vertex.
const INFLUENCES: usize = 4;

/// Weights below this are dropped.
const LEAST: f64 = 0.004;

/// Pieces of surface smaller than this move rigidly [longest side]: eyes, buttons, teeth.
const RIGID: f64 = 0.06;

/// The medial balls of all joints: joint, centre, radius.
pub(crate) type Seeds = Vec<(usize, DVec3, f64)>;

/// Influences of every vertex of a mesh, slots being joints.
pub(crate) fn weights(solid: &Solid, soup: &Soup, mesh: &Mesh, seeds: &Seeds, joints: usize) -> Vec<Vec<Influence>> {
    let (owner, blend) = territories(solid, seeds);
    let fields: Vec<Vec<(u32, f64)>> =
        (0..joints).into_par_iter().map(|j| softened(solid, &owner, &blend, j as u32)).collect();
    let mut of_cell: Vec<Vec<(u32, f64)>> = vec![Vec::new(); solid.len()];
    for (joint, field) in fields.iter().enumerate() {
        field.iter().for_each(|&(cell, w)| of_cell[cell as usize].push((joint as u32, w)));
    }
    let normals = normals(soup);
    let mut lists: Vec<Vec<(u32, f64)>> = (0..soup.positions.len())
        .into_par_iter()
        .map(|v| at_vertex(solid, &of_cell, soup.positions[v], normals[v]))
        .collect();
    drop_islands(soup, &mut lists, joints);
    stiffen_small_pieces(soup, &mut lists);
    let lists: Vec<Vec<Influence>> = lists.into_iter().map(pruned).collect();
    (0..mesh.positions.len()).map(|v| lists[soup.welded[v] as usize].clone()).collect()
}

/// Joint of every cell and standard deviation of its blend [model unit].
fn territories(solid: &Solid, seeds: &Seeds) -> (Vec<u32>, Vec<f64>) {
    let cells: Vec<u32> = seeds.iter().map(|s| solid.nearest(s.1)).collect();
    let sources: Vec<(u32, f64)> = seeds.iter().zip(&cells).map(|(s, &c)| (c, -s.2)).collect();
    let (cost, before) = solid.ways(&sources, f64::INFINITY, |_, _, length| length);
    let mut seed_of = vec![NONE; solid.len()];
    let mut order: Vec<u32> = (0..solid.len() as u32).collect();
    order.sort_by(|&a, &b| cost[a as usize].total_cmp(&cost[b as usize]).then(a.cmp(&b)));
    for (k, &(cell, start)) in sources.iter().enumerate() {
        let at = cell as usize;
        if before[at] == NONE && start == cost[at] && seed_of[at] == NONE {
            seed_of[at] = k as u32;
        }
    }
    for cell in order {
        let at = cell as usize;
        if seed_of[at] == NONE && before[at] != NONE {
            seed_of[at] = seed_of[before[at] as usize];
        }
    }
    let least = LEAST_BLEND * solid.grid.spacing;
    let known = |s: u32| seeds.get(s as usize).map_or((0, 0.0), |s| (s.0 as u32, s.2));
    seed_of.iter().map(|&s| known(s)).map(|(joint, radius)| (joint, (BLEND * radius).max(least))).unzip()
}

/// One joint's share after diffusion: (cell, weight).
fn softened(solid: &Solid, owner: &[u32], blend: &[f64], joint: u32) -> Vec<(u32, f64)> {
    let own: Vec<(u32, f64)> =
        (0..owner.len() as u32).filter(|&c| owner[c as usize] == joint).map(|c| (c, 0.0)).collect();
    if own.is_empty() {
        return Vec::new();
    }
    let (cost, _) = solid.ways(&own, REACH, |a, b, length| length * 2.0 / (blend[a as usize] + blend[b as usize]));
    let cells: Vec<u32> = (0..owner.len() as u32).filter(|&c| cost[c as usize] <= REACH).collect();
    let mut local = vec![NONE; owner.len()];
    cells.iter().enumerate().for_each(|(k, &c)| local[c as usize] = k as u32);
    let (mut start, mut near) = (vec![0usize], Vec::new());
    for &c in &cells {
        solid.each_neighbour(c, |n, _| near.push(local[n as usize]));
        start.push(near.len());
    }
    let widest = cells.iter().map(|&c| blend[c as usize]).fold(0.0, f64::max);
    let spacing = solid.grid.spacing;
    let sweeps = ((widest / spacing).powi(2) / SPREAD).ceil();
    let rate: Vec<f64> = cells.iter().map(|&c| (blend[c as usize] / spacing).powi(2) / (SPREAD * sweeps)).collect();
    let mut field: Vec<f64> = cells.iter().map(|&c| f64::from(u8::from(owner[c as usize] == joint))).collect();
    let mut next = field.clone();
    for _ in 0..sweeps as usize {
        for k in 0..cells.len() {
            let around = &near[start[k]..start[k + 1]];
            let sum: f64 = around.iter().map(|&n| if n == NONE { 0.0 } else { field[n as usize] }).sum();
            let mean = (sum + field[k]) / (around.len() + 1) as f64;
            next[k] = field[k] + rate[k] * (mean - field[k]);
        }
        std::mem::swap(&mut field, &mut next);
    }
    cells.into_iter().zip(field).filter(|p| p.1 > 1e-6).collect()
}

/// Outward unit normals of welded vertices, weighted by area; zero where a sheet is folded onto itself.
fn normals(soup: &Soup) -> Vec<DVec3> {
    let mut out = vec![DVec3::ZERO; soup.positions.len()];
    for (t, v) in soup.triangles.iter().enumerate() {
        let [a, b, c] = soup.corners(t);
        let n = (b - a).cross(c - a);
        v.iter().for_each(|&k| out[k as usize] += n);
    }
    out.into_iter().map(|n| n.normalize_or_zero()).collect()
}

/// Mean over the cell just inside a vertex and its neighbours, nearer ones counting more.
fn at_vertex(solid: &Solid, of_cell: &[Vec<(u32, f64)>], p: DVec3, normal: DVec3) -> Vec<(u32, f64)> {
    let spacing = solid.grid.spacing;
    let here = solid.nearest(p - 0.6 * spacing * normal);
    let mut near = vec![here];
    solid.each_neighbour(here, |n, length| {
        if length < 1.8 * spacing {
            near.push(n);
        }
    });
    let mut list: Vec<(u32, f64)> = Vec::new();
    for cell in near {
        let d = solid.center(cell).distance(p) / spacing;
        let share = (-0.8 * d * d).exp() + 1e-9;
        for &(joint, w) in &of_cell[cell as usize] {
            match list.iter_mut().find(|i| i.0 == joint) {
                Some(i) => i.1 += share * w,
                None => list.push((joint, share * w)),
            }
        }
    }
    normalized(list)
}

/// Takes a joint's weight from vertices that do not hang together, over edges that it moves, with vertices that it moves most.
fn drop_islands(soup: &Soup, lists: &mut [Vec<(u32, f64)>], joints: usize) {
    let mut movers: Vec<Vec<u32>> = vec![Vec::new(); joints];
    for (v, list) in lists.iter().enumerate() {
        list.iter().filter(|i| i.1 > LEAST).for_each(|i| movers[i.0 as usize].push(v as u32));
    }
    let edges: Vec<[u32; 2]> = soup.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); lists.len()];
    for [a, b] in edges {
        around[a as usize].push(b);
        around[b as usize].push(a);
    }
    let strongest: Vec<u32> = lists
        .iter()
        .map(|l| l.iter().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).map_or(NONE, |i| i.0))
        .collect();
    let mut seen = vec![NONE; lists.len()];
    for (joint, moved) in movers.iter().enumerate() {
        let joint = joint as u32;
        moved.iter().for_each(|&v| seen[v as usize] = joint);
        // What hangs together with a vertex of its own stays: those are taken off the marks.
        let mut stack: Vec<u32> = moved.iter().copied().filter(|&v| strongest[v as usize] == joint).collect();
        stack.iter().for_each(|&v| seen[v as usize] = NONE);
        while let Some(v) = stack.pop() {
            for &n in &around[v as usize] {
                if seen[n as usize] == joint {
                    seen[n as usize] = NONE;
                    stack.push(n);
                }
            }
        }
        for &v in moved {
            if std::mem::replace(&mut seen[v as usize], NONE) == joint {
                lists[v as usize].retain(|i| i.0 != joint);
            }
        }
    }
    lists.iter_mut().for_each(|l| *l = normalized(std::mem::take(l)));
}

/// Gives every vertex of a small piece of surface the piece's mean weights.
fn stiffen_small_pieces(soup: &Soup, lists: &mut [Vec<(u32, f64)>]) {
    let mut sets = UnionFind::new(lists.len());
    for &[a, b, c] in &soup.triangles {
        sets.join(a as usize, b as usize);
        sets.join(b as usize, c as usize);
    }
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); lists.len()];
    (0..lists.len()).for_each(|v| members[sets.find(v)].push(v));
    let longest = (soup.bounds[1] - soup.bounds[0]).max_element();
    for piece in members.iter().filter(|m| m.len() > 1) {
        let lo = piece.iter().map(|&v| soup.positions[v]).fold(DVec3::INFINITY, DVec3::min);
        let hi = piece.iter().map(|&v| soup.positions[v]).fold(DVec3::NEG_INFINITY, DVec3::max);
        if (hi - lo).max_element() > RIGID * longest {
            continue;
        }
        let mut mean: Vec<(u32, f64)> = Vec::new();
        for &v in piece {
            for &(joint, w) in &lists[v] {
                match mean.iter_mut().find(|i| i.0 == joint) {
                    Some(i) => i.1 += w,
                    None => mean.push((joint, w)),
                }
            }
        }
        let mean = normalized(mean);
        piece.iter().for_each(|&v| lists[v] = mean.clone());
    }
}

fn normalized(mut list: Vec<(u32, f64)>) -> Vec<(u32, f64)> {
    let sum: f64 = list.iter().map(|i| i.1).sum();
    list.iter_mut().for_each(|i| i.1 /= sum);
    list
}

/// The largest few, summing to 1, largest first.
fn pruned(mut list: Vec<(u32, f64)>) -> Vec<Influence> {
    list.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    list.truncate(INFLUENCES);
    list.retain(|i| i.1 > LEAST);
    normalized(list).into_iter().map(|(slot, weight)| Influence { slot, weight }).collect()
}
