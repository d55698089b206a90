//! The family of cue providers: each reads one kind of cue, from the pixels or from a file that another program made.
//!
//! A new provider is one file here and one word in [`PROVIDERS`].

mod at_video;
mod depth_files;
mod flow_tracks;
mod mask_files;
mod network_depth;
mod network_masks;
mod plain_masks;
mod silhouette_masks;
mod track_files;

pub use at_video::resized_tracks;
pub use depth_files::DepthFiles;
pub use flow_tracks::FlowTracks;
pub use mask_files::MaskFiles;
pub use network_depth::NetworkDepth;
pub use network_masks::NetworkMasks;
pub use plain_masks::PlainMasks;
pub use silhouette_masks::SilhouetteMasks;
pub use track_files::TrackFiles;

use super::Background;
use super::network::Network;
use crate::error::{Result, VideoError};
use animimic_scene::{Cues, DepthKind, Mask, Video};
use std::path::Path;

/// What providers may look at.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    /// The video at its working size.
    pub video: &'a Video,
    /// Silhouette of the object in frame 0, where it is known.
    pub silhouette: Option<&'a Mask>,
    /// The file or folder that another program made.
    pub file: Option<&'a Path>,
    /// The network that is to be run.
    pub network: Option<&'a Network>,
    /// What the depth in that file or of that network means, where the user says so.
    pub depth_kind: Option<DepthKind>,
}

impl<'a> Sources<'a> {
    /// A video alone.
    pub fn new(video: &'a Video) -> Self {
        Self { video, silhouette: None, file: None, network: None, depth_kind: None }
    }

    fn need_file(&self, provider: &dyn Provider) -> Result<&'a Path> {
        self.file.ok_or_else(|| VideoError::Caller(format!("{} needs a file to read", provider.name())))
    }

    fn need_network(&self, provider: &dyn Provider) -> Result<&'a Network> {
        self.network.ok_or_else(|| VideoError::Caller(format!("{} needs a network to run", provider.name())))
    }
}

/// What providers have found so far.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// The cues.
    pub cues: Cues,
    /// What lies behind the object; no frames in it where no provider looked.
    pub background: Background,
    /// Confidence in the masks, in \[0, 1\] \[frame\]; empty where no provider told.
    pub mask_confidence: Vec<f32>,
}

/// One way to get one kind of cue.
pub trait Provider: Sync {
    /// Kind and way, as `animimic list cues` prints it.
    fn name(&self) -> &'static str;
    /// One line on what it does.
    fn summary(&self) -> &'static str;
    /// Puts its cue into `found`.
    ///
    /// # Errors
    /// [`VideoError::Caller`] when a source that it needs is not there; unreadable or unfit files.
    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()>;
}

/// All providers, in the order in which they are listed.
pub const PROVIDERS: &[&dyn Provider] =
    &[&PlainMasks, &SilhouetteMasks, &MaskFiles, &NetworkMasks, &FlowTracks, &TrackFiles, &DepthFiles, &NetworkDepth];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cues::{write_depth, write_masks, write_tracks};
    use animimic_scene::{DepthMap, Image, Tracks};

    /// A dark square that moves right over a light plane, with its masks.
    fn scene() -> (Video, Vec<Mask>) {
        let (w, h) = (64, 48);
        let inside = |t: usize, i: usize| (20 + t..40 + t).contains(&(i % w)) && (14..34).contains(&(i / w));
        let picture = |t: usize| {
            let shade = |i: usize| if inside(t, i) { [60 + (i * 7 % 30) as u8, 40, 90] } else { [220; 3] };
            Image { width: w, height: h, rgb: (0..w * h).map(shade).collect() }
        };
        let mask = |t: usize| {
            let coverage = (0..w * h).map(|i| if inside(t, i) { 255 } else { 0 }).collect();
            Mask { width: w, height: h, coverage }
        };
        let frames = (0..4).map(picture).collect();
        (Video { fps: 24.0, frames, native_size: (w, h), ..Video::default() }, (0..4).map(mask).collect())
    }

    #[test]
    fn every_provider_brings_its_cue_for_every_frame_and_refuses_what_it_cannot_use() {
        let (video, masks) = scene();
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = |name: &str| folder.path().join(name);
        write_masks(&path("masks.npz"), &masks).expect("writes");
        let tracks =
            Tracks { pixels: vec![vec![[30.0, 24.0]]; 4], confidence: vec![vec![1.0]; 4], query_frame: vec![0] };
        write_tracks(&path("tracks.npz"), &tracks).expect("writes");
        let maps = vec![DepthMap { width: 4, height: 3, values: vec![2.0; 12] }; 4];
        write_depth(&path("depth.npz"), &maps, DepthKind::Metric).expect("writes");
        for provider in PROVIDERS {
            let (kind, way) = provider.name().split_once(':').expect("kind:way");
            assert!(
                !provider.summary().is_empty() && PROVIDERS.iter().filter(|p| p.name() == provider.name()).count() == 1
            );
            if way == "onnx" {
                // Networks have tests of their own.
                assert!(matches!(
                    provider.provide(&Sources::new(&video), &mut Found::default()),
                    Err(VideoError::Caller(_))
                ));
                continue;
            }
            let file = path(&format!("{kind}.npz"));
            let sources = Sources { silhouette: Some(&masks[0]), file: Some(&file), ..Sources::new(&video) };
            let mut found = Found::default();
            provider.provide(&sources, &mut found).expect("provides");
            let count = match kind {
                "masks" => found.cues.masks.len(),
                "tracks" => found.cues.tracks.pixels.len(),
                _ => found.cues.depth.len(),
            };
            assert_eq!(count, 4, "{}", provider.name());
            if kind == "masks" {
                let worst = found.cues.masks.iter().zip(&masks).map(|(a, b)| a.iou(b)).fold(1.0, f64::min);
                println!("{}: worst IoU {worst:.3}", provider.name());
                assert!(worst > 0.98);
            }
            let nothing = Sources::new(&video);
            if way == "file" || way == "silhouette" {
                assert!(matches!(provider.provide(&nothing, &mut Found::default()), Err(VideoError::Caller(_))));
            }
        }
    }
}
