//! The skeleton's motion alone.

use super::{Delivered, Delivery, Encoding, skinned};
use crate::Error;
use animimic_scene::Motion;
use animimic_scene::io::gltf::save_clips;

pub struct Base;

impl Encoding for Base {
    fn name(&self) -> &'static str {
        "none"
    }

    fn summary(&self) -> &'static str {
        "the skeleton's motion alone; what goes beyond it is lost"
    }

    fn write(&self, work: &Delivery) -> Result<Delivered, Error> {
        base_clips(work)?;
        let lost = skinned(work);
        let files = vec![work.glb.to_owned()];
        Ok(Delivered { encoding: self.name(), carrier: String::new(), skinned: lost, residual: lost, bytes: 0, files })
    }
}

/// Writes the GLB with the skeleton's motion.
pub fn base_clips(work: &Delivery) -> Result<(), Error> {
    let motions: Vec<Motion> = work.clips.iter().map(|c| c.motion.clone()).collect();
    Ok(save_clips(work.glb, work.asset, &motions, &work.options)?)
}
