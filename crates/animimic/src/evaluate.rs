//! Measures an animated model against a video and, where there is one, against exact truth.

use crate::error::Error;
use crate::metrics::{self, Evidence, PicturePair, Reading, SilhouettePair};
use crate::pictures;
use crate::truth::Truth;
use animimic_scene::{Asset, Camera, Image, Mask, Pose};
use animimic_video::cues::Background;
use glam::DVec3;
use rayon::prelude::*;

/// What a result is measured against. Everything is optional; metrics say what they lack.
#[derive(Default)]
pub struct Against<'a> {
    /// Exact truth; then its frames and its camera count.
    pub truth: Option<&'a Truth>,
    /// The model before it was animated.
    pub input: Option<&'a Asset>,
    /// The input camera, at the size of the pictures below.
    pub camera: Option<Camera>,
    /// Frames of the video, at the camera's size.
    pub video: &'a [Image],
    /// Object masks of these frames.
    pub masks: &'a [Mask],
    /// What is behind the object; the video's border colour where absent.
    pub background: Option<&'a Background>,
}

/// The numbers.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// Frames compared.
    pub frames: usize,
    /// Numbers by JSON key, in printing order.
    pub readings: Vec<Reading>,
    /// Metrics that had nothing to go by, with the reason.
    pub missing: Vec<(&'static str, &'static str)>,
}

impl Evaluation {
    /// One number by its key.
    pub fn get(&self, key: &str) -> Option<f64> {
        self.readings.iter().find(|r| r.0 == key).map(|r| r.1)
    }

    /// A flat JSON object, as the outside judge prints it.
    pub fn to_json(&self) -> serde_json::Value {
        let mut map = serde_json::Map::new();
        map.insert("frames".into(), self.frames.into());
        for (key, value) in &self.readings {
            let whole = key.starts_with("joints_").then_some(*value as u64);
            map.insert(key.clone(), whole.map_or_else(|| (*value).into(), Into::into));
        }
        let missing = self.missing.iter().map(|(name, why)| ((*name).to_owned(), (*why).into())).collect();
        map.insert("not_available".into(), serde_json::Value::Object(missing));
        map.into()
    }
}

/// Measures `asset` in the poses of `poses` \[frame\] at `fps`. With truth, frame t is compared with truth's frame t.
///
/// # Errors
/// [`Error::Input`] when the vertex buffers of result and truth differ.
pub fn evaluate(asset: &Asset, poses: &[Pose], fps: f64, against: &Against) -> Result<Evaluation, Error> {
    let skeleton = &asset.rig.skeleton;
    let posed: Vec<(Vec<DVec3>, Vec<DVec3>)> = poses
        .par_iter()
        .map(|pose| {
            let world = skeleton.world_from_joint(&pose.locals);
            (asset.rig.skinned(&world), world.iter().map(|w| w.translation).collect())
        })
        .collect();
    let (frames, joints): (Vec<_>, Vec<_>) = posed.into_iter().unzip();
    if let Some(truth) = against.truth {
        let (own, real) = (frames.first().map_or(0, Vec::len), truth.vertices[0].len());
        if own != real || frames.len() != truth.vertices.len() {
            return Err(Error::Input(format!(
                "the result has {own} vertices in {} frames, the truth {real} in {}: vertex buffers must be kept",
                frames.len(),
                truth.vertices.len()
            )));
        }
    }
    let camera = against.truth.and_then(|t| t.camera.as_ref()).map(|c| c.main).or(against.camera);
    let silhouettes = silhouettes(asset, &frames, against);
    let pictures = match against.camera {
        Some(camera) if !against.video.is_empty() => picture_pair(asset, &frames, &camera, against)?,
        _ => None,
    };
    let input = against.input.or_else(|| against.truth.and_then(|t| t.still.as_ref()));
    let evidence = Evidence {
        asset,
        input,
        frames: &frames,
        joints: &joints,
        fps,
        truth: against.truth,
        camera: camera.as_ref(),
        silhouettes: &silhouettes,
        pictures: pictures.as_ref(),
    };
    let (readings, missing) = metrics::measure(&evidence);
    Ok(Evaluation { frames: frames.len(), readings, missing })
}

/// Truth's views where there is truth, else the input view against the video's masks.
fn silhouettes(asset: &Asset, frames: &[Vec<DVec3>], against: &Against) -> Vec<SilhouettePair> {
    let draw = |camera: &Camera, n: usize| -> Vec<Mask> {
        frames[..n.min(frames.len())].par_iter().map(|x| pictures::silhouette(camera, &asset.mesh, x)).collect()
    };
    if let Some(truth) = against.truth
        && let Some(file) = &truth.camera
    {
        let view = |name: &str| match name {
            "main" => Some(file.main),
            _ => file.views.iter().find(|v| v.0 == name).map(|v| v.1),
        };
        let seen = truth.masks.iter().filter_map(|(name, masks)| Some((name, masks, view(name)?)));
        return seen
            .map(|(name, masks, camera)| SilhouettePair {
                view: name.clone(),
                result: draw(&camera, masks.len()),
                reference: masks.clone(),
            })
            .collect();
    }
    match against.camera {
        Some(camera) if !against.masks.is_empty() => vec![SilhouettePair {
            view: "main".into(),
            result: draw(&camera, against.masks.len()),
            reference: against.masks.to_vec(),
        }],
        _ => Vec::new(),
    }
}

/// Renders the result over the video's background in light solved from frame 0.
fn picture_pair(
    asset: &Asset,
    frames: &[Vec<DVec3>],
    camera: &Camera,
    against: &Against,
) -> Result<Option<PicturePair>, Error> {
    let n = frames.len().min(against.video.len());
    if n == 0 {
        return Ok(None);
    }
    let studio = pictures::Studio::new(asset, camera, &frames[0], &against.video[0], against.masks.first())?;
    let border = pictures::border_color(&against.video[0]);
    let drawn: Vec<(Image, Mask)> = (0..n)
        .into_par_iter()
        .map(|t| {
            let video = &against.video[t];
            let behind = match against.background.filter(|b| !b.drift.is_empty()) {
                Some(b) => pictures::background_picture(b, video, t),
                None => Image::filled(video.width, video.height, border),
            };
            studio.draw_over(camera, &frames[t], &behind)
        })
        .collect();
    let (result, coverage): (Vec<_>, Vec<_>) = drawn.into_iter().unzip();
    let object = if against.masks.len() >= n { against.masks[..n].to_vec() } else { coverage };
    Ok(Some(PicturePair { result, reference: against.video[..n].to_vec(), object }))
}
