use super::plain_masks::take;
use super::{Found, Provider, Sources};
use crate::cues::{MaskOptions, masks_with_prior};
use crate::error::{Result, VideoError};

/// Masks that grow from the known silhouette of frame 0, on any background.
pub struct SilhouetteMasks;

impl Provider for SilhouetteMasks {
    fn name(&self) -> &'static str {
        "masks:silhouette"
    }

    fn summary(&self) -> &'static str {
        "a minimum cut per frame from the model's silhouette in frame 0, carried on by optical flow; any background"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        let first = sources
            .silhouette
            .ok_or_else(|| VideoError::Caller(format!("{} needs the silhouette of frame 0", self.name())))?;
        take(masks_with_prior(sources.video, first, &MaskOptions::default())?, found);
        Ok(())
    }
}
