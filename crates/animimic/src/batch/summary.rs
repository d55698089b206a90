//! What became of the jobs of a batch, as a table and as JSON.

use super::Named;
use crate::{Error, Report};
use serde_json::{Value, json};
use std::path::PathBuf;

/// How a job ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It was done now.
    Done,
    /// It was done before, and is kept.
    Kept,
    /// It failed.
    Failed,
    /// It was stopped; what it did is kept.
    Stopped,
}

impl State {
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Kept => "kept",
            Self::Failed => "failed",
            Self::Stopped => "stopped",
        }
    }
}

/// One job.
#[derive(Clone, Debug)]
pub struct Row {
    /// Its name.
    pub name: String,
    /// Its folder.
    pub out: PathBuf,
    /// How it ended.
    pub state: State,
    /// Why it failed.
    pub error: Option<String>,
    /// Its clips: name, frames, mask IoU, SSIM, number of doubts.
    pub clips: Vec<Value>,
    /// Time that it took now [s].
    pub seconds: f64,
}

impl Row {
    pub(super) fn new(named: &Named, ended: Result<(Report, bool), Error>, seconds: f64) -> Self {
        let (name, out) = (named.name.clone(), named.job.out.clone());
        let (state, error, clips) = match ended {
            Ok((report, kept)) => (if kept { State::Kept } else { State::Done }, None, clips(&report)),
            Err(Error::Cancelled) => (State::Stopped, None, Vec::new()),
            Err(e) => (State::Failed, Some(e.to_string().replace('\n', " ")), Vec::new()),
        };
        Self { name, out, state, error, clips, seconds }
    }

    fn to_json(&self) -> Value {
        json!({
            "name": self.name, "state": self.state.word(), "out": self.out.display().to_string(), "clips": self.clips,
            "error": self.error,
        })
    }
}

fn clips(report: &Report) -> Vec<Value> {
    let clip = |c: &crate::animate::ClipReport| {
        let metric = |key: &str| c.metrics.get(key).cloned().unwrap_or(Value::Null);
        json!({"name": c.name, "frames": c.frames, "iou": metric("iou_main"), "ssim": metric("ssim"), "doubts": c.uncertain.len()})
    };
    report.clips.iter().map(clip).collect()
}

/// All jobs, in the order of the list.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The jobs that were begun.
    pub rows: Vec<Row>,
    /// Whether the user stopped it.
    pub stopped: bool,
}

impl Summary {
    /// Jobs that ended so.
    pub fn count(&self, state: State) -> usize {
        self.rows.iter().filter(|r| r.state == state).count()
    }

    /// Names of the failed jobs.
    pub fn failed(&self) -> Vec<&str> {
        self.rows.iter().filter(|r| r.state == State::Failed).map(|r| r.name.as_str()).collect()
    }

    /// All that is known; only `timings` differs between equal runs, and `state` where jobs were kept.
    pub fn to_json(&self) -> Value {
        let timings: serde_json::Map<String, Value> =
            self.rows.iter().map(|r| (r.name.clone(), r.seconds.into())).collect();
        json!({
            "jobs": self.rows.iter().map(Row::to_json).collect::<Vec<_>>(),
            "done": self.count(State::Done), "kept": self.count(State::Kept), "failed": self.count(State::Failed),
            "stopped": self.stopped, "timings": timings,
        })
    }

    /// A table for people, one line a clip.
    pub fn table(&self) -> String {
        let wide = self.rows.iter().map(|r| r.name.chars().count()).max().unwrap_or(0).max(3);
        let mut text =
            format!("{:wide$}  {:7} {:24} {:>6} {:>6} {:>6}\n", "job", "state", "clip", "frames", "IoU", "SSIM");
        for row in &self.rows {
            let state = row.state.word();
            if row.clips.is_empty() {
                text += &format!("{:wide$}  {state:7} {}\n", row.name, row.error.as_deref().unwrap_or_default());
            }
            for clip in &row.clips {
                let number = |key: &str| clip[key].as_f64().map_or_else(|| "-".into(), |v| format!("{v:.3}"));
                let (name, frames) = (clip["name"].as_str().unwrap_or_default(), &clip["frames"]);
                let (iou, ssim) = (number("iou"), number("ssim"));
                text += &format!("{:wide$}  {state:7} {name:24} {frames:>6} {iou:>6} {ssim:>6}\n", row.name);
            }
        }
        text
    }
}
