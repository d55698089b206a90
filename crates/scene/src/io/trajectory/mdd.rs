//! MDD, LightWave's point cache: frames, points, the time of each frame [s]; then all points; everything big-endian.

use super::CacheFormat;
use crate::{Asset, Trajectory};
use std::io::Write;

pub struct Mdd;

impl CacheFormat for Mdd {
    fn extension(&self) -> &'static str {
        "mdd"
    }

    fn write(&self, out: &mut dyn Write, asset: &Asset, trajectory: &Trajectory) -> std::io::Result<()> {
        out.write_all(&(trajectory.frames.len() as i32).to_be_bytes())?;
        out.write_all(&(asset.mesh.positions.len() as i32).to_be_bytes())?;
        for f in 0..trajectory.frames.len() {
            out.write_all(&((f as f64 / trajectory.fps) as f32).to_be_bytes())?;
        }
        for p in trajectory.frames.iter().flatten() {
            out.write_all(bytemuck::bytes_of(&p.as_vec3().to_array().map(f32::to_be_bytes)))?;
        }
        Ok(())
    }
}
