use super::fitting::Fitting;
use crate::Common;
use animimic::animate::{Flesh, Stage};
use animimic::sim::tet::DEFAULT_TETS;
use animimic::{Job, Physics, Progress};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Animate {
    /// The still model, rigged or not: GLB, glTF, OBJ (with rig.txt beside it), OFF, STL, PLY, or a folder with objs/mesh.obj
    model: PathBuf,
    /// Videos of it moving, one clip each: MP4, GIF, WebP or a folder of frames
    #[arg(required = true)]
    videos: Vec<PathBuf>,
    /// Folder for the results; made if absent
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// How far to go: pose (the skeleton's motion) or soft (and soft tissue on it, its stiffness learnt from the videos)
    #[arg(long, value_name = "pose|soft", default_value_t = Stage::default())]
    stage: Stage,
    /// Stiffness that flesh is taken to have before the videos speak: pascals, or flesh, rubber, jelly, fat [default: flesh]
    #[arg(long, value_name = "VALUE", value_parser = animimic::soften::young)]
    young: Option<f64>,
    /// Name of a joint that does not hold what hangs on it; others are found by evidence; several may be given
    #[arg(long = "loose", value_name = "JOINT")]
    loose: Vec<String>,
    /// How many tets are simulated, about
    #[arg(long, value_name = "N", default_value_t = DEFAULT_TETS)]
    tets: usize,
    /// Length of the model's diagonal [m]: larger things sway more slowly
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    size_m: f64,
    /// How motion beyond the skeleton is delivered (see `animimic list physics`)
    #[arg(long, value_name = "NAME", default_value_t = Physics::default())]
    physics: Physics,
    #[command(flatten)]
    fitting: Fitting,
}

impl Animate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let work = |job: &Job, progress: &mut Progress| {
            animimic::animate(&Job { physics: self.physics, stage: self.stage, flesh: self.flesh(), ..job.clone() }, progress)
        };
        let made = |folder: &Path| folder.join("report.html");
        self.fitting.run(&self.model, &self.videos, &self.out, common, work, made)
    }

    fn flesh(&self) -> Flesh {
        let young = self.young.unwrap_or(Flesh::default().young);
        Flesh { tets: self.tets, size_m: self.size_m, young, loose: self.loose.clone() }
    }
}
