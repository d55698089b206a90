//! Helper bones: the clip stays an ordinary skinned clip.

use super::{Delivered, Delivery, Encoding};
use crate::Error;
use animimic_rig::helpers::{self, Settings};
use animimic_scene::io::gltf::{ExportOptions, clips, save_clips};
use animimic_scene::{Asset, Refined};

pub struct Helpers;

impl Encoding for Helpers {
    fn name(&self) -> &'static str {
        "rig"
    }

    fn summary(&self) -> &'static str {
        "up to 32 helper bones under the given ones, 4 influences: plays and edits everywhere"
    }

    fn write(&self, work: &Delivery) -> Result<Delivered, Error> {
        let (asset, count) = (work.asset, work.clips.len());
        let mut all = work.clips.to_vec();
        if work.options.keep_clips && all.iter().any(|c| c.trajectory.is_some()) {
            // New weights move the surface of the file's own clips too: they are held where they were.
            let fps = all[0].motion.fps;
            for clip in clips(asset)? {
                all.push(Refined { motion: clip.motion(&asset.rig.skeleton, fps)?, trajectory: None });
            }
        }
        let helped = helpers::fit(&asset.rig, &asset.mesh, &all, &Settings::default())?;
        let mut motions = helped.motions;
        let kept = motions.split_off(count);
        let options =
            ExportOptions { kept: if helped.helpers > 0 { kept } else { Vec::new() }, ..work.options.clone() };
        if helped.helpers > 0 {
            let asset = Asset { rig: helped.rig, ..asset.clone() };
            save_clips(work.glb, &asset, &motions, &options)?;
        } else {
            save_clips(work.glb, asset, &motions, &options)?;
        }
        let carrier = match helped.helpers {
            0 => String::new(),
            1 => "1 helper bone".into(),
            n => format!("{n} helper bones"),
        };
        let files = vec![work.glb.to_owned()];
        let (skinned, residual) = (helped.skinned, helped.residual);
        Ok(Delivered { encoding: self.name(), carrier, skinned, residual, bytes: 0, files })
    }
}
