use super::shared::Mend;
use super::still::size;
use crate::bar::Bar;
use crate::{Common, out};
use animimic::camera::CameraChoice;
use animimic::generate::{Ask, Patience, Start};
use anyhow::Context;
use serde_json::{Map, Value};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Generate {
    /// The model of which a still is drawn
    #[arg(required_unless_present = "still")]
    model: Option<PathBuf>,
    /// What is to happen, such as "the fox jumps, static camera"
    #[arg(long, value_name = "TEXT")]
    prompt: String,
    /// Who makes the video (see `animimic list providers`); keys come from the environment (see `animimic doctor`)
    #[arg(long, value_name = "NAME")]
    provider: String,
    /// The video to write; the still goes beside it as NAME.png, the job as NAME.mp4.job.json
    #[arg(short, long, value_name = "FILE.mp4")]
    out: PathBuf,
    /// A PNG or JPEG to start from instead of drawing one
    #[arg(long, value_name = "FILE", conflicts_with_all = ["model", "camera", "size", "repair"])]
    still: Option<PathBuf>,
    /// Camera of the still: auto, preset:NAME or a camera.json or still
    #[arg(long, value_name = "auto|FILE|preset:NAME", default_value = "auto")]
    camera: CameraChoice,
    /// Width and height of the still [px] [default: the camera file's, else 1280x720]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    #[command(flatten)]
    mend: Mend,
    /// The service's model [default: one that the provider names]
    #[arg(long = "service-model", value_name = "NAME")]
    service_model: Option<String>,
    /// The service's address [default: its public one]
    #[arg(long, value_name = "URL")]
    url: Option<String>,
    /// A further member of the request: NAME=TEXT, or NAME:=JSON for numbers and flags; may be repeated
    #[arg(long = "option", value_name = "NAME=TEXT", value_parser = option)]
    options: Vec<(String, Value)>,
    /// Workflow for comfyui, in API format, with {image} and {prompt} in it
    #[arg(long, value_name = "FILE.json")]
    workflow: Option<PathBuf>,
    /// Longest time to wait for the video [s]; the same command goes on afterwards
    #[arg(long, value_name = "SECS", default_value_t = Patience::default().job_secs)]
    timeout: u64,
    /// Forget an earlier job for the same file and ask anew
    #[arg(long)]
    again: bool,
    /// Print the request without its key, and send nothing
    #[arg(long)]
    dry_run: bool,
    /// For the provider command: program and arguments, with {image}, {prompt} and {out} in them
    #[arg(last = true, value_name = "PROGRAM")]
    command: Vec<String>,
}

fn option(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').ok_or("an option is NAME=TEXT or NAME:=JSON")?;
    match name.strip_suffix(':') {
        Some(name) => serde_json::from_str(value).map(|v| (name.to_owned(), v)).map_err(|e| format!("{value}: {e}")),
        None => Ok((name.to_owned(), value.into())),
    }
}

impl Generate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let start = match (&self.still, &self.model) {
            (Some(still), _) => Start::Still(still.clone()),
            (None, Some(model)) => {
                Start::Model { model: model.clone(), camera: self.camera.clone(), size_px: animimic::still::size_px(&self.camera, self.size, [1280, 720])?, repair: self.mend.repair }
            }
            (None, None) => anyhow::bail!("give a model, or --still FILE"),
        };
        let job = animimic::generate::Generate {
            start,
            out: self.out.clone(),
            provider: self.provider.clone(),
            ask: Ask {
                prompt: self.prompt.clone(),
                model: self.service_model.clone(),
                url: self.url.clone(),
                options: self.options.iter().cloned().collect::<Map<_, _>>(),
                command: self.command.clone(),
                workflow: self.workflow()?,
                ..Ask::default()
            },
            again: self.again,
            patience: Patience { job_secs: self.timeout, ..Patience::default() },
        };
        let mut bar = Bar::new(common);
        if self.dry_run {
            let plan = animimic::generate::plan(&job, &bar)?;
            drop(bar);
            let text = serde_json::to_string_pretty(&plan)?;
            return out::print(common, &plan, || text);
        }
        let made = animimic::generate::generate(&job, &mut bar)?;
        drop(bar);
        out::print(common, &made.to_json(), || out::lines(&made.to_json()))
    }

    fn workflow(&self) -> anyhow::Result<Option<Value>> {
        let Some(path) = &self.workflow else { return Ok(None) };
        let shown = path.display().to_string();
        let bytes = std::fs::read(path).with_context(|| shown.clone())?;
        let json = serde_json::from_slice(&bytes).with_context(|| format!("{shown}: no workflow in API format"))?;
        Ok(Some(json))
    }
}
