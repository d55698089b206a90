use crate::bar::Bar;
use crate::{Common, out};
use animimic::Measure;
use animimic::camera::CameraChoice;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Evaluate {
    /// The animated model (GLB)
    asset: PathBuf,
    /// The video that it should look like
    video: Option<PathBuf>,
    /// Folder with exact truth: gt.npz, meta.json, and where known camera.json, masks.npz, static.glb
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// The model before it was animated, to see that its rest is untouched
    #[arg(long, value_name = "FILE")]
    input: Option<PathBuf>,
    /// Camera of the video: a camera.json or preset:NAME [default: the truth's]
    #[arg(long, value_name = "FILE|preset:NAME")]
    camera: Option<CameraChoice>,
    /// Name of the clip to measure [default: the first]
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Height at which the video is compared [px]; never enlarged
    #[arg(long, value_name = "PX", default_value_t = 512)]
    height: usize,
}

impl Evaluate {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let measure = Measure {
            asset: self.asset.clone(),
            video: self.video.clone(),
            truth: self.truth.clone(),
            input: self.input.clone(),
            camera: self.camera.clone(),
            clip: self.clip.clone(),
            height_px: self.height,
        };
        let mut bar = Bar::new(common);
        let evaluation = animimic::evaluate_files(&measure, &mut |e| bar.on_event(e))?;
        drop(bar);
        let mut json = evaluation.to_json();
        if let (Some(map), Some(name)) = (json.as_object_mut(), self.truth.as_ref().and_then(|t| t.file_name())) {
            map.shift_insert(0, "case".into(), name.to_string_lossy().into());
        }
        out::print(common, &json, || out::lines(&json))
    }
}
