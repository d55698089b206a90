use super::fitting::Fitting;
use crate::Common;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Animate {
    /// The still model: GLB, glTF, an OBJ with rig.txt beside it, or a folder with objs/mesh.obj and objs/rig.txt
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
