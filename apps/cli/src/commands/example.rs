use crate::bar::Bar;
use crate::{Common, out};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Example {
    /// Folder for creature.glb, creature.mp4 and camera.json; made if absent
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Also write the true motion, for `animimic evaluate --truth DIR/truth`
    #[arg(long)]
    truth: bool,
}

impl Example {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let mut bar = Bar::new(common);
        let files = animimic::example::write(&self.out, self.truth, &mut |e| bar.on_event(e))?;
        drop(bar);
        let names: Vec<String> = files.iter().map(|f| f.display().to_string()).collect();
        out::print(common, &serde_json::json!({"files": names}), || names.join("\n"))
    }
}
