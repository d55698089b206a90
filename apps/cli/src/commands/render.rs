use super::shared::Mend;
use crate::bar::Bar;
use crate::{Common, out};
use animimic::camera::CameraChoice;
use animimic::turntable::{Shoot, View};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Render {
    /// The model: any readable format; a GLB's clips can be played
    asset: PathBuf,
    /// The file to write: .mp4 or .gif for a video, .png for one frame
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Views side by side: input, a turn in degrees such as +45 or -45, turntable, preset:NAME, a camera.json or a still
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_hyphen_values = true, default_value = "input,-45,+45")]
    views: Vec<View>,
    /// Camera of the view `input`: auto (the view that shows most), a camera.json or still, or preset:NAME
    #[arg(long, value_name = "auto|FILE|preset:NAME", default_value = "preset:reference")]
    camera: CameraChoice,
    /// Name of the clip to play [default: the first; a still model is drawn at rest]
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// What to show beside the looks (see `animimic list overlays`)
    #[arg(long = "overlay", value_name = "LIST", value_delimiter = ',')]
    overlays: Vec<String>,
    /// The video to compare with, for residuals; its frame rate and length are taken
    #[arg(long, value_name = "FILE")]
    video: Option<PathBuf>,
    /// The moment that a .png shows [s]
    #[arg(long = "at", value_name = "SECS", default_value_t = 0.0)]
    at: f64,
    /// Height of each view [px]
    #[arg(long, value_name = "PX", default_value_t = 512)]
    height: usize,
    /// Frames per second
    #[arg(long, value_name = "FPS", default_value_t = 24.0)]
    fps: f64,
    #[command(flatten)]
    mend: Mend,
}

impl Render {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let shoot = Shoot {
            asset: self.asset.clone(),
            out: self.out.clone(),
            views: self.views.clone(),
            camera: self.camera.clone(),
            clip: self.clip.clone(),
            height_px: self.height,
            overlays: self.overlays.clone(),
            video: self.video.clone(),
            at_secs: self.at,
            fps: self.fps,
            repair: self.mend.repair,
        };
        let mut bar = Bar::new(common);
        let frames = animimic::turntable::render(&shoot, &mut |e| bar.on_event(e))?;
        drop(bar);
        let json = serde_json::json!({"file": self.out.display().to_string(), "frames": frames});
        out::print(common, &json, || format!("{} ({frames} frames)", self.out.display()))
    }
}
