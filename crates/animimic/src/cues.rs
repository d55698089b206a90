//! Cues of a video as files: masks, tracks and depth for programs, `overlay.mp4` to look at.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::{DepthKind, Image, Mask, Video};
use animimic_video::cues;
pub use animimic_video::cues::network::{CueSource, Gives, SCHEME};
use animimic_video::cues::providers::{
    DepthFiles, FlowTracks, Found, MaskFiles, NetworkDepth, NetworkMasks, PlainMasks, Provider, SilhouetteMasks,
    Sources, TrackFiles, resized_tracks,
};
use animimic_video::flow::{FlowOptions, Gray, dis};
use std::path::Path;

/// How masks and depth are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// One NumPy archive for all frames: `masks.npz`, `depth.npz`.
    #[default]
    Npz,
    /// A folder of numbered PNGs: `masks/` (8 bits), `depth/` (16 bits, scaled to the largest value).
    Png,
}

/// Finds the cues of a video, or takes them from files of other programs, and writes masks, tracks, depth (where given) and `overlay.mp4`;
/// returns statistics.
///
/// # Errors
/// Unreadable video or files, files for another number of frames, unwritable folder, or a stop.
pub fn write(
    video: &Path,
    height_px: usize,
    given: &Given,
    form: Form,
    folder: &Path,
    progress: &mut Progress,
) -> Result<serde_json::Value, Error> {
    tell(progress, Event::Stage { name: "reading" })?;
    let options = animimic_video::ReadOptions { working_height: Some(height_px), ..Default::default() };
    let video = animimic_video::read(video, &options)?;
    for warning in &video.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    tell(progress, Event::Stage { name: "masks" })?;
    let mut found = find(&video, given)?;
    tell(progress, Event::Stage { name: "tracks" })?;
    if given.tracks.is_none() {
        FlowTracks.provide(&Sources::new(&video), &mut found)?;
    }
    tell(progress, Event::Stage { name: "writing" })?;
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let place = |name: &str| folder.join(if form == Form::Npz { format!("{name}.npz") } else { name.to_owned() });
    cues::write_masks(&place("masks"), &found.cues.masks)?;
    // Files hold pixels of the video's own size, whatever size was worked at.
    let (tracks, working_size) = (&found.cues.tracks, (video.frames[0].width, video.frames[0].height));
    cues::write_tracks(&folder.join("tracks.npz"), &resized_tracks(tracks, working_size, video.native_size))?;
    if !found.cues.depth.is_empty() {
        cues::write_depth(&place("depth"), &found.cues.depth, found.cues.depth_kind)?;
    }
    let seen = tracks.confidence.iter().flatten().filter(|c| **c > 0.0).count();
    let confidence = found.mask_confidence.iter().copied().fold(1.0, f32::min);
    let statistics = serde_json::json!({
        "frames": video.frames.len(), "fps": video.fps,
        "points": tracks.query_frame.len(), "points_per_frame": seen as f64 / video.frames.len() as f64,
        "mask_confidence_min": confidence, "depth_maps": found.cues.depth.len(),
    });
    let mut frames = cues::overlay(&video, &found.cues).into_iter();
    animimic_video::write_mp4(&folder.join("overlay.mp4"), &mut frames, video.fps)?;
    Ok(statistics)
}

/// The dense flow that cameras and motions are found with: displacements [px] from one picture to another.
pub fn dense_flow(from: &Image, to: &Image) -> Vec<[f32; 2]> {
    dis(&Gray::from_image(from), &Gray::from_image(to), &FlowOptions::default()).vectors
}

/// Which ways the cues of one video are found: masks in any case, tracks and depth where they are given.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given<'a> {
    /// Masks made elsewhere, or by a network.
    pub masks: Option<&'a CueSource>,
    /// Point tracks made elsewhere.
    pub tracks: Option<&'a Path>,
    /// Depth made elsewhere, or by a network.
    pub depth: Option<&'a CueSource>,
    /// What that depth means, where its file does not say so or is wrong.
    pub depth_kind: Option<DepthKind>,
}

/// Cues of a video for the main job: files and networks where given, else masks on a plain background.
///
/// # Errors
/// Unreadable files, files for another number of frames than the video has, or networks that cannot be run.
pub fn find(video: &Video, given: &Given) -> Result<Found, Error> {
    let mut found = Found::default();
    let sources = |file| Sources { file, ..Sources::new(video) };
    let run = |network| Sources { network: Some(network), ..Sources::new(video) };
    PlainMasks.provide(&sources(None), &mut found)?;
    match given.masks {
        Some(CueSource::File(path)) => MaskFiles.provide(&sources(Some(path.as_path())), &mut found)?,
        Some(CueSource::Network(network)) => NetworkMasks.provide(&run(network), &mut found)?,
        None => {}
    }
    if given.tracks.is_some() {
        TrackFiles.provide(&sources(given.tracks), &mut found)?;
    }
    let meant = |sources| Sources { depth_kind: given.depth_kind, ..sources };
    match given.depth {
        Some(CueSource::File(path)) => DepthFiles.provide(&meant(sources(Some(path))), &mut found)?,
        Some(CueSource::Network(network)) => NetworkDepth.provide(&meant(run(network)), &mut found)?,
        None => {}
    }
    Ok(found)
}

/// Overlap of the silhouette with what frame 0 shows below which it is not where the object is.
const FITTING_IOU: f64 = 0.5;

/// Finds the masks again, from the model's silhouette in frame 0; leaves them where the silhouette is not where the object
/// is, or where the video's own alpha tells.
///
/// # Errors
/// A silhouette of another size than the video.
pub fn refine_masks(video: &Video, silhouette: &Mask, found: &mut Found) -> Result<(), Error> {
    let plain = found.background.residual.iter().copied().fold(0.0, f64::max) < PLAIN_RESIDUAL;
    let misplaced = plain && found.cues.masks.first().is_some_and(|m| m.iou(silhouette) < FITTING_IOU);
    if silhouette.area() == 0 || misplaced || video.alpha.len() == video.frames.len() {
        return Ok(());
    }
    SilhouetteMasks.provide(&Sources { silhouette: Some(silhouette), ..Sources::new(video) }, found)?;
    Ok(())
}

/// Residual at the border below which the background is plain for sure, so that the masks found on it may judge [levels].
const PLAIN_RESIDUAL: f64 = 4.0;
