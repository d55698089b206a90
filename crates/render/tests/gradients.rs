//! The renderer's adjoint as a whole: scene class × parameter, against central differences.
//!
//! Loss: Σ over pixels of ⟨W, colour⟩ + w·coverage, divided by the number of pixels, with smooth weight fields W, w that are
//! fixed on the screen. The reference is the same loss of a 16× supersampled picture, differenced along random directions; ours
//! is the analytic gradient, averaged over sub-pixel shifts of scene and weights together.

use animimic_math::gradcheck::SplitMix64;
use animimic_render::{
    Cotangents, Gradients, Light, NONE, Rendered, Surface, rasterize_surface, render_into, render_vjp, shade,
};
use animimic_scene::{Camera, Image, Look, Mesh, Part, Texture};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::sync::Arc;

const SIZE: u32 = 96;
const SUPERSAMPLES: u32 = 16;
const SHIFTS: usize = 8;
/// Differences step [model unit]: two samples of the reference. Outlines of facets have kinks, which larger steps would cross.
const STEP: f64 = 0.004;
const BACKGROUND: [f32; 3] = [0.85; 3];

struct Scene {
    name: &'static str,
    surface: Surface,
    positions: Vec<DVec3>,
    camera: Camera,
    light: Light,
}

/// Smooth weights on the screen: three colours and coverage. `p` in units of the picture's side.
fn weights(p: DVec2) -> [f64; 4] {
    [
        1.0 + 0.8 * (5.0 * p.x + 1.0).sin(),
        -0.7 + 0.6 * (4.0 * p.y - 3.0 * p.x).cos(),
        0.5 + 0.9 * (3.0 * p.x + 5.0 * p.y).sin(),
        0.8 - 0.7 * (4.0 * p.x + 2.0 * p.y).cos(),
    ]
}

fn reference_loss(scene: &Scene, positions: &[DVec3], camera: &Camera) -> f64 {
    let size = SIZE * SUPERSAMPLES;
    let fine = camera.resized(size, size);
    let raster = rasterize_surface(&fine, &scene.surface, positions, true);
    let rgb = shade(&fine, &scene.surface, positions, &raster, &scene.light, BACKGROUND, true);
    let n = size as usize;
    let mut sum = 0.0;
    for pixel in 0..n * n {
        let p = DVec2::new((pixel % n) as f64 + 0.5, (pixel / n) as f64 + 0.5) / f64::from(size);
        let w = weights(p);
        let covered = if raster.covered(pixel) { 1.0 } else { 0.0 };
        sum += (0..3).map(|c| w[c] * f64::from(rgb[pixel][c])).sum::<f64>() + w[3] * covered;
    }
    sum / (n * n) as f64
}

/// Mean gradient over sub-pixel shifts.
fn gradients(scene: &Scene, depth: bool) -> Vec<Gradients> {
    let n = SIZE as usize;
    let mut out = Vec::new();
    let mut rendered = Rendered::default();
    for shift in 0..SHIFTS * SHIFTS {
        let step = |k: usize| (k as f64 + 0.5) / SHIFTS as f64 - 0.5;
        let shift = DVec2::new(step(shift % SHIFTS), step(shift / SHIFTS));
        let camera = Camera { cx: scene.camera.cx + shift.x, cy: scene.camera.cy + shift.y, ..scene.camera };
        render_into(&camera, &scene.surface, &scene.positions, &scene.light, BACKGROUND, &mut rendered);
        let share = 1.0 / (n * n) as f64;
        let at = |pixel: usize| {
            let p = DVec2::new((pixel % n) as f64 + 0.5, (pixel / n) as f64 + 0.5) - shift;
            weights(p / f64::from(SIZE)).map(|w| (w * share) as f32)
        };
        let rgb: Vec<[f32; 3]> = (0..n * n).map(|p| [at(p)[0], at(p)[1], at(p)[2]]).collect();
        let mask: Vec<f32> = (0..n * n).map(|p| at(p)[3]).collect();
        let d = if depth {
            Cotangents { depth: &mask, ..Cotangents::default() }
        } else {
            Cotangents { rgb: &rgb, mask: &mask, depth: &[] }
        };
        out.push(render_vjp(&camera, &scene.surface, &scene.positions, &scene.light, &rendered, &d, true));
    }
    out
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}

/// Analytic and numeric directional derivatives, and the error relative to the larger of them (or their rms).
fn error(name: &str, parameter: &str, pairs: &[(f64, f64)]) -> f64 {
    let rms = (pairs.iter().map(|(_, n)| n * n).sum::<f64>() / pairs.len() as f64).sqrt();
    let worst = pairs.iter().map(|(a, n)| (a - n).abs() / n.abs().max(rms)).fold(0.0, f64::max);
    println!("{name} x {parameter}: relative error {worst:.2e}");
    worst
}

fn moved(positions: &[DVec3], field: &dyn Fn(DVec3) -> DVec3, step: f64) -> Vec<DVec3> {
    positions.iter().map(|&p| p + field(p) * step).collect()
}

fn turned(camera: &Camera, turn: DVec3, shift: DVec3) -> Camera {
    let motion = DAffine3::from_translation(shift) * DAffine3::from_quat(DQuat::from_scaled_axis(turn));
    Camera { view_from_world: motion * camera.view_from_world, ..*camera }
}

fn vertex_error(scene: &Scene, gradients: &[Gradients], rng: &mut SplitMix64) -> f64 {
    let pairs: Vec<(f64, f64)> = (0..3)
        .map(|_| {
            let random = |rng: &mut SplitMix64| DVec3::new(rng.normal(), rng.normal(), rng.normal());
            let (a, k, phase, b) = (random(rng), random(rng) * 1.5, rng.normal(), random(rng));
            let field = move |p: DVec3| a * (k.dot(p) + phase).sin() + b * 0.5;
            let along =
                |g: &Gradients| scene.positions.iter().zip(&g.positions).map(|(&p, d)| field(p).dot(*d)).sum::<f64>();
            let step = STEP;
            let at = |s: f64| reference_loss(scene, &moved(&scene.positions, &field, s), &scene.camera);
            (mean(gradients.iter().map(along)), (at(step) - at(-step)) / (2.0 * step))
        })
        .collect();
    error(scene.name, "vertex", &pairs)
}

fn camera_error(scene: &Scene, gradients: &[Gradients], rng: &mut SplitMix64) -> f64 {
    let pairs: Vec<(f64, f64)> = (0..3)
        .map(|_| {
            let mut random = || DVec3::new(rng.normal(), rng.normal(), rng.normal());
            let (turn, shift) = (random() * 0.2, random());
            let focal = 10.0 * random().x;
            let along = |g: &Gradients| {
                g.camera.rotation(&scene.camera).dot(turn)
                    + g.camera.translation.dot(shift)
                    + focal * (g.camera.fx + g.camera.fy)
            };
            let step = STEP;
            let at = |s: f64| {
                let mut camera = turned(&scene.camera, turn * s, shift * s);
                camera.fx += focal * s;
                camera.fy += focal * s;
                reference_loss(scene, &scene.positions, &camera)
            };
            (mean(gradients.iter().map(along)), (at(step) - at(-step)) / (2.0 * step))
        })
        .collect();
    error(scene.name, "camera", &pairs)
}

fn textured(texture: Image, nearest: bool) -> Look {
    let texture = Texture { image: texture, alpha: Vec::new(), repeat: [false; 2], nearest };
    Look { texture: Some(texture), double_sided: true, ..Look::default() }
}

fn waves(size: usize) -> Image {
    let mut image = Image::filled(size, size, [0; 3]);
    for (k, p) in image.rgb.iter_mut().enumerate() {
        let (u, v) = ((k % size) as f64 / size as f64 * 6.0, (k / size) as f64 / size as f64 * 6.0);
        *p = [140.0 + 60.0 * (2.0 * u).sin(), 120.0 + 50.0 * (v + u).cos(), 110.0 + 60.0 * (2.0 * v).sin()]
            .map(|c| c as u8);
    }
    image
}

/// A grid bent by `shape`: (u, v) → point, wrapped where `closed`.
fn sheet(nu: usize, nv: usize, closed: [bool; 2], shape: impl Fn(f64, f64) -> DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for j in 0..=nv {
        for i in 0..=nu {
            let (u, v) = (i as f64 / nu as f64, j as f64 / nv as f64);
            let wrapped = |x: f64, closed: bool| if closed && x == 1.0 { 0.0 } else { x };
            mesh.positions.push(shape(wrapped(u, closed[0]), wrapped(v, closed[1])));
            mesh.uvs.push(DVec2::new(u, v));
        }
    }
    let at = |i: usize, j: usize| (j * (nu + 1) + i) as u32;
    for j in 0..nv {
        for i in 0..nu {
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

fn joined(meshes: Vec<Mesh>) -> Mesh {
    let mut all = Mesh::default();
    for (look, m) in meshes.into_iter().enumerate() {
        let (v, t) = (all.positions.len(), all.triangles.len());
        all.parts.push(Part {
            vertices: v..v + m.positions.len(),
            triangles: t..t + m.triangles.len(),
            look,
            ..Part::default()
        });
        all.triangles.extend(m.triangles.iter().map(|t| t.map(|k| k + v as u32)));
        all.positions.extend(m.positions);
        all.uvs.extend(m.uvs);
        all.colors.extend(m.colors);
    }
    let mut order: Vec<usize> = (0..all.positions.len()).collect();
    let key = |k: usize| all.positions[k].to_array().map(|c| (c * 1e9).round() as i64);
    order.sort_by_key(|&k| key(k));
    all.welded = vec![0; order.len()];
    for pair in order.windows(2) {
        all.welded[pair[1]] = all.welded[pair[0]] + u32::from(key(pair[0]) != key(pair[1]));
    }
    all.welded_count = order.last().map_or(0, |&k| all.welded[k] as usize + 1);
    all
}

/// Smooth vertex colours: unlike textures they look the same at every sampling rate, so that coarse and fine pictures agree.
fn painted(mut mesh: Mesh) -> Mesh {
    let color =
        |p: &DVec3| [0.5 + 0.3 * (3.0 * p.x).sin(), 0.4 + 0.3 * (2.0 * p.y).cos(), 0.5 + 0.3 * (2.5 * p.z + 1.0).sin()];
    mesh.colors = mesh.positions.iter().map(|p| color(p).map(|c| c as f32)).collect();
    mesh
}

fn with_normals(mut mesh: Mesh) -> Mesh {
    let mut sums = vec![DVec3::ZERO; mesh.welded_count];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|k| mesh.positions[k as usize]);
        t.iter().for_each(|&k| sums[mesh.welded[k as usize] as usize] += (b - a).cross(c - a));
    }
    mesh.normals = mesh.welded.iter().map(|&w| sums[w as usize].normalize_or(DVec3::Y)).collect();
    mesh
}

fn ball(center: DVec3, radius: f64) -> Mesh {
    sheet(40, 24, [true, false], move |u, v| {
        let (a, b) = (std::f64::consts::TAU * u, std::f64::consts::PI * (0.001 + 0.998 * v));
        center
            + radius
                * DVec3::new(b.sin() * a.cos(), -b.cos(), b.sin() * a.sin())
                * (1.0 + 0.1 * (3.0 * a).sin() * b.sin())
    })
}

fn ring() -> Mesh {
    sheet(64, 32, [true, true], |u, v| {
        let (a, b) = (std::f64::consts::TAU * u, std::f64::consts::TAU * v);
        let r = 0.75 + 0.34 * b.cos();
        DVec3::new(r * a.cos(), 0.34 * b.sin() + 0.1 * (2.0 * a).cos(), -r * a.sin())
    })
}

fn plane() -> Mesh {
    sheet(6, 6, [false; 2], |u, v| {
        let (x, y) = (6.0 * u - 3.0, 3.0 - 6.0 * v);
        DVec3::new(x, y, 0.2 * x.sin() + 0.15 * (y + x).cos())
    })
}

fn scene(name: &'static str, meshes: Vec<Mesh>, smooth: bool, looks: Vec<Look>, elevation: f64) -> Scene {
    let mesh = joined(meshes);
    let mesh = if smooth { with_normals(mesh) } else { mesh };
    Scene {
        name,
        surface: Surface::new(&mesh, &looks).expect("the test made it so"),
        positions: mesh.positions,
        camera: Camera::orbit(DVec3::ZERO, 4.0, 0.3, elevation, 0.65, SIZE, SIZE),
        light: Light::ambient_and_key(0.4, 0.45, DVec3::new(0.3, 0.6, 0.8)),
    }
}

fn scenes() -> Vec<Scene> {
    let stripes = {
        let mut image = Image::filled(12, 12, [225, 215, 190]);
        image
            .rgb
            .iter_mut()
            .enumerate()
            .filter(|(k, _)| (k % 12 / 2 + k / 12 / 3) % 2 == 0)
            .for_each(|(_, p)| *p = [60, 70, 90]);
        image
    };
    let plain = |c: [f32; 4]| Look { base_color: c, double_sided: true, ..Look::default() };
    let two = || vec![ball(DVec3::new(-0.35, 0.0, 0.5), 0.55), ball(DVec3::new(0.35, 0.1, -0.4), 0.7)];
    vec![
        scene("interior", vec![plane()], true, vec![textured(waves(16), false)], 0.2),
        scene("silhouette", vec![painted(ball(DVec3::ZERO, 0.9))], true, vec![plain([1.0; 4])], 0.2),
        scene("occlusion", two(), true, vec![plain([0.8, 0.3, 0.2, 1.0]), plain([0.2, 0.4, 0.8, 1.0])], 0.2),
        scene("self-occlusion", vec![painted(ring())], true, vec![plain([1.0; 4])], 0.2),
        // The ring's hole is a slit, in places thinner than a pixel.
        scene("slit", vec![painted(ring())], true, vec![plain([1.0; 4])], 0.45),
        scene("texture edge", vec![plane()], true, vec![textured(stripes, false)], 0.2),
        scene(
            "flat facets",
            vec![sheet(10, 8, [true, false], |u, v| {
                let (a, b) = (std::f64::consts::TAU * u, std::f64::consts::PI * (0.001 + 0.998 * v));
                0.9 * DVec3::new(b.sin() * a.cos(), -b.cos(), b.sin() * a.sin())
            })],
            false,
            vec![plain([0.7, 0.6, 0.4, 1.0])],
            0.3,
        ),
    ]
}

#[test]
fn every_scene_class_has_the_right_gradient_to_vertices_and_camera() {
    let mut failures = Vec::new();
    for scene in scenes() {
        let gradients = gradients(&scene, false);
        let mut rng = SplitMix64(11);
        let vertex = vertex_error(&scene, &gradients, &mut rng);
        let camera = camera_error(&scene, &gradients, &mut rng);
        if vertex > 3e-2 || camera > 3e-2 {
            failures.push(scene.name);
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

#[test]
fn every_scene_class_has_an_exact_gradient_to_light() {
    for mut scene in scenes() {
        let mut rng = SplitMix64(12);
        let n = SIZE as usize;
        let w: Vec<[f32; 3]> = (0..n * n)
            .map(|p| {
                let w = weights(DVec2::new((p % n) as f64 + 0.5, (p / n) as f64 + 0.5) / f64::from(SIZE));
                [w[0] as f32, w[1] as f32, w[2] as f32]
            })
            .collect();
        let mut rendered = Rendered::default();
        render_into(&scene.camera, &scene.surface, &scene.positions, &scene.light, BACKGROUND, &mut rendered);
        let d = Cotangents { rgb: &w, ..Cotangents::default() };
        let g = render_vjp(&scene.camera, &scene.surface, &scene.positions, &scene.light, &rendered, &d, false);
        let direction = std::array::from_fn(|_| [0.1 * rng.normal(), 0.1 * rng.normal(), 0.1 * rng.normal()]);
        let base = scene.light;
        let at = |s: f64, scene: &mut Scene| {
            scene.light = base;
            (0..9).for_each(|k| (0..3).for_each(|c| scene.light.sh[k][c] += s * (direction as [[f64; 3]; 9])[k][c]));
            let mut out = Rendered::default();
            render_into(&scene.camera, &scene.surface, &scene.positions, &scene.light, BACKGROUND, &mut out);
            out.rgb
                .iter()
                .zip(&w)
                .map(|(p, w)| (0..3).map(|c| f64::from(p[c]) * f64::from(w[c])).sum::<f64>())
                .sum::<f64>()
        };
        let analytic: f64 =
            (0..9).flat_map(|k| (0..3).map(move |c| (k, c))).map(|(k, c)| g.light.sh[k][c] * direction[k][c]).sum();
        // Fourth-order differences, so that a step large against single precision is still small against the curve.
        let h = 0.04;
        let mut difference = |h: f64| (at(h, &mut scene) - at(-h, &mut scene)) / (2.0 * h);
        let numeric = (4.0 * difference(h) - difference(2.0 * h)) / 3.0;
        let worst = error(scene.name, "light", &[(analytic, numeric)]);
        assert!(worst < 1e-5, "light of {}", scene.name);
    }
}

#[test]
fn depth_has_an_exact_gradient_inside() {
    let scene = &scenes()[0];
    let gradients = gradients(scene, true);
    let loss = |positions: &[DVec3]| {
        let size = SIZE * 4;
        let raster = rasterize_surface(&scene.camera.resized(size, size), &scene.surface, positions, false);
        let n = size as usize;
        let sum: f64 = (0..n * n)
            .map(|pixel| {
                assert!(raster.triangle[pixel] != NONE, "the plane fills the picture");
                let p = DVec2::new((pixel % n) as f64 + 0.5, (pixel / n) as f64 + 0.5) / f64::from(size);
                weights(p)[3] * raster.depth(pixel).expect("the test made it so")
            })
            .sum();
        sum / (n * n) as f64
    };
    let mut rng = SplitMix64(13);
    let pairs: Vec<(f64, f64)> = (0..4)
        .map(|_| {
            let (a, k) = (DVec3::new(rng.normal(), rng.normal(), rng.normal()), 1.5 * rng.normal());
            let field = move |p: DVec3| a * (k * p.x + p.y).sin();
            let along =
                |g: &Gradients| scene.positions.iter().zip(&g.positions).map(|(&p, d)| field(p).dot(*d)).sum::<f64>();
            let at = |s: f64| loss(&moved(&scene.positions, &field, s));
            (mean(gradients.iter().map(along)), (at(0.01) - at(-0.01)) / 0.02)
        })
        .collect();
    assert!(error("interior", "depth to vertex", &pairs) < 1e-4);
}

#[test]
fn textured_scenes_have_an_exact_gradient_to_texels() {
    for index in [0, 5] {
        let mut scene = scenes().swap_remove(index);
        let n = (SIZE * SIZE) as usize;
        let share = vec![[1.0 / n as f32, -0.5 / n as f32, 0.7 / n as f32]; n];
        let mut rendered = Rendered::default();
        render_into(&scene.camera, &scene.surface, &scene.positions, &scene.light, BACKGROUND, &mut rendered);
        let d = Cotangents { rgb: &share, ..Cotangents::default() };
        let g = render_vjp(&scene.camera, &scene.surface, &scene.positions, &scene.light, &rendered, &d, true);
        let linear = animimic_scene::image::linear_from_srgb;
        // All texels one byte up or down; the analytic step is the exact change of their linear values.
        let at = |step: i16, scene: &mut Scene| {
            let texture = Arc::make_mut(&mut scene.surface.looks)[0].texture.as_mut().expect("the scene is textured");
            let level = &mut texture.levels[0];
            let mut change = 0.0f64;
            for (t, d) in level.texels.iter_mut().zip(&g.texels[0]) {
                for c in 0..3 {
                    let moved = (i16::from(t[c]) + step) as u8;
                    let bytes = |b: u8| linear(f32::from(b) / 255.0);
                    change += f64::from(d[c]) * f64::from(bytes(moved) - bytes(t[c]));
                    t[c] = moved;
                }
            }
            let mut out = Rendered::default();
            render_into(&scene.camera, &scene.surface, &scene.positions, &scene.light, BACKGROUND, &mut out);
            let loss: f64 =
                out.rgb.iter().zip(&share).map(|(p, w)| (0..3).map(|c| f64::from(p[c] * w[c])).sum::<f64>()).sum();
            (loss, change)
        };
        let (up, rise) = at(1, &mut scene);
        let (_, fall_back) = at(-1, &mut scene);
        let (down, fall) = at(-1, &mut scene);
        let worst = error(scene.name, "texels", &[(rise - fall, up - down)]);
        assert!(fall_back < 0.0 && worst < 1e-5, "texels of {}", scene.name);
    }
}
