//! Flow and tracks against renders of known motion.
mod support;

use animimic_scene::{Camera, io};
use animimic_video::cues::{MaskOptions, TrackOptions, masks, tracks};
use animimic_video::flow::{FlowOptions, Gray, dis, neighbours};
use animimic_video::{ReadOptions, read};
use glam::DVec3;
use std::path::Path;
use support::*;

/// The true motion of a case.
struct Truth {
    /// \[frame\]\[vertex\].
    vertices: Vec<Vec<DVec3>>,
    faces: Vec<[usize; 3]>,
    camera: Camera,
}

impl Truth {
    fn read(case: &Path) -> Self {
        let archive = io::npz::read(case.join("gt.npz")).expect("reads");
        let unique = archive.need("verts_unique").expect("there");
        let values = unique.to_f64();
        let map: Vec<usize> =
            archive.need("vert_to_unique").expect("there").to_f64().iter().map(|&v| v as usize).collect();
        let (frames, count) = (unique.shape[0], unique.shape[1]);
        let vertices = (0..frames)
            .map(|t| (0..count).map(|i| DVec3::from_slice(&values[3 * (t * count + i)..])).collect())
            .collect();
        let faces = archive.need("faces").expect("there").to_f64();
        let faces = faces.chunks(3).map(|f| std::array::from_fn(|k| map[f[k] as usize])).collect();
        let camera = io::camera_json::read(case.join("camera.json")).expect("reads").main;
        Self { vertices, faces, camera }
    }

    /// Nearest surface point on the ray through a pixel: face and barycentrics.
    fn hit(&self, t: usize, p: [f32; 2]) -> Option<(usize, [f64; 3], f64)> {
        let c = &self.camera;
        let view = DVec3::new((f64::from(p[0]) - c.cx) / c.fx, (f64::from(p[1]) - c.cy) / c.fy, 1.0);
        let direction = c.view_from_world.matrix3.transpose() * view;
        let eye = c.eye();
        let mut best: Option<(usize, [f64; 3], f64)> = None;
        for (f, face) in self.faces.iter().enumerate() {
            let [a, b, d] = face.map(|v| self.vertices[t][v]);
            let (e1, e2) = (b - a, d - a);
            let h = direction.cross(e2);
            let det = e1.dot(h);
            if det.abs() < 1e-18 {
                continue;
            }
            let s = eye - a;
            let u = s.dot(h) / det;
            if !(0.0..=1.0).contains(&u) {
                continue;
            }
            let q = s.cross(e1);
            let v = direction.dot(q) / det;
            let z = e2.dot(q) / det;
            if v >= 0.0 && u + v <= 1.0 && z > 0.0 && best.is_none_or(|b| z < b.2) {
                best = Some((f, [1.0 - u - v, u, v], z));
            }
        }
        best
    }

    /// Where a surface point is drawn in frame `t`, and its depth.
    fn place(&self, t: usize, (f, b, _): (usize, [f64; 3], f64)) -> ([f32; 2], f64) {
        let x: DVec3 = (0..3).map(|k| self.vertices[t][self.faces[f][k]] * b[k]).sum();
        let p = self.camera.project(x);
        ([p.x as f32, p.y as f32], self.camera.to_view(x).z)
    }

    fn visible(&self, t: usize, p: [f32; 2], z: f64) -> bool {
        self.hit(t, p).is_some_and(|(_, _, nearest)| nearest > 0.99 * z)
    }
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
}

#[test]
fn flow_follows_the_true_motion() {
    let mut all = (0.0, 0usize, 0usize);
    let mut worst = 1.0f64;
    for case in cases() {
        let video = read(&case.join("video.mp4"), &ReadOptions::default()).expect("reads");
        let truth = Truth::read(&case);
        let (a, b) = (Gray::from_image(&video.frames[0]), Gray::from_image(&video.frames[1]));
        let start = cpu_ms();
        (0..5).for_each(|_| drop(dis(&a, &b, &FlowOptions::default())));
        let ms = (cpu_ms() - start) / 5.0;
        let (mut sum, mut within, mut count) = (0.0f64, 0usize, 0usize);
        for t in (0..video.frames.len() - 1).step_by(8) {
            let flow = &neighbours(&video.frames[t..t + 2], &FlowOptions::default())[0].0;
            for y in (4..512).step_by(8) {
                for x in (4..512).step_by(8) {
                    let p = [x as f32 + 0.5, y as f32 + 0.5];
                    let Some(hit) = truth.hit(t, p) else { continue };
                    let (q, z) = truth.place(t + 1, hit);
                    if !truth.visible(t + 1, q, z) {
                        continue;
                    }
                    let v = flow.at(p);
                    let error = f64::from((p[0] + v[0] - q[0]).hypot(p[1] + v[1] - q[1]));
                    sum += error;
                    within += usize::from(error < 2.0);
                    count += 1;
                }
            }
        }
        println!(
            "{:18} EPE {:.3} px, {:.1} % within 2 px, {ms:.0} CPU-ms a pair",
            name(&case),
            sum / count as f64,
            100.0 * within as f64 / count as f64
        );
        worst = worst.min(within as f64 / count.max(1) as f64);
        all = (all.0 + sum, all.1 + within, all.2 + count);
    }
    if all.2 > 0 {
        let (epe, share) = (all.0 / all.2 as f64, all.1 as f64 / all.2 as f64);
        println!("all: EPE {epe:.3} px, {:.1} % within 2 px", 100.0 * share);
        assert!(share > 0.88 && worst > 0.74, "{share}, {worst}");
    }
}

#[test]
fn tracks_follow_the_surface() {
    let mut medians = Vec::new();
    for case in cases() {
        let video = read(&case.join("video.mp4"), &ReadOptions::default()).expect("reads");
        let truth = Truth::read(&case);
        let cue = masks(&video, &MaskOptions::default());
        let found = tracks(&video, &cue.masks, &TrackOptions::default());
        let (mut errors, mut kept, mut seen, mut false_kept, mut weighted, mut weight) =
            (Vec::new(), 0, 0, 0, 0.0, 0.0);
        for k in (0..found.query_frame.len()).filter(|&k| found.query_frame[k] == 0) {
            let Some(hit) = truth.hit(0, found.pixels[0][k]) else { continue };
            for t in (4..video.frames.len()).step_by(4) {
                let (q, z) = truth.place(t, hit);
                let visible = truth.visible(t, q, z);
                let c = found.confidence[t][k];
                seen += usize::from(visible);
                if c > 0.0 {
                    let p = found.pixels[t][k];
                    let error = (p[0] - q[0]).hypot(p[1] - q[1]);
                    kept += usize::from(visible);
                    false_kept += usize::from(!visible);
                    weighted += c * f32::from(u8::from(error < 2.0));
                    weight += c;
                    errors.push(error);
                }
            }
        }
        let within = errors.iter().filter(|&&e| e < 2.0).count() as f32 / errors.len().max(1) as f32;
        let m = median(&mut errors);
        println!(
            "{:18} {:4} tracks, median {m:.2} px, {:.1} % within 2 px ({:.1} % by confidence), kept {:.1} % of visible, {:.1} % of kept are hidden",
            name(&case),
            found.query_frame.len(),
            100.0 * within,
            100.0 * weighted / weight,
            100.0 * kept as f32 / seen.max(1) as f32,
            100.0 * false_kept as f32 / errors.len().max(1) as f32
        );
        medians.push(m);
    }
    if !medians.is_empty() {
        let m = median(&mut medians);
        println!("median of medians {m:.2} px");
        assert!(m < 1.5);
    }
}
