use super::fitting::{Fitting, words};
use crate::bar::Bar;
use crate::{Common, out};
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
        let job = self.fitting.job(&self.model, self.videos.clone(), &self.out, common);
        let mut bar = Bar::new(common);
        let report = animimic::animate(&job, &mut |e| bar.on_event(e))?;
        drop(bar);
        let json = serde_json::to_value(&report)?;
        out::print(common, &json, || words(&report) + &format!("{}\n", self.out.join("report.html").display()))
    }
}
