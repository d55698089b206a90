//! What is read from a video: masks, point tracks, depth, each with confidence.

use crate::Mask;

/// Everything that is known about a video apart from its pixels.
#[derive(Clone, Debug, Default)]
pub struct Cues {
    /// Object coverage \[frame\]; empty if unknown.
    pub masks: Vec<Mask>,
    /// Point tracks.
    pub tracks: Tracks,
    /// Depth maps \[frame\]; empty if unknown.
    pub depth: Vec<DepthMap>,
    /// What the depth values mean.
    pub depth_kind: DepthKind,
}

/// Points followed through the video.
#[derive(Clone, Debug, Default)]
pub struct Tracks {
    /// Pixel positions \[frame\]\[point\] (pixel centres at +0.5).
    pub pixels: Vec<Vec<[f32; 2]>>,
    /// Confidence in \[0, 1\], \[frame\]\[point\]; 0 where the point is not seen.
    pub confidence: Vec<Vec<f32>>,
    /// Frame in which each point was sampled \[point\].
    pub query_frame: Vec<u32>,
}

/// What depth values mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthKind {
    /// z along the camera axis, unknown scale and shift per frame.
    #[default]
    Metric,
    /// 1/z (disparity), unknown scale and shift per frame.
    Inverse,
}

/// Depth of the object; NaN where there is none.
#[derive(Clone, Debug, Default)]
pub struct DepthMap {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Values, `[y * width + x]`; NaN outside the object.
    pub values: Vec<f32>,
}
