use super::shared::{Body, Mend};
use crate::bar::Bar;
use crate::{Common, out};
use animimic::Physics;
use animimic::camera::CameraChoice;
use animimic::soften::Softness;
use serde_json::Value;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Soften {
    /// The animated model: GLB or glTF with a skeleton and a clip
    model: PathBuf,
    /// Folder for softened.glb, views.mp4 and report.json; made if absent
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// A video of the clip: the stiffness is learnt from it, and the frames decide where the soft surface stays
    #[arg(long, value_name = "FILE")]
    video: Option<PathBuf>,
    /// Camera of the video: auto, a camera.json, or preset:NAME
    #[arg(long, value_name = "auto|FILE|preset:NAME", default_value = "auto", requires = "video")]
    camera: CameraChoice,
    /// Stiffness in pascals, or flesh, rubber, jelly, fat; MATERIAL=VALUE for one material, several may be given [default: flesh]
    #[arg(long = "young", value_name = "VALUE|MATERIAL=VALUE")]
    softness: Vec<Softness>,
    /// Name of a joint that does not hold what hangs on it (a tail, ears, a cape); several may be given
    #[arg(long = "loose", value_name = "JOINT")]
    loose: Vec<String>,
    #[command(flatten)]
    body: Body,
    /// How fast sway dies down [1/s]
    #[arg(long, value_name = "RATE", default_value_t = 0.0)]
    damping: f64,
    /// The clip [default: the first]
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Frames per second of the result
    #[arg(long, value_name = "FPS", default_value_t = 30.0)]
    fps: f64,
    /// Height of each view in views.mp4 [px]
    #[arg(long, value_name = "PX", default_value_t = 512)]
    height: usize,
    /// How the soft motion is written (see `animimic list physics`)
    #[arg(long, value_name = "NAME", default_value_t = Physics::default())]
    physics: Physics,
    #[command(flatten)]
    mend: Mend,
}

impl Soften {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let job = animimic::soften::Soften {
            video: self.video.clone(),
            camera: self.camera.clone(),
            clip: self.clip.clone(),
            softness: self.softness.clone(),
            tets: self.body.tets,
            size_m: self.body.size_m,
            loose: self.loose.clone(),
            damping: self.damping,
            fps: self.fps,
            physics: self.physics,
            height_px: self.height,
            repair: self.mend.repair,
            ..animimic::soften::Soften::new(&self.model, &self.out)
        };
        let mut bar = Bar::new(common);
        let report = animimic::soften::soften(&job, &mut |e| bar.on_event(e))?;
        drop(bar);
        out::print(common, &report, || words(&report) + &format!("{}\n", self.out.join("softened.glb").display()))
    }
}

/// A report in a few lines for people.
fn words(report: &Value) -> String {
    let number = |path: &str| report.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let text = |path: &str| report.pointer(path).and_then(Value::as_str).unwrap_or_default();
    let carrier = Some(text("/export/carrier")).filter(|c| !c.is_empty()).map_or_else(String::new, |c| format!(" ({c})"));
    let verdict = Some(text("/verdict")).filter(|v| !v.is_empty()).map_or_else(String::new, |v| format!("{v}\n"));
    format!(
        "{verdict}{}: {} frames, {} tets, {} inverted, volume within {:.1} %\n\
         surface {:.2} % of the diagonal from skinning (rms); crossing triangles {} -> {} over the clip\n\
         physics as {}{carrier}: residual rms {:.3} %, p99 {:.3} %\n",
        text("/clip"),
        number("/frames"),
        number("/tets"),
        number("/inverted_tets"),
        100.0 * number("/volume_change"),
        number("/from_skinning_rms_percent"),
        number("/self_intersections_skinned"),
        number("/self_intersections"),
        text("/export/encoding"),
        number("/export/residual_percent/rms"),
        number("/export/residual_percent/p99"),
    )
}
