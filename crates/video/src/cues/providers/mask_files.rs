use super::at_video::picked;
use super::{Found, Provider, Sources};
use crate::cues::read_masks;
use crate::error::Result;

/// Masks made elsewhere, picked by the source's frame numbers and brought to the video's working size.
pub struct MaskFiles;

impl Provider for MaskFiles {
    fn name(&self) -> &'static str {
        "masks:file"
    }

    fn summary(&self) -> &'static str {
        "masks of another program: npz or a folder of PNGs"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        let path = sources.need_file(self)?;
        let masks = read_masks(path)?;
        let numbers = picked(sources.video, path, masks.len(), "masks")?;
        let like = &sources.video.frames[0];
        found.cues.masks = numbers.into_iter().map(|k| masks[k].resized(like.width, like.height)).collect();
        Ok(())
    }
}
