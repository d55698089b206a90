use super::fitting::Fitting;
use crate::Common;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Fit {
    /// The rigged model: GLB, glTF, an OBJ with rig.txt beside it, or a folder with objs/mesh.obj and objs/rig.txt
    model: PathBuf,
    /// Videos of it moving, one clip each: MP4, GIF, WebP or a folder of frames
    #[arg(required = true)]
    videos: Vec<PathBuf>,
    /// The GLB to write
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    fitting: Fitting,
}

impl Fit {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let job = self.fitting.job(&self.model, self.videos.clone(), &self.out, common);
        self.fitting.run(&job, common, animimic::fit, Path::to_path_buf)
    }
}
