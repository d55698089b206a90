//! How families of networks are fed: a new family is one entry here.

/// What a network gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gives {
    /// Where the object is.
    Masks,
    /// Inverse depth (disparity), up to scale and shift.
    Depth,
}

impl Gives {
    /// Its word in messages and names of providers.
    pub fn word(self) -> &'static str {
        match self {
            Self::Masks => "masks",
            Self::Depth => "depth",
        }
    }
}

/// A family of networks that are fed alike: \[1,3,H,W\] of (RGB/255 − mean)/deviation.
#[derive(Debug, PartialEq)]
pub struct Preset {
    /// Its word on the command line.
    pub name: &'static str,
    /// What it gives.
    pub gives: Gives,
    /// Side of the picture where the file does not fix it [px].
    pub side: usize,
    /// Where given, the picture keeps its shape: `side` is the shorter side, and both are multiples of this. Else it is a square.
    pub multiple: Option<usize>,
    /// Mean of each channel.
    pub mean: [f32; 3],
    /// Standard deviation of each channel.
    pub deviation: [f32; 3],
}

/// Mean and deviation of ImageNet's pictures.
const IMAGENET: ([f32; 3], [f32; 3]) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);

/// All families.
pub const PRESETS: &[Preset] = &[
    // Qin et al. 2020; u2netp and its kin are fed alike.
    Preset { name: "u2net", gives: Gives::Masks, side: 320, multiple: None, mean: IMAGENET.0, deviation: IMAGENET.1 },
    // Qin et al. 2022 (DIS).
    Preset { name: "isnet", gives: Gives::Masks, side: 1024, multiple: None, mean: [0.5; 3], deviation: [1.0; 3] },
    // Ranftl et al. 2020, the small convolutional network.
    Preset {
        name: "midas",
        gives: Gives::Depth,
        side: 256,
        multiple: Some(32),
        mean: IMAGENET.0,
        deviation: IMAGENET.1,
    },
    // Yang et al. 2024, both versions.
    Preset {
        name: "depth-anything",
        gives: Gives::Depth,
        side: 518,
        multiple: Some(14),
        mean: IMAGENET.0,
        deviation: IMAGENET.1,
    },
];

impl Preset {
    /// Width and height [px] at which a picture of that size is shown to a network whose file fixes neither.
    #[cfg_attr(not(feature = "neural"), expect(dead_code, reason = "only the runtime asks"))]
    pub(super) fn size(&self, (width, height): (usize, usize)) -> (usize, usize) {
        let Some(multiple) = self.multiple else { return (self.side, self.side) };
        let scale = self.side as f64 / width.min(height) as f64;
        let rounded = |n: usize| ((n as f64 * scale / multiple as f64).round() as usize).max(1) * multiple;
        (rounded(width), rounded(height))
    }
}
