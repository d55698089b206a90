use super::{Found, Provider, Sources};
use crate::error::Result;

/// Masks by a network that the user names.
pub struct NetworkMasks;

impl Provider for NetworkMasks {
    fn name(&self) -> &'static str {
        "masks:onnx"
    }

    fn summary(&self) -> &'static str {
        "masks by a neural network, --mask onnx:FILE[:u2net|isnet]; in builds with the feature neural"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        found.cues.masks = sources.need_network(self)?.masks(sources.video)?;
        Ok(())
    }
}
