//! Point caches.

use super::none::base_clips;
use super::{Delivered, Delivery, Encoding, beside, skinned};
use crate::Error;
use animimic_rig::Residual;
use animimic_rig::helpers::surface;
use animimic_scene::io::trajectory::{CACHE_FORMATS, save, write_obj};

pub struct Cache;

impl Encoding for Cache {
    fn name(&self) -> &'static str {
        "cache"
    }

    fn summary(&self) -> &'static str {
        "PC2, MDD and USD point caches beside the GLB, with rest.obj in their vertex order; exact"
    }

    fn write(&self, work: &Delivery) -> Result<Delivered, Error> {
        let lost = skinned(work);
        base_clips(work)?;
        let rest = work.glb.with_file_name("rest.obj");
        write_obj(&rest, work.asset, &work.asset.mesh.positions)?;
        let mut files = vec![work.glb.to_owned(), rest];
        for clip in work.clips {
            let surface = surface(&work.asset.rig, clip);
            for format in CACHE_FORMATS {
                let file = beside(work.glb, "cache", &clip.motion.name, &format!(".{}", format.extension()));
                save(*format, &file, work.asset, &surface)?;
                files.push(file);
            }
        }
        let names: Vec<String> = CACHE_FORMATS.iter().map(|f| f.extension().to_uppercase()).collect();
        let carrier = names.join(", ");
        Ok(Delivered { encoding: self.name(), carrier, skinned: lost, residual: Residual::default(), bytes: 0, files })
    }
}
