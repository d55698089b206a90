use super::fitting::Fitting;
use super::shared::Body;
use crate::Common;
use animimic::animate::{Flesh, Stage};
use animimic::{Error, Job, Physics, Progress};
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
    #[command(flatten)]
    body: Body,
    /// How motion beyond the skeleton is delivered (see `animimic list physics`)
    #[arg(long, value_name = "NAME", default_value_t = Physics::default())]
    physics: Physics,
    /// Go on with what an earlier run of the same inputs and options left in the folder: what is done is not done again
    #[arg(long)]
    resume: bool,
    /// Options from a TOML file by the same names, model, videos and out too; what is given here counts before it
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    #[command(flatten)]
    fitting: Fitting,
}

impl Animate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let work = |job: &Job, progress: &mut Progress| animimic::animate(job, progress);
        let made = |folder: &Path| folder.join("report.html");
        self.fitting.run(&self.job(common), common, work, made).map_err(|e| match e.downcast_ref::<Error>() {
            Some(Error::Cancelled) => {
                anyhow::anyhow!("stopped on request, and what is done is kept; go on with: {}", resume())
            }
            _ => e,
        })
    }

    /// The job that the options ask for.
    pub fn job(&self, common: &Common) -> Job {
        let job = self.fitting.job(&self.model, self.videos.clone(), &self.out, common);
        Job { physics: self.physics, stage: self.stage, flesh: self.flesh(), resume: self.resume, ..job }
    }

    fn flesh(&self) -> Flesh {
        let young = self.young.unwrap_or(Flesh::default().young);
        Flesh { tets: self.body.tets, size_m: self.body.size_m, young, loose: self.loose.clone() }
    }
}

/// The command that goes on with this one, as a shell takes it.
fn resume() -> String {
    let mut words: Vec<String> = std::env::args().map(|w| quoted(&w)).collect();
    if !words.iter().any(|w| w == "--resume") {
        words.push("--resume".into());
    }
    words.join(" ")
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:=,+@".contains(c);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_of_a_command_are_quoted_where_a_shell_would_split_or_expand_them() {
        assert_eq!(quoted("out/a-b_1.glb"), "out/a-b_1.glb");
        assert_eq!(quoted("my fox.glb"), "'my fox.glb'");
        assert_eq!(quoted("it's $HOME"), "'it'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
    }
}
