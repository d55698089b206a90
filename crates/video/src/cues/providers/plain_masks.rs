use super::{Found, Provider, Sources};
use crate::cues::{MaskCue, MaskOptions, masks};
use crate::error::Result;

/// Masks on a plain background, or from the video's own alpha.
pub struct PlainMasks;

/// Puts masks and what they rest on into place.
pub(super) fn take(cue: MaskCue, found: &mut Found) {
    (found.cues.masks, found.background, found.mask_confidence) = (cue.masks, cue.background, cue.confidence);
}

impl Provider for PlainMasks {
    fn name(&self) -> &'static str {
        "masks:plain"
    }

    fn summary(&self) -> &'static str {
        "what differs from a plain background; the video's own alpha where it has one"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        take(masks(sources.video, &MaskOptions::default()), found);
        Ok(())
    }
}
