//! From a model to a video of it moving: the still is drawn here, the video is made by a provider of the user's choice.

use crate::Error;
use crate::camera::CameraChoice;
use crate::run::Lock;
use crate::still::{Still, make_folder, still};
pub use animimic_video::generate::{
    About, Ask, Generated, Host, PROVIDERS, Patience, Provider, job_path, keys_set, provider,
};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// What is moved.
#[derive(Clone, Debug)]
pub enum Start {
    /// A still is drawn of this model.
    Model {
        /// The model.
        model: PathBuf,
        /// The still's camera.
        camera: CameraChoice,
        /// The still's width and height [px].
        size_px: [u32; 2],
        /// Mend a model that is broken in small ways instead of refusing it.
        repair: bool,
    },
    /// A PNG or JPEG that is there already.
    Still(PathBuf),
}

/// What is to be made.
#[derive(Clone, Debug)]
pub struct Generate {
    /// What is moved.
    pub start: Start,
    /// The `.mp4` to write. A still that is drawn goes beside it as `.png`, with its `.camera.json`.
    pub out: PathBuf,
    /// Name of the provider.
    pub provider: String,
    /// What is asked for; its picture is filled in here.
    pub ask: Ask,
    /// Whether an earlier job for the same file is forgotten.
    pub again: bool,
    /// How long to wait.
    pub patience: Patience,
}

/// What was made.
#[derive(Clone, Debug)]
pub struct Moving {
    /// The video.
    pub video: PathBuf,
    /// The picture that it starts from.
    pub still: PathBuf,
    /// The still's camera, where it was drawn here.
    pub camera: Option<PathBuf>,
    /// The job.
    pub job: Generated,
    /// The provider's name.
    pub provider: String,
}

impl Moving {
    /// A flat JSON object.
    pub fn to_json(&self) -> Value {
        let shown = |p: &PathBuf| p.display().to_string();
        json!({
            "video": shown(&self.video), "still": shown(&self.still), "camera": self.camera.as_ref().map(shown),
            "provider": self.provider, "job": self.job.id, "resumed": self.job.resumed, "frames": self.job.frames,
            "fps": self.job.fps, "width": self.job.size.0, "height": self.job.size.1,
        })
    }
}

/// The picture to start from and its camera, drawn as `to` where there is none yet.
fn picture(start: &Start, to: &Path) -> Result<(PathBuf, Option<PathBuf>), Error> {
    match start {
        Start::Still(path) => Ok((path.clone(), None)),
        Start::Model { model, camera, size_px, repair } => {
            let (model, camera, out) = (model.clone(), camera.clone(), to.with_extension("png"));
            let drawn = still(&Still { model, out, camera, size_px: *size_px, background: None, repair: *repair })?;
            Ok((drawn.picture, Some(drawn.camera)))
        }
    }
}

/// The request that would be sent, without keys; nothing is sent and nothing is written.
///
/// # Errors
/// A model that cannot be drawn, an unknown provider, or an order that the provider cannot take.
pub fn plan(job: &Generate, host: &dyn Host) -> Result<Value, Error> {
    let folder = tempfile::tempdir().map_err(Error::io(&std::env::temp_dir()))?;
    let (picture, _) = picture(&job.start, &folder.path().join("still.png"))?;
    let ask = Ask { picture, ..job.ask.clone() };
    Ok(animimic_video::generate::plan(provider(&job.provider)?, &ask, host)?)
}

/// Draws the still, has it moved and writes the video.
///
/// Called again after whatever end, it goes on with the job that was asked for and makes no new one.
///
/// # Errors
/// As [`plan`] and `animimic_video::generate::generate`; [`Error::Cancelled`] when the user stops, with the job kept.
pub fn generate(job: &Generate, host: &mut dyn Host) -> Result<Moving, Error> {
    let provider = provider(&job.provider)?;
    if job.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("mp4")) {
        return Err(Error::Input(format!("{}: the video is an MP4: name a .mp4 file", job.out.display())));
    }
    make_folder(&job.out)?;
    // Two at once would both order.
    let mut held = job_path(&job.out).into_os_string();
    held.push(".lock");
    let _lock = Lock::take(Path::new(&held), &job.out)?;
    let (still, camera) = picture(&job.start, &job.out)?;
    let ask = Ask { picture: still.clone(), ..job.ask.clone() };
    let made = animimic_video::generate::generate(provider, &ask, &job.out, job.again, &job.patience, host)?;
    Ok(Moving { video: job.out.clone(), still, camera, job: made, provider: job.provider.clone() })
}
