//! What the stages of a take found, as records that a resumed run takes again.

use super::LossCurve;
use super::motion::Solved;
use crate::run::{Kept, Record};
use animimic_fit::stage1::Certainty;
use animimic_scene::io::npz::Values;
use animimic_scene::{Camera, CameraFile, Cues, DepthKind, DepthMap, Image, Mask, Motion, Pose, Tracks, Transform};
use animimic_video::cues::Background;
use animimic_video::cues::providers::Found;
use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Value, json};

/// What is seen in a video: its cues, and the camera that filmed it.
pub(crate) struct Seen {
    pub found: Found,
    pub camera: CameraFile,
}

impl Kept for Seen {
    fn to_record(&self) -> Record {
        let Self { found: Found { cues, background, mask_confidence }, camera } = self;
        let views: Vec<Value> = camera.views.iter().map(|(name, c)| json!([name, camera_json(c)])).collect();
        let json = json!({
            "camera": camera_json(&camera.main), "fps": camera.fps, "views": views,
            "target": camera.target.map(|t| t.to_array()), "inverse_depth": cues.depth_kind == DepthKind::Inverse,
            "background": background.coefficients, "drift": background.drift, "residual": background.residual,
        });
        let record = Record { json, arrays: Vec::new() };
        let (frames, points) = (cues.tracks.pixels.len(), cues.tracks.query_frame.len());
        let size = cues.masks.first().map_or((0, 0), |m| (m.height, m.width));
        let masks = cues.masks.iter().flat_map(|m| m.coverage.iter().copied()).collect();
        let depth = cues.depth.first().map_or((0, 0), |m| (m.height, m.width));
        let plate = background.plates.first().map_or((0, 0), |p| (p.height, p.width));
        let plates = background.plates.iter().flat_map(|p| p.rgb.as_flattened().iter().copied()).collect();
        record
            .with("masks", &[cues.masks.len(), size.0, size.1], Values::U8(masks))
            .with("mask_confidence", &[mask_confidence.len()], Values::F32(mask_confidence.clone()))
            .with(
                "tracks",
                &[frames, points, 2],
                Values::F32(cues.tracks.pixels.iter().flatten().flatten().copied().collect()),
            )
            .with(
                "track_confidence",
                &[frames, points],
                Values::F32(cues.tracks.confidence.iter().flatten().copied().collect()),
            )
            .with("track_query", &[points], Values::U32(cues.tracks.query_frame.clone()))
            .with(
                "depth",
                &[cues.depth.len(), depth.0, depth.1],
                Values::F32(cues.depth.iter().flat_map(|m| m.values.iter().copied()).collect()),
            )
            .with("plates", &[background.plates.len(), plate.0, plate.1, 3], Values::U8(plates))
    }

    fn from_record(record: Record) -> Option<Self> {
        let json = &record.json;
        let bytes = |name: &str| record.get(name)?.to_u8();
        let floats = |name: &str| Some(record.get(name)?.to_f32());
        let shape = |name: &str| Some(record.get(name)?.shape.clone());
        let &[_, height, width] = shape("masks")?.as_slice() else { return None };
        let mask = |coverage: &[u8]| Mask { width, height, coverage: coverage.to_vec() };
        let masks = bytes("masks")?.chunks((width * height).max(1)).map(mask).collect();
        let &[_, height, width] = shape("depth")?.as_slice() else { return None };
        let map = |values: &[f32]| DepthMap { width, height, values: values.to_vec() };
        let depth = floats("depth")?.chunks((width * height).max(1)).map(map).collect();
        let &[_, height, width, 3] = shape("plates")?.as_slice() else { return None };
        let plate = |rgb: &[u8]| Image { width, height, rgb: rgb.as_chunks::<3>().0.to_vec() };
        let plates = bytes("plates")?.chunks((3 * width * height).max(1)).map(plate).collect();
        let &[frames, points, 2] = shape("tracks")?.as_slice() else { return None };
        let (pixels, confidence) = (floats("tracks")?, floats("track_confidence")?);
        let Values::U32(query_frame) = record.get("track_query")?.values.clone() else { return None };
        let row = |t: usize| t * points..(t + 1) * points;
        let tracks = Tracks {
            pixels: (0..frames)
                .map(|t| pixels.as_chunks::<2>().0.get(row(t)).map(<[_]>::to_vec))
                .collect::<Option<_>>()?,
            confidence: (0..frames).map(|t| confidence.get(row(t)).map(<[_]>::to_vec)).collect::<Option<_>>()?,
            query_frame,
        };
        let background = Background {
            coefficients: serde_json::from_value(json["background"].clone()).ok()?,
            drift: serde_json::from_value(json["drift"].clone()).ok()?,
            residual: serde_json::from_value(json["residual"].clone()).ok()?,
            plates,
        };
        let depth_kind = if json["inverse_depth"].as_bool()? { DepthKind::Inverse } else { DepthKind::Metric };
        let cues = Cues { masks, tracks, depth, depth_kind };
        let target: Option<[f64; 3]> = serde_json::from_value(json["target"].clone()).ok()?;
        let view = |v: &Value| Some((v.get(0)?.as_str()?.to_owned(), camera(v.get(1)?)?));
        let camera = CameraFile {
            main: camera(&json["camera"])?,
            fps: json["fps"].as_f64()?,
            views: json["views"].as_array()?.iter().map(view).collect::<Option<_>>()?,
            target: target.map(DVec3::from_array),
        };
        Some(Self { found: Found { cues, background, mask_confidence: floats("mask_confidence")? }, camera })
    }
}

/// Size, focal lengths, centre, then the columns of the map from world to view.
fn camera_json(c: &Camera) -> Value {
    json!([c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.view_from_world.to_cols_array()])
}

fn camera(json: &Value) -> Option<Camera> {
    let (width, height, fx, fy, cx, cy, columns): (u32, u32, f64, f64, f64, f64, [f64; 12]) =
        serde_json::from_value(json.clone()).ok()?;
    Some(Camera { width, height, fx, fy, cx, cy, view_from_world: DAffine3::from_cols_array(&columns) })
}

/// Numbers of a joint in a pose: translation, rotation as x y z w, scale.
const JOINT: usize = 10;

/// The timings are those of the run that did the work, and not kept.
impl Kept for Solved {
    fn to_record(&self) -> Record {
        let Self { motion, losses, uncertain, certainty, seconds: _ } = self;
        let losses: Vec<Value> = losses.iter().map(|l| json!([l.stage, l.values])).collect();
        let certainty: Vec<Value> = certainty.iter().map(|c| json!([c.joint, c.deviation])).collect();
        let joints = motion.poses.first().map_or(0, |p| p.locals.len());
        let joint =
            |t: &Transform| t.translation.to_array().into_iter().chain(t.rotation.to_array()).chain(t.scale.to_array());
        let values = motion.poses.iter().flat_map(|p| p.locals.iter().flat_map(joint)).collect();
        let json = json!({
            "name": motion.name, "fps": motion.fps, "losses": losses, "uncertain": uncertain, "certainty": certainty,
        });
        Record { json, arrays: Vec::new() }.with_f64("poses", &[motion.poses.len(), joints, JOINT], values)
    }

    fn from_record(record: Record) -> Option<Self> {
        let json = &record.json;
        let &[_, joints, JOINT] = record.get("poses")?.shape.as_slice() else { return None };
        let joint = |v: &[f64; JOINT]| Transform {
            translation: DVec3::from_slice(&v[..3]),
            rotation: DQuat::from_slice(&v[3..7]),
            scale: DVec3::from_slice(&v[7..]),
        };
        let values = record.f64s("poses")?;
        let pose = |rows: &[[f64; JOINT]]| Pose { locals: rows.iter().map(joint).collect() };
        let poses = values.as_chunks::<JOINT>().0.chunks(joints.max(1)).map(pose).collect();
        let loss =
            |v: &Value| Some(LossCurve::new(v.get(0)?.as_str()?, serde_json::from_value(v.get(1)?.clone()).ok()?));
        let part = |v: &Value| {
            Some(Certainty {
                joint: serde_json::from_value(v.get(0)?.clone()).ok()?,
                deviation: serde_json::from_value(v.get(1)?.clone()).ok()?,
            })
        };
        Some(Self {
            motion: Motion { name: json["name"].as_str()?.into(), fps: json["fps"].as_f64()?, poses },
            losses: json["losses"].as_array()?.iter().map(loss).collect::<Option<_>>()?,
            uncertain: serde_json::from_value(json["uncertain"].clone()).ok()?,
            certainty: json["certainty"].as_array()?.iter().map(part).collect::<Option<_>>()?,
            seconds: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Key;

    /// A record through its file.
    fn again<T: Kept>(of: &T) -> T {
        let folder = tempfile::tempdir().expect("made");
        let (path, key) = (folder.path().join("a.npz"), Key::new("test"));
        of.to_record().write(&path, &key).expect("written");
        T::from_record(Record::read(&path, &key).expect("read")).expect("of this kind")
    }

    #[test]
    fn what_is_seen_comes_back_to_the_last_bit() {
        let third = 1.0 / 3.0;
        let turned = Camera::orbit(DVec3::splat(third), 2.0, third, 0.1, 0.7, 4, 3);
        let camera = CameraFile {
            main: turned,
            fps: 29.97,
            views: vec![("a b".into(), turned)],
            target: Some(DVec3::X * third),
        };
        let masks =
            (0..2).map(|t| Mask { width: 4, height: 3, coverage: (0..12).map(|i| i * 20 + t).collect() }).collect();
        let tracks = Tracks {
            pixels: vec![vec![[0.1, f32::NAN]; 3], vec![[7.5, third as f32]; 3]],
            confidence: vec![vec![0.5, 0.0, 1.0]; 2],
            query_frame: vec![0, 1, 0],
        };
        let depth = vec![DepthMap { width: 2, height: 1, values: vec![f32::NAN, third as f32] }; 2];
        let plates = vec![Image { width: 4, height: 3, rgb: (0..12).map(|i| [i, 2 * i, 255 - i]).collect() }; 2];
        for whole in [true, false] {
            let background = Background {
                coefficients: [[third; 6]; 3],
                drift: vec![[third, -0.0, 1e-300]; 2],
                residual: vec![third; 2],
                plates: if whole { plates.clone() } else { Vec::new() },
            };
            let cues = Cues {
                masks: if whole { Clone::clone(&masks) } else { Vec::new() },
                tracks: if whole { tracks.clone() } else { Tracks::default() },
                depth: if whole { depth.clone() } else { Vec::new() },
                depth_kind: if whole { DepthKind::Inverse } else { DepthKind::Metric },
            };
            let found = Found { cues, background, mask_confidence: vec![third as f32; 2] };
            let seen = Seen { found, camera: camera.clone() };
            let back = again(&seen);
            assert_eq!(back.camera, seen.camera);
            assert_eq!(format!("{:?}", back.found), format!("{:?}", seen.found));
        }
    }

    #[test]
    fn what_was_solved_comes_back_to_the_last_bit() {
        let third = 1.0 / 3.0;
        let local = Transform {
            translation: DVec3::new(third, -0.0, 1e300),
            rotation: DQuat::from_rotation_x(third),
            scale: DVec3::splat(0.1),
        };
        let motion = Motion { name: "a \"walk\"".into(), fps: 24.0, poses: vec![Pose { locals: vec![local; 3] }; 4] };
        let solved = Solved {
            motion,
            losses: vec![LossCurve::new("joint solve", vec![third, 1e-20])],
            uncertain: vec!["a doubt".into()],
            certainty: vec![Certainty { joint: 2, deviation: vec![third; 4] }],
            seconds: vec![("tracking", 1.0)],
        };
        let back = again(&solved);
        let bits = |s: &Solved| format!("{:?} {:?} {:?} {:?}", s.motion, s.losses, s.uncertain, s.certainty);
        assert_eq!(bits(&back), bits(&solved));
    }
}
