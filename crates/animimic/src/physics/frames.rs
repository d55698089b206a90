//! A mesh per frame.

use super::none::base_clips;
use super::{Delivered, Delivery, Encoding, beside, skinned};
use crate::Error;
use animimic_rig::Residual;
use animimic_rig::helpers::surface;
use animimic_scene::io::trajectory::write_obj;

pub struct Frames;

impl Encoding for Frames {
    fn name(&self) -> &'static str {
        "frames"
    }

    fn summary(&self) -> &'static str {
        "a numbered OBJ per frame beside the GLB, which has the skeleton's motion; exact"
    }

    fn write(&self, work: &Delivery) -> Result<Delivered, Error> {
        let lost = skinned(work);
        base_clips(work)?;
        let mut files = vec![work.glb.to_owned()];
        for clip in work.clips {
            let folder = beside(work.glb, "frames", &clip.motion.name, "");
            std::fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
            let surface = surface(&work.asset.rig, clip);
            for (f, frame) in surface.frames.iter().enumerate() {
                let file = folder.join(format!("{:04}.obj", f + 1));
                write_obj(&file, work.asset, frame)?;
                files.push(file);
            }
        }
        let carrier = format!("{} OBJ files", files.len() - 1);
        Ok(Delivered { encoding: self.name(), carrier, skinned: lost, residual: Residual::default(), bytes: 0, files })
    }
}
