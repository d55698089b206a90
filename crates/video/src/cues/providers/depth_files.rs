use super::at_video::picked;
use super::{Found, Provider, Sources};
use crate::cues::read_depth;
use crate::error::Result;

/// Depth made elsewhere, of any size, picked by the source's frame numbers.
pub struct DepthFiles;

impl Provider for DepthFiles {
    fn name(&self) -> &'static str {
        "depth:file"
    }

    fn summary(&self) -> &'static str {
        "depth of another program, up to scale and shift per frame: npz or a folder of 16-bit PNGs or EXRs"
    }

    fn provide(&self, sources: &Sources, found: &mut Found) -> Result<()> {
        let path = sources.need_file(self)?;
        let (maps, kind) = read_depth(path, sources.depth_kind)?;
        let numbers = picked(sources.video, path, maps.len(), "depth maps")?;
        found.cues.depth = numbers.into_iter().map(|k| maps[k].clone()).collect();
        found.cues.depth_kind = kind;
        Ok(())
    }
}
