use super::{Found, Provider, Sources};
use crate::cues::{TrackOptions, tracks};
use crate::error::Result;

/// Point tracks by chained optical flow on what the masks found so far show.
pub struct FlowTracks;

impl Provider for FlowTracks {
    fn name(&self) -> &'static str {
        "tracks:flow"
    }

    fn summary(&self) -> &'static str {
        "points on the masks followed by dense inverse search, checked there and back"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        found.cues.tracks = tracks(sources.video, &found.cues.masks, &TrackOptions::default());
        Ok(())
    }
}
