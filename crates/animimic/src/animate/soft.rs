//! Stage 2: soft tissue for the takes of a job.

use super::motion::Scene;
use super::{Job, Model, Take};
use crate::Error;
use crate::event::Progress;
use crate::soften::filmed::{Ask, Filmed, refine as soften};
use crate::soften::joints;
use animimic_fit::soft::Settings;
use serde_json::Value;

/// Gives each take the soft surface that its frames speak for; returns what was learnt of the material.
pub fn refine(job: &Job, model: Model, takes: &mut [Take], progress: &mut Progress) -> Result<Value, Error> {
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
    let made = outcome.trajectories.into_iter().zip(outcome.shown).zip(outcome.reports);
    for (take, ((trajectory, shown), report)) in takes.iter_mut().zip(made) {
        take.trajectory = trajectory;
        take.shown = shown;
        take.softness = report;
    }
    Ok(outcome.material)
}
