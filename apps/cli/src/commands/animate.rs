use super::fitting::Fitting;
use crate::Common;
use std::path::PathBuf;

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
    #[command(flatten)]
    fitting: Fitting,
}

impl Animate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        self.fitting.run(&self.model, &self.videos, &self.out, common, animimic::animate, |folder| folder.join("report.html"))
    }
}
