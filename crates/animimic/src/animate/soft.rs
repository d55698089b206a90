//! Stage 2: soft tissue for the takes of a job.

use super::motion::Scene;
use super::{Job, Model, Take};
use crate::Error;
use crate::event::Progress;
use crate::run::{Kept, Key, Record, Run};
use crate::soften::filmed::{Ask, Filmed, Outcome, refine as soften};
use crate::soften::joints;
use animimic_fit::soft::Settings;
use animimic_scene::Trajectory;
use glam::DVec3;
use serde_json::{Value, json};

/// Soft surfaces of all takes.
struct Flesh {
    /// Where the frames speak for it: the surface \[take\].
    trajectories: Vec<Option<Trajectory>>,
    /// The surface to be looked at \[take\]\[frame\]\[vertex\].
    shown: Vec<Vec<Vec<DVec3>>>,
    /// What each take's frames said \[take\].
    reports: Vec<Value>,
    /// What was learnt of the material.
    material: Value,
}

/// Gives each take the soft surface that its frames speak for, found now or before; returns what was learnt of the material.
pub fn refine(
    job: &Job,
    run: &Run,
    key: &Key,
    model: Model,
    takes: &mut [Take],
    progress: &mut Progress,
) -> Result<Value, Error> {
    let flesh = run.kept("soft", key, || find(job, model, takes, progress))?;
    let made = flesh.trajectories.into_iter().zip(flesh.shown).zip(flesh.reports);
    for (take, ((trajectory, shown), report)) in takes.iter_mut().zip(made) {
        take.trajectory = trajectory;
        take.shown = shown;
        take.softness = report;
    }
    Ok(flesh.material)
}

fn find(job: &Job, model: Model, takes: &[Take], progress: &mut Progress) -> Result<Flesh, Error> {
    let flesh = &job.flesh;
    let settings = Settings {
        tets: flesh.tets,
        size_m: flesh.size_m,
        loose: joints(model.asset, &flesh.loose)?,
        ..Settings::default()
    };
    let ask = Ask { settings, young: flesh.young };
    let filmed: Vec<Filmed> = takes
        .iter()
        .map(|take| Filmed {
            scene: Scene {
                asset: model.solved,
                made_rig: model.made_rig,
                camera: &take.camera.main,
                video: &take.video,
                cues: &take.cues,
                background: &take.background,
            },
            motion: &take.motion,
        })
        .collect();
    let outcome = soften(model.asset, model.solved, &filmed, &ask, progress)?;
    let Outcome { clips: _, shown, trajectories, reports, material } = outcome;
    Ok(Flesh { trajectories, shown, reports, material })
}

impl Kept for Flesh {
    fn to_record(&self) -> Record {
        let rates: Vec<Option<f64>> = self.trajectories.iter().map(|t| t.as_ref().map(|t| t.fps)).collect();
        let json = json!({"rates": rates, "reports": self.reports, "material": self.material});
        let mut record = Record { json, arrays: Vec::new() };
        for (k, (trajectory, shown)) in self.trajectories.iter().zip(&self.shown).enumerate() {
            record = with_surface(record, &format!("shown_{k}"), shown);
            if let Some(t) = trajectory {
                record = with_surface(record, &format!("surface_{k}"), &t.frames);
            }
        }
        record
    }

    fn from_record(record: Record) -> Option<Self> {
        let json = &record.json;
        let rates: Vec<Option<f64>> = serde_json::from_value(json["rates"].clone()).ok()?;
        let trajectory = |(k, fps): (usize, &Option<f64>)| match fps {
            None => Some(None),
            Some(fps) => surface(&record, &format!("surface_{k}")).map(|frames| Some(Trajectory { fps: *fps, frames })),
        };
        Some(Self {
            trajectories: rates.iter().enumerate().map(trajectory).collect::<Option<_>>()?,
            shown: (0..rates.len()).map(|k| surface(&record, &format!("shown_{k}"))).collect::<Option<_>>()?,
            reports: json["reports"].as_array()?.clone(),
            material: json["material"].clone(),
        })
    }
}

/// Points \[frame\]\[vertex\] as an array.
fn with_surface(record: Record, name: &str, frames: &[Vec<DVec3>]) -> Record {
    let vertices = frames.first().map_or(0, Vec::len);
    record.with_f64(name, &[frames.len(), vertices, 3], frames.iter().flatten().flat_map(|p| p.to_array()).collect())
}

fn surface(record: &Record, name: &str) -> Option<Vec<Vec<DVec3>>> {
    let &[frames, vertices, 3] = record.get(name)?.shape.as_slice() else { return None };
    let values = record.f64s(name)?;
    let points = values.as_chunks::<3>().0;
    let frame =
        |t: usize| points.get(t * vertices..(t + 1) * vertices).map(|f| f.iter().copied().map(DVec3::from).collect());
    (0..frames).map(frame).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soft_surfaces_come_back_to_the_last_bit() {
        let frames = vec![vec![DVec3::new(1.0 / 3.0, -0.0, 1e-300); 4]; 3];
        let flesh = Flesh {
            trajectories: vec![None, Some(Trajectory { fps: 29.97, frames: frames.clone() })],
            shown: vec![Vec::new(), frames],
            reports: vec![json!({"gain": 1.0 / 3.0}), Value::Null],
            material: json!([0.1, "a"]),
        };
        let folder = tempfile::tempdir().expect("made");
        let (path, key) = (folder.path().join("a.npz"), Key::new("test"));
        flesh.to_record().write(&path, &key).expect("written");
        let back = Flesh::from_record(Record::read(&path, &key).expect("read")).expect("of this kind");
        let words = |f: &Flesh| format!("{:?} {:?} {:?} {:?}", f.trajectories, f.shown, f.reports, f.material);
        assert_eq!(words(&back), words(&flesh));
    }
}
