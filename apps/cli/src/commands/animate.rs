use super::fitting::Fitting;
use crate::Common;
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
    /// How motion beyond the skeleton is delivered (see `animimic list physics`)
    #[arg(long, value_name = "NAME", default_value_t = Physics::default())]
    physics: Physics,
    #[command(flatten)]
    fitting: Fitting,
}

impl Animate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let work = |job: &Job, progress: &mut Progress| {
            animimic::animate(&Job { physics: self.physics, ..job.clone() }, progress)
        };
        let made = |folder: &Path| folder.join("report.html");
        self.fitting.run(&self.model, &self.videos, &self.out, common, work, made)
    }
}
