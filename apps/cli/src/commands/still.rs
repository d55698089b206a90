use super::shared::Mend;
use crate::{Common, out};
use animimic::camera::CameraChoice;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Still {
    /// The model: any readable format
    model: PathBuf,
    /// The picture to write; its camera goes beside it as NAME.camera.json
    #[arg(short, long, value_name = "FILE.png")]
    out: PathBuf,
    /// Camera: auto (the view that shows most), preset:NAME (see `animimic list cameras`) or a camera.json or still
    #[arg(long, value_name = "auto|FILE|preset:NAME", default_value = "auto")]
    camera: CameraChoice,
    /// Width and height [px]: the shape that the video is to have [default: the camera file's, else 1024x1024]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Background colour as RRGGBB [default: one that stands out from the model]
    #[arg(long, value_name = "RRGGBB", value_parser = color)]
    background: Option<[u8; 3]>,
    #[command(flatten)]
    mend: Mend,
}

pub(super) fn size(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().map_err(|_| "a size is WIDTHxHEIGHT, such as 1280x720".to_owned());
    let (w, h) = text.split_once('x').ok_or("a size is WIDTHxHEIGHT, such as 1280x720")?;
    Ok([side(w)?, side(h)?])
}

fn color(text: &str) -> Result<[u8; 3], String> {
    let hex = text.strip_prefix('#').unwrap_or(text);
    let number = u32::from_str_radix(hex, 16).ok().filter(|_| hex.len() == 6 && hex.is_ascii());
    let [_, r, g, b] = number.ok_or("a colour is six hexadecimal digits, such as e2e4e6")?.to_be_bytes();
    Ok([r, g, b])
}

impl Still {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let job = animimic::still::Still {
            model: self.model.clone(),
            out: self.out.clone(),
            camera: self.camera.clone(),
            size_px: animimic::still::size_px(&self.camera, self.size, [1024, 1024])?,
            background: self.background,
            repair: self.mend.repair,
        };
        let drawn = animimic::still::still(&job)?;
        out::print(common, &drawn.to_json(), || {
            let mut text = format!("{}\n{}\nview: {}\n", drawn.picture.display(), drawn.camera.display(), drawn.view);
            drawn.advice.iter().for_each(|line| text += &format!("{line}\n"));
            drawn.warnings.iter().for_each(|line| text += &format!("warning: {line}\n"));
            text
        })
    }
}
