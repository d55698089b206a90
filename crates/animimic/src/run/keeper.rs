//! Steps of the fit, kept in the state folder while it runs.

use super::{Kept, Key, Record, Run, safe};
use animimic_fit::FitError;
use animimic_fit::stage1::{Keeper, Saved};
use animimic_rig::FramePose;
use glam::{DMat3, DVec3};

/// Numbers of a joint in a frame: a rotation matrix and a displacement.
const JOINT: usize = 12;

impl Kept for Saved {
    fn to_record(&self) -> Record {
        let frames = self.stories.first().map_or(0, Vec::len);
        let joints = self.stories.first().and_then(|s| s.first()).map_or(0, |p| p.rotations.len());
        let joint = |(r, t): (&DMat3, &DVec3)| r.to_cols_array().into_iter().chain(t.to_array());
        let frame = |p: &FramePose| p.rotations.iter().zip(&p.displacements).flat_map(joint).collect::<Vec<f64>>();
        let values = self.stories.iter().flatten().flat_map(frame).collect();
        Record::default().with_f64("poses", &[self.stories.len(), frames, joints, JOINT], values).with_f64(
            "numbers",
            &[self.numbers.len()],
            self.numbers.clone(),
        )
    }

    fn from_record(record: Record) -> Option<Self> {
        let &[stories, frames, joints, JOINT] = record.get("poses")?.shape.as_slice() else { return None };
        let values = record.f64s("poses")?;
        let pose = |rows: &[[f64; JOINT]]| FramePose {
            rotations: rows.iter().map(|r| DMat3::from_cols_slice(&r[..9])).collect(),
            displacements: rows.iter().map(|r| DVec3::from_slice(&r[9..])).collect(),
        };
        let mut poses = values.as_chunks::<JOINT>().0.chunks(joints.max(1)).map(pose);
        let stories = (0..stories).map(|_| poses.by_ref().take(frames).collect()).collect();
        Some(Self { stories, numbers: record.f64s("numbers")? })
    }
}

/// Keeps the steps of one clip's fit under one key.
pub struct Checkpoints<'a> {
    run: &'a Run,
    clip: String,
    key: Key,
}

impl<'a> Checkpoints<'a> {
    /// Steps of the clip's fit.
    pub fn new(run: &'a Run, clip: &str, key: &Key) -> Self {
        Self { run, clip: safe(clip), key: key.clone() }
    }

    /// Forgets all steps: what they led to is kept.
    pub fn forget(self) {
        self.run.forget(&self.name(""));
    }

    fn name(&self, step: &str) -> String {
        format!("{}.motion.step.{}", self.clip, step.replace(' ', "_"))
    }
}

impl Keeper for Checkpoints<'_> {
    fn load(&mut self, step: &str) -> Option<Saved> {
        self.run.load(&self.name(step), &self.key)
    }

    fn save(&mut self, step: &str, saved: &Saved) -> Result<(), FitError> {
        self.run.save(&self.name(step), &self.key, saved).map_err(|e| FitError::Keep(e.to_string()))
    }
}
