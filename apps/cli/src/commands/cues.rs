use crate::bar::Bar;
use crate::{Common, out};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Cues {
    /// The video: MP4, GIF, WebP or a folder of frames
    video: PathBuf,
    /// Folder for masks.npz, tracks.npz and overlay.mp4; made if absent
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Height at which the video is worked on [px]; never enlarged
    #[arg(long, value_name = "PX", default_value_t = 512)]
    height: usize,
}

impl Cues {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let mut bar = Bar::new(common);
        let json = animimic::cues::write(&self.video, self.height, &self.out, &mut |e| bar.on_event(e))?;
        drop(bar);
        out::print(common, &json, || out::lines(&json))
    }
}
