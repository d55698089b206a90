//! PC2, Maya's and 3ds Max' point cache: "POINTCACHE2", version, points, first frame, sample rate, samples; then little-endian floats.

use super::CacheFormat;
use crate::{Asset, Trajectory};
use std::io::Write;

pub struct Pc2;

impl CacheFormat for Pc2 {
    fn extension(&self) -> &'static str {
        "pc2"
    }

    fn write(&self, out: &mut dyn Write, asset: &Asset, trajectory: &Trajectory) -> std::io::Result<()> {
        out.write_all(b"POINTCACHE2\0")?;
        out.write_all(&1i32.to_le_bytes())?;
        out.write_all(&(asset.mesh.positions.len() as i32).to_le_bytes())?;
        // First frame, and frames per sample.
        out.write_all(&0f32.to_le_bytes())?;
        out.write_all(&1f32.to_le_bytes())?;
        out.write_all(&(trajectory.frames.len() as i32).to_le_bytes())?;
        for p in trajectory.frames.iter().flatten() {
            out.write_all(bytemuck::bytes_of(&p.as_vec3().to_array().map(f32::to_le_bytes)))?;
        }
        Ok(())
    }
}
