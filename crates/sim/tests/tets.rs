//! Cages of models and of generated nasties.

#[path = "../examples/tets/models.rs"]
mod models;

use animimic_scene::solid::SurfaceError;
use animimic_scene::{Mesh, io};
use animimic_sim::SimError;
use animimic_sim::tet::{Cage, cage, quality};
use glam::DVec3;
use models::models;
use std::f64::consts::TAU;
use std::path::Path;

/// What must hold for every cage: embedding in place, tets good, as many as asked for.
fn check(name: &str, mesh: &Mesh, cage: &Cage, tets: usize) {
    let q = quality(&cage.mesh);
    assert_eq!(q.inverted, 0, "{name}");
    assert!(q.dihedral_deg[0] >= 10.0, "{name}: least dihedral angle {:.1}°", q.dihedral_deg[0]);
    let share = cage.mesh.tets.len() as f64 / tets as f64;
    assert!((0.7..1.4).contains(&share), "{name}: {} tets, {tets} asked for", cage.mesh.tets.len());
    assert_eq!(cage.embedding.tet.len(), mesh.positions.len(), "{name}");
    for ((&t, b), p) in cage.embedding.tet.iter().zip(&cage.embedding.barycentric).zip(&mesh.positions) {
        let x = cage.mesh.tets[t as usize].map(|v| cage.mesh.positions[v as usize]);
        let there: DVec3 = (0..4).map(|k| x[k] * b[k]).sum();
        let size = cage.spacing + p.length();
        assert!(there.distance(*p) < 1e-9 * size, "{name}: a vertex is embedded {} away", there.distance(*p));
    }
    // Distance from the tet: no more than its lowest coordinate below 0 times its size.
    let used = mesh.triangles.iter().flatten().map(|&v| cage.embedding.barycentric[v as usize]);
    let outside = used.map(|b| -b.iter().copied().fold(0.0, f64::min)).fold(0.0, f64::max);
    assert!(outside < 0.5, "{name}: a vertex is {outside:.2} cells outside its tet");
}

#[test]
fn every_model_of_the_data_gets_a_good_cage_with_its_own_topology() {
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    if !data.exists() {
        println!("skipped: {} is not there", data.display());
        return;
    }
    // Closed, of one part that does not cut itself: half the surface's Euler number.
    // The rabbit's left forefoot stands 0.006 units off the body, of 4.7 in all: two parts.
    let known = [
        ("c3d_spot", 1, 1),
        ("igl_bunny", 1, 1),
        ("igl_cow", 1, 1),
        ("igl_elephant", 1, 1),
        ("tm_busted", 1, 1),
        ("tm_tube", 0, 1),
        ("tm_rabbit", 2, 2),
    ];
    let mut paths = Vec::new();
    models(data, &mut paths);
    let mut seen = 0;
    for path in paths {
        let name = path.strip_prefix(data).unwrap_or(&path).display().to_string();
        if name.contains("norig") {
            // The same surface as its neighbour.
            continue;
        }
        if name.ends_with(".gltf") {
            println!("skipped: {name} requires Draco");
            continue;
        }
        let mesh = io::read(&path).unwrap_or_else(|e| panic!("{name}: {e}")).mesh;
        let made = cage(&mesh, 3000).unwrap_or_else(|e| panic!("{name}: {e}"));
        let q = quality(&made.mesh);
        println!("{name}: {} tets, Euler {}, {} parts", made.mesh.tets.len(), q.euler, q.components);
        check(&name, &mesh, &made, 3000);
        if let Some((_, euler, parts)) = known.iter().find(|(n, ..)| name.contains(n)) {
            assert_eq!((q.euler, q.components), (*euler, *parts), "{name}");
            seen += 1;
        }
    }
    assert_eq!(seen, known.len());
}

/// A closed box, outwards.
fn block(lo: DVec3, hi: DVec3) -> Mesh {
    let positions: Vec<DVec3> =
        (0..8).map(|k| DVec3::new([lo.x, hi.x][k & 1], [lo.y, hi.y][k >> 1 & 1], [lo.z, hi.z][k >> 2])).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    Mesh { positions, triangles, ..Mesh::default() }
}

fn together(parts: &[Mesh]) -> Mesh {
    let mut all = Mesh::default();
    for m in parts {
        let first = all.positions.len() as u32;
        all.positions.extend(&m.positions);
        all.triangles.extend(m.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

/// A sheet (u, v) → point of `n` by `m` squares; closed in u where `wrap` says how v goes on at the seam.
fn sheet(n: usize, m: usize, wrap: Option<bool>, shape: impl Fn(f64, f64) -> DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=n {
        for j in 0..=m {
            let (mut u, mut v) = (i as f64 / n as f64, j as f64 / m as f64);
            if let (true, Some(turned)) = (i == n, wrap) {
                (u, v) = (0.0, if turned { 1.0 - v } else { v });
            }
            mesh.positions.push(shape(u, v));
        }
    }
    let at = |i: usize, j: usize| (i * (m + 1) + j) as u32;
    for i in 0..n {
        for j in 0..m {
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

/// A trunk with two legs, one surface: a tuning fork whose prongs are `gap` apart.
fn fork(gap: f64) -> Mesh {
    // A profile in the plane, counter-clockwise, given thickness; prongs long and slender.
    let half = 0.5 * gap;
    let profile =
        [[-0.3, -1.0], [-half, -1.0], [-half, 0.0], [half, 0.0], [half, -1.0], [0.3, -1.0], [0.3, 0.4], [-0.3, 0.4]];
    let n = profile.len() as u32;
    let mut mesh = Mesh::default();
    for z in [-0.15, 0.15] {
        mesh.positions.extend(profile.iter().map(|p| DVec3::new(p[0], p[1], z)));
    }
    // The profile in triangles: left prong, right prong, trunk (with the crotch's corners on its lower side).
    let cap = [[0, 1, 2], [0, 2, 7], [2, 3, 7], [3, 6, 7], [3, 4, 5], [3, 5, 6]];
    for t in cap {
        mesh.triangles.push([t[0] + n, t[1] + n, t[2] + n]);
        mesh.triangles.push([t[0], t[2], t[1]]);
    }
    for k in 0..n {
        let next = (k + 1) % n;
        mesh.triangles.push([k, next, next + n]);
        mesh.triangles.push([k, next + n, k + n]);
    }
    // Coincident corners of touching prongs are different vertices, as skinned files have them.
    mesh.welded = (0..mesh.positions.len() as u32).collect();
    mesh.welded_count = mesh.positions.len();
    mesh
}

/// Tets that hold a surface vertex chosen by `which`.
fn tets_of(mesh: &Mesh, cage: &Cage, which: impl Fn(&DVec3) -> bool) -> Vec<u32> {
    let mut out: Vec<u32> =
        (0..mesh.positions.len()).filter(|&v| which(&mesh.positions[v])).map(|v| cage.embedding.tet[v]).collect();
    out.sort_unstable();
    out.dedup();
    out
}

/// Steps through common vertices from some tets to others.
fn steps_between(cage: &Cage, from: &[u32], to: &[u32]) -> usize {
    let mut reached: Vec<bool> = vec![false; cage.mesh.positions.len()];
    from.iter().for_each(|&t| cage.mesh.tets[t as usize].iter().for_each(|&v| reached[v as usize] = true));
    for steps in 0..1000 {
        if to.iter().any(|&t| cage.mesh.tets[t as usize].iter().any(|&v| reached[v as usize])) {
            return steps;
        }
        let before = reached.clone();
        for t in &cage.mesh.tets {
            if t.iter().any(|&v| before[v as usize]) {
                t.iter().for_each(|&v| reached[v as usize] = true);
            }
        }
    }
    usize::MAX
}

#[test]
fn legs_that_touch_nearly_touch_or_overlap_never_share_a_tet_nor_a_vertex() {
    for gap in [0.1, 0.01, 1e-4, 0.0, -0.01] {
        for tets in [150, 600, 3000] {
            let mesh = fork(gap);
            let made = cage(&mesh, tets).expect("a fork is a good surface");
            check(&format!("fork {gap}"), &mesh, &made, tets);
            let feet = |right: bool| tets_of(&mesh, &made, |p| p.y < -0.9 && (p.x == if right { 0.3 } else { -0.3 }));
            let inner = |right: bool| {
                let n = mesh.positions.len() / 2;
                let ids = if right { [4, 4 + n] } else { [1, 1 + n] };
                ids.map(|v| made.embedding.tet[v]).to_vec()
            };
            // The way leads up one leg and down the other, 2 in all; a step, and the tets at both ends, reach one edge at most.
            let expected = (2.0 / made.spacing - 2.0).floor() as usize;
            let outer = steps_between(&made, &feet(false), &feet(true));
            let near = steps_between(&made, &inner(false), &inner(true));
            println!(
                "gap {gap}, {} tets: {outer} and {near} steps from foot to foot, at least {expected}",
                made.mesh.tets.len()
            );
            assert!(outer >= expected && near >= expected);
            assert_eq!(quality(&made.mesh).components, 1);
        }
    }
}

#[test]
fn a_fork_whose_one_leg_is_moved_does_not_drag_the_other() {
    let mesh = fork(0.0);
    let made = cage(&mesh, 600).expect("a fork is a good surface");
    // Moving every tet vertex reached from the left foot within a leg's length moves no surface vertex of the right leg.
    let mut moved = vec![false; made.mesh.positions.len()];
    let left: Vec<u32> = tets_of(&mesh, &made, |p| p.y < -0.9 && p.x == -0.3);
    left.iter().for_each(|&t| made.mesh.tets[t as usize].iter().for_each(|&v| moved[v as usize] = true));
    for _ in 0..(0.8 / made.spacing) as usize {
        let before = moved.clone();
        for t in made.mesh.tets.iter().filter(|t| t.iter().any(|&v| before[v as usize])) {
            t.iter().for_each(|&v| moved[v as usize] = true);
        }
    }
    let n = mesh.positions.len() / 2;
    for v in [4, 5, 4 + n, 5 + n] {
        let tet = made.mesh.tets[made.embedding.tet[v] as usize];
        assert!(tet.iter().all(|&k| !moved[k as usize]), "vertex {v} of the right foot is dragged");
    }
}

#[test]
fn thin_parts_hang_together_as_the_surface_does() {
    // A body with a fin far thinner than a cell, and a needle: one part, no holes.
    let body = block(DVec3::splat(-0.5), DVec3::splat(0.5));
    let fin = block(DVec3::new(-0.001, 0.4, -0.4), DVec3::new(0.001, 1.2, 0.4));
    let needle = block(DVec3::new(0.4, -0.002, -0.002), DVec3::new(2.0, 0.002, 0.002));
    let mesh = together(&[body, fin, needle]);
    let made = cage(&mesh, 1500).expect("a good surface");
    check("fins", &mesh, &made, 1500);
    let q = quality(&made.mesh);
    println!("fin and needle: {q:?}");
    assert_eq!((q.components, q.euler), (1, 1));
}

#[test]
fn open_onesided_and_branching_sheets_and_single_triangles_get_shells_of_cells() {
    let moebius = sheet(60, 6, Some(true), |u, v| {
        let (a, w) = (TAU * u, 0.6 * (v - 0.5));
        let r = 1.0 + w * (0.5 * a).cos();
        DVec3::new(r * a.cos(), w * (0.5 * a).sin(), r * a.sin())
    });
    let fan = together(
        &[0.0f64, 1.2, 2.9, 4.4].map(|a| sheet(4, 4, None, move |u, v| DVec3::new(u * a.cos(), v, u * a.sin()))),
    );
    let triangle =
        Mesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    let annulus = sheet(40, 3, Some(false), |u, v| (1.0 + v) * DVec3::new((TAU * u).cos(), 0.2, (TAU * u).sin()));
    for (name, mesh, euler) in
        [("Möbius strip", moebius, 0), ("fan", fan, 1), ("triangle", triangle, 1), ("annulus", annulus, 0)]
    {
        let made = cage(&mesh, 1000).expect("a sheet is a surface");
        check(name, &mesh, &made, 1000);
        let q = quality(&made.mesh);
        println!("{name}: {q:?}");
        assert_eq!((q.components, q.euler), (1, euler), "{name}");
    }
}

#[test]
fn nested_shells_are_solid_cavities_stay_and_separate_bodies_are_separate() {
    let cube = |h: f64| block(DVec3::splat(-h), DVec3::splat(h));
    let mut inside_out = cube(0.5);
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let apart = together(&[cube(1.0), block(DVec3::new(1.02, -1.0, -1.0), DVec3::new(2.0, 1.0, 1.0))]);
    let overlapping = together(&[cube(1.0), block(DVec3::new(0.9, -0.1, -0.1), DVec3::new(3.0, 0.1, 0.1))]);
    // Lenses and gaps of two thousandths; a spike without a bottom that hardly stands in the body.
    let ball = |x: f64| {
        let at = DVec3::new(x, 0.3, 0.1);
        sheet(24, 12, Some(false), move |u, v| {
            let (a, b) = (TAU * u, 0.5 * TAU * (0.001 + 0.998 * v));
            at + 0.5 * DVec3::new(b.cos(), b.sin() * a.cos(), b.sin() * a.sin())
        })
    };
    let spike = sheet(8, 1, Some(false), |u, v| {
        let r = 0.02 * (1.001 - v);
        DVec3::new(0.99 + 0.1 * v, r * (TAU * u).cos(), r * (TAU * u).sin())
    });
    let mut turned = cube(1.0);
    turned.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let cases = [
        ("nested", together(&[cube(1.0), cube(0.5)]), 1, 1),
        // A ball's shell: Euler number 2.
        ("cavity", together(&[cube(1.0), inside_out]), 1, 2),
        ("apart", apart, 2, 2),
        ("overlapping", overlapping, 1, 1),
        ("inside out", turned, 1, 1),
        ("lens", together(&[cube(1.0), ball(1.498)]), 1, 1),
        ("gap", together(&[cube(1.0), ball(1.502)]), 2, 2),
        ("spike", together(&[cube(1.0), spike]), 1, 1),
    ];
    for (name, mesh, components, euler) in cases {
        let made = cage(&mesh, 3000).expect("a good surface");
        check(name, &mesh, &made, 3000);
        let q = quality(&made.mesh);
        println!("{name}: {q:?}");
        assert_eq!((q.components, q.euler), (components, euler), "{name}");
    }
}

#[test]
fn the_same_surface_gives_the_same_bytes_for_any_number_of_threads() {
    let mesh = fork(0.01);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let made = pool.install(|| cage(&mesh, 700)).expect("a good surface");
        (made.mesh.tets, made.mesh.positions, made.embedding.tet, made.embedding.barycentric)
    };
    assert!(run(1) == run(3));
}

#[test]
fn surfaces_without_area_and_broken_ones_are_typed_errors() {
    let flat =
        Mesh { positions: vec![DVec3::ZERO, DVec3::X, 2.0 * DVec3::X], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    assert_eq!(cage(&flat, 100).err(), Some(SurfaceError::Empty.into()));
    assert_eq!(cage(&Mesh::default(), 100).err(), Some(SurfaceError::Empty.into()));
    let mut bad = block(DVec3::ZERO, DVec3::ONE);
    assert!(matches!(cage(&bad, 0), Err(SimError::OutOfRange { name: "tets", .. })));
    bad.triangles[3][1] = 99;
    assert!(matches!(
        cage(&bad, 100),
        Err(SimError::Surface(SurfaceError::Index { triangle: 3, vertex: 99, vertices: 8 }))
    ));
    bad.positions[2].y = f64::NAN;
    assert!(matches!(cage(&bad, 100), Err(SimError::Surface(SurfaceError::NotFinite { index: 2 }))));
}
