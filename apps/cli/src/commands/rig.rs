use super::shared::Mend;
use crate::bar::Bar;
use crate::{Common, out};
use animimic::rigging::{DEFAULT_RIGGER, RigJob, rig_files};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Rig {
    /// The model: any triangle mesh, closed or not; a rig that it has is replaced
    model: PathBuf,
    /// Where the rig goes: .glb (the model with it), or .txt (RigNet's rig.txt)
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// How the rig is made (see `animimic list riggers`)
    #[arg(long, value_name = "NAME", default_value = DEFAULT_RIGGER)]
    rigger: String,
    /// Level of detail: 1 for few bones to 5 for many
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=5))]
    detail: u8,
    /// The file whose rig is taken, for --rigger from-file: a rigged GLB or a rig.txt
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Also draw skeleton and weights: .png for all sides, .mp4 for a turntable
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    #[command(flatten)]
    mend: Mend,
}

impl Rig {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let job = RigJob {
            model: self.model.clone(),
            out: self.out.clone(),
            rigger: self.rigger.clone(),
            detail: self.detail,
            file: self.from.clone(),
            picture: self.picture.clone(),
            repair: self.mend.repair,
        };
        let mut bar = Bar::new(common);
        let report = rig_files(&job, &mut |e| bar.on_event(e))?;
        drop(bar);
        let json = report.to_json();
        out::print(common, &json, || out::lines(&json))
    }
}
