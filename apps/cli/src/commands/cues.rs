use super::fitting::{depth, depth_kind, masks};
use crate::bar::Bar;
use crate::{Common, out};
use animimic::cues::{CueSource, Form, Given};
use animimic::scene::DepthKind;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Cues {
    /// The video: MP4, GIF, WebP or a folder of frames
    video: PathBuf,
    /// Folder for masks.npz, tracks.npz, depth.npz (if given) and overlay.mp4; made if absent
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Masks made elsewhere, to look at or to write in another form: npz or folder of PNGs; or by a network (u2net, isnet)
    #[arg(long = "mask", value_name = "FILE|DIR|onnx:FILE[:PRESET]", value_parser = masks)]
    masks: Option<CueSource>,
    /// Point tracks made elsewhere: npz
    #[arg(long, value_name = "FILE")]
    tracks: Option<PathBuf>,
    /// Depth made elsewhere: npz or folder of 16-bit PNGs or EXRs; or by a network (midas, depth-anything)
    #[arg(long, value_name = "FILE|DIR|onnx:FILE[:PRESET]", value_parser = depth)]
    depth: Option<CueSource>,
    /// What the depth means: metric (distance) or inverse (disparity) [default: what the npz says, inverse of a network, else metric]
    #[arg(long, value_name = "metric|inverse", value_parser = depth_kind)]
    depth_kind: Option<DepthKind>,
    /// How masks and depth are written: npz, or png for folders of pictures
    #[arg(long, value_name = "npz|png", default_value = "npz", value_parser = form)]
    form: Form,
    /// Height at which the video is worked on [px]; never enlarged
    #[arg(long, value_name = "PX", default_value_t = 512)]
    height: usize,
}

fn form(text: &str) -> Result<Form, String> {
    match text {
        "npz" => Ok(Form::Npz),
        "png" => Ok(Form::Png),
        _ => Err("cues are written as npz or png".into()),
    }
}

impl Cues {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let given = Given {
            masks: self.masks.as_ref(),
            tracks: self.tracks.as_deref(),
            depth: self.depth.as_ref(),
            depth_kind: self.depth_kind,
        };
        let mut bar = Bar::new(common);
        let json =
            animimic::cues::write(&self.video, self.height, &given, self.form, &self.out, &mut |e| bar.on_event(e))?;
        drop(bar);
        out::print(common, &json, || out::lines(&json))
    }
}
