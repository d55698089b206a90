//! The picture that an image-to-video model starts from: the model at rest over a plain background, with the camera in it.
//!
//! The camera travels twice: as text inside the PNG, and as a `camera.json` beside it, because many services strip the first.

mod view;

pub(crate) use view::best as best_view;

use crate::Error;
use crate::camera::{self, CameraChoice};
use crate::pictures::Studio;
use animimic_render::Light;
use animimic_scene::{CameraFile, Image, io};
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What to draw.
#[derive(Clone, Debug)]
pub struct Still {
    /// The model.
    pub model: PathBuf,
    /// The `.png` to write.
    pub out: PathBuf,
    /// Camera; `Auto` chooses the view that shows most.
    pub camera: CameraChoice,
    /// Width and height [px].
    pub size_px: [u32; 2],
    /// Background colour; chosen to stand out from the model where absent.
    pub background: Option<[u8; 3]>,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
}

/// Text that every still carries under this key: its `camera.json`.
pub const CAMERA_KEY: &str = "animimic:camera";

/// Plain backgrounds to choose from: greys, and the green and blue of studios.
const BACKGROUNDS: [[u8; 3]; 5] = [[226, 228, 230], [128, 130, 132], [40, 42, 44], [96, 160, 112], [104, 136, 184]];
/// Frame rate in the camera file, which needs one; the video's own counts.
const FPS: f64 = 24.0;
/// Share of pixels that may look more like the background than the background's distance says.
const CLOSEST_SHARE: f64 = 0.05;
/// A grey background is preferred unless another stands out this many times better.
const CLEARLY: f64 = 1.3;
/// Largest side of a picture [px].
const LARGEST_PX: u32 = 4096;

/// What was drawn.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The PNG.
    pub picture: PathBuf,
    /// The camera file beside it.
    pub camera: PathBuf,
    /// Why this view, in words.
    pub view: String,
    /// Share of the surface that is seen, in [0, 1].
    pub seen: f64,
    /// Colour of the background.
    pub background: [u8; 3],
    /// What to tell an image-to-video model.
    pub advice: Vec<String>,
    /// What was odd about the model.
    pub warnings: Vec<String>,
}

impl Drawn {
    /// The same for machines.
    pub fn to_json(&self) -> serde_json::Value {
        json!({
            "picture": self.picture.display().to_string(), "camera": self.camera.display().to_string(), "view": self.view,
            "surface_seen": self.seen, "background_rgb": self.background, "advice": self.advice,
            "warnings": self.warnings,
        })
    }
}

/// The size of a still where none was asked for: that of the camera's file, else `usual` [px].
///
/// # Errors
/// A camera file that cannot be read.
pub fn size_px(camera: &CameraChoice, asked: Option<[u32; 2]>, usual: [u32; 2]) -> Result<[u32; 2], Error> {
    match (asked, camera) {
        (Some(size), _) => Ok(size),
        (None, CameraChoice::File(path)) => camera::read(path).map(|f| [f.main.width, f.main.height]),
        _ => Ok(usual),
    }
}

/// Draws the still and writes `NAME.png` and `NAME.camera.json`.
///
/// # Errors
/// Unreadable model, unknown camera, an output that is no `.png`, impossible sizes, or the disk.
pub fn still(job: &Still) -> Result<Drawn, Error> {
    if job.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
        return Err(Error::Input(format!("{}: the still is a PNG: name a .png file", job.out.display())));
    }
    let [width, height] = job.size_px;
    if !(16..=LARGEST_PX).contains(&width) || !(16..=LARGEST_PX).contains(&height) {
        return Err(Error::Input(format!("a still is 16 to {LARGEST_PX} px wide and high, not {width}×{height}")));
    }
    let asset = io::read_with(&job.model, &io::ReadOptions { repair: job.repair })?;
    let rig = &asset.rig;
    let positions = rig.at_rest();
    let bounds = asset.mesh.bounds();
    let studio = Studio::with_light(&asset, Light::default())?;
    let (main, view) = match &job.camera {
        CameraChoice::Auto => view::best(&asset, &positions, width, height)?,
        CameraChoice::Preset(name) => (camera::preset(name, bounds, width, height)?, format!("preset {name}")),
        CameraChoice::File(path) => (camera::from_file(path, width, height)?.main, "given".to_owned()),
    };
    let background = job.background.unwrap_or_else(|| {
        let (picture, mask) = studio.draw(&main, &positions, BACKGROUNDS[0]);
        let own: Vec<[u8; 3]> =
            (0..picture.rgb.len()).filter(|&p| mask.coverage[p] == 255).map(|p| picture.rgb[p]).collect();
        standing_out(&own)
    });
    let (picture, _) = studio.draw(&main, &positions, background);
    let file = CameraFile { main, fps: FPS, views: Vec::new(), target: Some(0.5 * (bounds.0 + bounds.1)) };
    let beside = job.out.with_extension("camera.json");
    let seen = view::surface_seen(&asset.mesh, &main, &positions);
    make_folder(&job.out)?;
    write_png(&job.out, &picture, &file)?;
    io::camera_json::write(&beside, &file)?;
    let advice = advice(&job.model, &beside);
    Ok(Drawn { picture: job.out.clone(), camera: beside, view, seen, background, advice, warnings: asset.warnings })
}

/// Makes the folder of a file that is to be written.
pub(crate) fn make_folder(file: &Path) -> Result<(), Error> {
    match file.parent().filter(|f| !f.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).map_err(Error::io(folder)),
        None => Ok(()),
    }
}

/// The background that the model's own colours keep farthest from.
fn standing_out(own: &[[u8; 3]]) -> [u8; 3] {
    let distance = |background: [u8; 3]| {
        let mut all: Vec<i32> =
            own.iter().map(|c| (0..3).map(|k| (i32::from(c[k]) - i32::from(background[k])).pow(2)).sum()).collect();
        all.sort_unstable();
        all.get((all.len() as f64 * CLOSEST_SHARE) as usize).map_or(0.0, |d| f64::from(*d).sqrt())
    };
    let mut best = (BACKGROUNDS[0], distance(BACKGROUNDS[0]));
    for other in BACKGROUNDS.into_iter().skip(1) {
        let d = distance(other);
        if d > CLEARLY * best.1 {
            best = (other, d);
        }
    }
    best.0
}

fn write_png(path: &Path, picture: &Image, camera: &CameraFile) -> Result<(), Error> {
    let mut bytes = Vec::new();
    let fail = |e: png::EncodingError| Error::Input(format!("{}: cannot be encoded: {e}", path.display()));
    let mut encoder = png::Encoder::new(&mut bytes, picture.width as u32, picture.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.add_itxt_chunk(CAMERA_KEY.into(), io::camera_json::to_json(camera)).map_err(fail)?;
    let mut writer = encoder.write_header().map_err(fail)?;
    writer.write_image_data(picture.rgb.as_flattened()).map_err(fail)?;
    writer.finish().map_err(fail)?;
    Ok(io::write_atomically(path, |w| w.write_all(&bytes))?)
}

/// The camera inside a still, if it has one.
///
/// # Errors
/// [`Error::Input`] for a file that is no PNG or has no camera; [`Error::Scene`] for a broken camera.
pub fn camera_inside(path: &Path) -> Result<CameraFile, Error> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info();
    let reader = reader.map_err(|e| Error::Input(format!("{}: not a PNG: {e}", path.display())))?;
    let chunk = reader.info().utf8_text.iter().find(|t| t.keyword == CAMERA_KEY);
    let text = chunk.and_then(|t| t.get_text().ok()).ok_or_else(|| {
        Error::Input(format!(
            "{}: has no camera inside: give the .camera.json that was written beside the still, or --camera auto",
            path.display()
        ))
    })?;
    io::camera_json::parse(text.as_bytes()).map_err(|e| e.in_file(path).into())
}

fn advice(model: &Path, camera: &Path) -> Vec<String> {
    vec![
        "prompt: name the creature and ONE motion, then: \"static camera, plain background, the whole body stays in the picture, \
         no cuts, no zoom\""
            .into(),
        "size: the picture's own shape, 480p or more; length: 3 to 5 s; the picture is the first frame".into(),
        format!("then: animimic animate {} VIDEO --camera {} -o DIR", model.display(), camera.display()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_background_keeps_away_from_the_models_colours() {
        assert_eq!(standing_out(&[[30, 32, 30]; 100]), BACKGROUNDS[0], "dark on light");
        assert_ne!(standing_out(&[[224, 228, 228]; 100]), BACKGROUNDS[0], "white is not drawn on white");
        let zebra = [[[240; 3]; 50], [[20; 3]; 50]].concat();
        let chosen = standing_out(&zebra);
        println!("black and white: {chosen:?}");
        assert!(chosen != BACKGROUNDS[0] && chosen != BACKGROUNDS[2]);
    }
}
