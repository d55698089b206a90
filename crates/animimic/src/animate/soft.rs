//! Stage 2: soft tissue for the takes of a job.

use super::motion::Scene;
use super::{Job, Model, Take};
use crate::Error;
use crate::event::Progress;
use crate::run::{Kept, Key, Record, Run};
use crate::soften::filmed::{Ask, Filmed, refine as soften};
use crate::soften::settings;
use glam::DVec3;
use serde_json::{Value, json};

/// Soft surfaces of all takes.
#[derive(Debug)]
struct Flesh {
    takes: Vec<Soft>,
    /// Young's modulus of the flesh at the surface [Pa], per vertex; the takes share it.
    youngs: Vec<f32>,
    /// What was learnt of the material.
    material: Value,
}

/// The soft surface of a take.
#[derive(Debug)]
struct Soft {
    /// The surface \[frame\]\[vertex\], also where it is not kept: to be looked at.
    surface: Vec<Vec<DVec3>>,
    /// Whether the frames speak for it.
    kept: bool,
    /// What they said.
    report: Value,
}

/// Gives each take the soft surface that its frames speak for, found now or before; returns what was learnt of the material, and
/// Young's modulus of the flesh at the surface [Pa], per vertex.
pub fn refine(
    job: &Job,
    run: &Run,
    key: &Key,
    model: Model,
    takes: &mut [Take],
    progress: &mut Progress,
) -> Result<(Value, Vec<f32>), Error> {
    let flesh = run.kept("soft", key, || find(job, model, takes, progress))?;
    for (take, soft) in takes.iter_mut().zip(flesh.takes) {
        (take.soft, take.soft_kept, take.softness) = (soft.surface, soft.kept, soft.report);
    }
    Ok((flesh.material, flesh.youngs))
}

fn find(job: &Job, model: Model, takes: &[Take], progress: &mut Progress) -> Result<Flesh, Error> {
    let flesh = &job.flesh;
    let settings = settings(model.asset, flesh.tets, flesh.size_m, &flesh.loose)?;
    let ask = Ask { settings, young: flesh.young, solve: true };
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
    let (outcomes, material) = soften(model.asset, model.solved, &filmed, &ask, progress)?;
    let youngs = outcomes.first().map(|o| o.softened.youngs.clone()).unwrap_or_default();
    let takes = outcomes.into_iter().map(|o| Soft { surface: o.shown, kept: o.kept, report: o.report }).collect();
    Ok(Flesh { takes, youngs, material })
}

impl Kept for Flesh {
    fn to_record(&self) -> Record {
        let takes: Vec<Value> = self.takes.iter().map(|t| json!([t.kept, t.report])).collect();
        let record = Record { json: json!({"takes": takes, "material": self.material}), arrays: Vec::new() };
        let youngs: Vec<f64> = self.youngs.iter().map(|y| f64::from(*y)).collect();
        let record = record.with_f64("youngs", &[youngs.len()], youngs);
        let surfaces = self.takes.iter().enumerate();
        surfaces.fold(record, |record, (k, take)| with_surface(record, &format!("surface_{k}"), &take.surface))
    }

    fn from_record(record: Record) -> Option<Self> {
        let take = |(k, v): (usize, &Value)| {
            let surface = surface(&record, &format!("surface_{k}"))?;
            Some(Soft { surface, kept: v.get(0)?.as_bool()?, report: v.get(1)?.clone() })
        };
        let takes = record.json["takes"].as_array()?.iter().enumerate().map(take).collect::<Option<_>>()?;
        let youngs = record.f64s("youngs")?.iter().map(|y| *y as f32).collect();
        Some(Self { takes, youngs, material: record.json["material"].clone() })
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
            takes: vec![
                Soft { surface: Vec::new(), kept: false, report: json!({"gain": 1.0 / 3.0}) },
                Soft { surface: frames, kept: true, report: Value::Null },
            ],
            youngs: vec![1e5, 1.0 / 3.0],
            material: json!([0.1, "a"]),
        };
        let folder = tempfile::tempdir().expect("made");
        let (path, key) = (folder.path().join("a.npz"), Key::new("test"));
        flesh.to_record().write(&path, &key).expect("written");
        let back = Flesh::from_record(Record::read(&path, &key).expect("read")).expect("of this kind");
        assert_eq!(format!("{back:?}"), format!("{flesh:?}"));
    }
}
