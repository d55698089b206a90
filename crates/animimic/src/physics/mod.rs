//! Refined motion as files: how a clip whose surface goes beyond its skeleton is delivered.
//!
//! A new way is one file with a type that implements [`Encoding`], and one word in [`ENCODINGS`].

mod cache;
mod frames;
mod morph;
mod none;
mod rig;

use crate::Error;
use animimic_rig::Residual;
use animimic_scene::io::gltf::ExportOptions;
use animimic_scene::{Asset, Refined};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// What is to be delivered.
pub struct Delivery<'a> {
    /// The model as it was read.
    pub asset: &'a Asset,
    /// Its clips.
    pub clips: &'a [Refined],
    /// The GLB to write; files that go with it appear beside it.
    pub glb: &'a Path,
    /// What else goes into the GLB.
    pub options: ExportOptions,
}

/// What was written, and what it lost.
#[derive(Clone, Debug)]
pub struct Delivered {
    /// Name of the encoding.
    pub encoding: &'static str,
    /// What was added to carry the motion, in words, such as "4 helper bones"; empty if nothing was.
    pub carrier: String,
    /// Distance of the clips' surfaces from the base skin [share of the rest diagonal].
    pub skinned: Residual,
    /// Distance of the clips' surfaces from what the files play.
    pub residual: Residual,
    /// Size of all files [bytes].
    pub bytes: u64,
    /// The files.
    pub files: Vec<PathBuf>,
}

impl Delivered {
    /// A flat JSON object.
    pub fn to_json(&self) -> Value {
        let percent = |r: &Residual| json!({ "rms": 100.0 * r.rms, "p99": 100.0 * r.p99, "max": 100.0 * r.largest });
        json!({
            "encoding": self.encoding, "carrier": self.carrier, "bytes": self.bytes,
            "skinned_percent": percent(&self.skinned), "residual_percent": percent(&self.residual),
            "files": self.files.iter().filter_map(|f| f.file_name()).map(|f| f.to_string_lossy()).collect::<Vec<_>>(),
        })
    }

    /// One line for people.
    pub fn words(&self) -> String {
        let carrier = if self.carrier.is_empty() { String::new() } else { format!(" ({})", self.carrier) };
        let r = &self.residual;
        format!(
            "physics as {}{carrier}: residual rms {:.3} %, p99 {:.3} % of the diagonal, {:.2} MB",
            self.encoding,
            100.0 * r.rms,
            100.0 * r.p99,
            self.bytes as f64 / 1e6
        )
    }
}

/// One way to deliver refined motion.
pub trait Encoding: Sync {
    /// Name on the command line and in `animimic list physics`.
    fn name(&self) -> &'static str;
    /// What it does, in one line.
    fn summary(&self) -> &'static str;
    /// Writes the GLB and what goes with it; `bytes` is filled in by [`deliver`].
    ///
    /// # Errors
    /// Files that cannot be written; trajectories that do not belong to the model.
    fn write(&self, work: &Delivery) -> Result<Delivered, Error>;
}

/// All ways, the default first.
pub const ENCODINGS: &[&dyn Encoding] = &[&rig::Helpers, &morph::Targets, &frames::Frames, &cache::Cache, &none::Base];

/// A chosen way.
#[derive(Clone, Copy)]
pub struct Physics(&'static dyn Encoding);

impl Physics {
    /// The skeleton's motion alone.
    pub const NONE: Self = Self(&none::Base);

    /// Its name.
    pub fn name(self) -> &'static str {
        self.0.name()
    }
}

impl Default for Physics {
    fn default() -> Self {
        Self(ENCODINGS[0])
    }
}

impl PartialEq for Physics {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl std::fmt::Debug for Physics {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::fmt::Display for Physics {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Physics {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = ENCODINGS.iter().find(|e| e.name() == text);
        found.map(|e| Self(*e)).ok_or_else(|| {
            let names: Vec<&str> = ENCODINGS.iter().map(|e| e.name()).collect();
            format!("there is no encoding {text}: use one of {}", names.join(", "))
        })
    }
}

/// Writes the model with its clips in the chosen way. Clips without trajectory are played by the skeleton in any.
///
/// # Errors
/// Files that cannot be written; trajectories that do not belong to the model.
pub fn deliver(physics: Physics, work: &Delivery) -> Result<Delivered, Error> {
    let mut delivered = physics.0.write(work)?;
    for file in &delivered.files {
        delivered.bytes += std::fs::metadata(file).map_err(Error::io(file))?.len();
    }
    Ok(delivered)
}

/// What the base skin leaves of the clips.
fn skinned(work: &Delivery) -> Residual {
    let rig = &work.asset.rig;
    let moved: Vec<&Refined> = work.clips.iter().filter(|c| c.trajectory.is_some()).collect();
    if moved.is_empty() {
        return Residual::default();
    }
    let surfaces: Vec<_> = work.clips.iter().map(|c| animimic_rig::helpers::surface(rig, c)).collect();
    let clips = work.clips.iter().map(|c| &c.motion).zip(surfaces.iter().map(|s| &**s));
    Residual::of_clips(rig, work.asset.mesh.diagonal(), clips)
}

/// A file beside the GLB, named after a clip.
fn beside(glb: &Path, stem: &str, clip: &str, end: &str) -> PathBuf {
    let safe: String = clip.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' }).collect();
    glb.with_file_name(format!("{stem}-{safe}{end}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_is_found_by_its_name_and_no_other() {
        for e in ENCODINGS {
            assert_eq!(e.name().parse::<Physics>().map(Physics::name), Ok(e.name()));
        }
        assert_eq!(Physics::default().name(), "rig");
        let error = "alembic".parse::<Physics>().expect_err("there is none");
        assert!(error.contains("rig, morph, frames, cache, none"), "{error}");
    }
}
