use super::{Found, Provider, Sources};
use crate::error::Result;
use animimic_scene::DepthKind;

/// Depth by a network that the user names.
pub struct NetworkDepth;

impl Provider for NetworkDepth {
    fn name(&self) -> &'static str {
        "depth:onnx"
    }

    fn summary(&self) -> &'static str {
        "inverse depth by a neural network, --depth onnx:FILE[:midas|depth-anything]; in builds with the feature neural"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        found.cues.depth = sources.need_network(self)?.depth(sources.video)?;
        found.cues.depth_kind = sources.depth_kind.unwrap_or(DepthKind::Inverse);
        Ok(())
    }
}
