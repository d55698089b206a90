//! Morph targets before the skin.

use super::{Delivered, Delivery, Encoding};
use crate::Error;
use animimic_rig::morphs::{self, Settings};
use animimic_scene::Motion;
use animimic_scene::io::gltf::{ExportOptions, Morphs, save_clips};

pub struct Targets;

impl Encoding for Targets {
    fn name(&self) -> &'static str {
        "morph"
    }

    fn summary(&self) -> &'static str {
        "up to 8 morph targets with weights in [0, 1]; the skeleton keeps its weights"
    }

    fn write(&self, work: &Delivery) -> Result<Delivered, Error> {
        let asset = work.asset;
        let morphed = morphs::fit(&asset.rig, &asset.mesh, work.clips, &Settings::default())?;
        let motions: Vec<Motion> = work.clips.iter().map(|c| c.motion.clone()).collect();
        let targets = morphed.offsets.len();
        let names = (1..=targets).map(|k| format!("soft_{k}")).collect();
        let morphs = Morphs { names, offsets: morphed.offsets, weights: morphed.weights };
        let options = ExportOptions { morphs: (targets > 0).then_some(morphs), ..work.options.clone() };
        save_clips(work.glb, asset, &motions, &options)?;
        Ok(Delivered {
            encoding: self.name(),
            carrier: if targets == 0 { String::new() } else { format!("{targets} morph targets") },
            skinned: morphed.skinned,
            residual: morphed.residual,
            bytes: 0,
            files: vec![work.glb.to_owned()],
        })
    }
}
