//! A skeleton and skin weights for a model file: GLB or `rig.txt` out, and a picture to judge them by.

mod pictures;

pub use pictures::{Sheet, sheet, turntable};

use crate::event::{Event, Progress, tell};
use crate::{Error, pictures::Studio};
use animimic_rig::riggers::{self, RigOptions};
use animimic_scene::io::gltf::{ExportOptions, save_clips};
use animimic_scene::io::{self, obj, rig_txt};
use animimic_scene::{Asset, Rig};
use std::path::{Path, PathBuf};

/// The rigger that is used when none is named.
pub const DEFAULT_RIGGER: &str = "geometric";

/// Joints above which a skeleton is not solved: time and memory grow with their square, and no character has a tenth of it.
const MAX_JOINTS: usize = 2048;

/// What is asked for.
#[derive(Clone, Debug)]
pub struct RigJob {
    /// The model; a rig that it has is replaced.
    pub model: PathBuf,
    /// `.glb`, or `.txt` for RigNet's format.
    pub out: PathBuf,
    /// Name of the rigger.
    pub rigger: String,
    /// Level of detail, 1 to 5.
    pub detail: u8,
    /// File of the rig, for `from-file`.
    pub file: Option<PathBuf>,
    /// Picture (`.png`) or turntable (`.mp4`) of skeleton and weights.
    pub picture: Option<PathBuf>,
    /// Mend what is broken in small ways (indices and joints out of range, values that are not finite) instead of refusing.
    pub repair: bool,
}

/// What was made.
#[derive(Clone, Debug)]
pub struct RigReport {
    /// What made the rig: the rigger, or `one-bone` where it found no limbs.
    pub rigger: String,
    /// Names of the joints, parents first.
    pub joints: Vec<String>,
    /// Vertices of the model.
    pub vertices: usize,
}

impl RigReport {
    fn new(asset: &Asset, rigger: &str) -> Self {
        let joints: Vec<String> = asset.rig.skeleton.joints.iter().map(|j| j.name.clone()).collect();
        let rigger = if joints.len() == 1 { "one-bone" } else { rigger };
        Self { rigger: rigger.into(), joints, vertices: asset.mesh.positions.len() }
    }

    /// A flat JSON object.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "rigger": self.rigger, "joints": self.joints.len(), "vertices": self.vertices, "names": self.joints.join(" "),
        })
    }
}

/// Rigs a model and writes the files.
///
/// # Errors
/// An unknown rigger or file name, before any work; files that cannot be read or written; a model without a surface; a stop.
pub fn rig_files(job: &RigJob, progress: &mut Progress) -> Result<RigReport, Error> {
    let text = match extension(&job.out).as_str() {
        "glb" => false,
        "txt" => true,
        _ => return Err(Error::Input(format!("{}: name a .glb or .txt file", job.out.display()))),
    };
    if job.picture.as_deref().is_some_and(|p| !matches!(extension(p).as_str(), "png" | "mp4")) {
        return Err(Error::Input("the picture of a rig is a .png or .mp4 file".into()));
    }
    find(&job.rigger)?;
    tell(progress, Event::Stage { name: "reading" })?;
    let mut asset = io::read_with(&job.model, &io::ReadOptions { repair: job.repair })?;
    for warning in &asset.warnings {
        tell(progress, Event::Warning(warning.clone()))?;
    }
    tell(progress, Event::Stage { name: "rigging" })?;
    let raw_vertices = raw_vertices(&job.model)?;
    let options = RigOptions { detail: job.detail, file: job.file.clone(), raw_vertices: raw_vertices.clone() };
    let rig = make(&asset, &job.rigger, &options)?;
    riggers::attach(&mut asset, rig);
    tell(progress, Event::Stage { name: "writing" })?;
    if text {
        let rig = rig_txt::from_asset(&asset);
        let rig = raw_vertices.map_or_else(|| rig.clone(), |(raw, count)| rig_txt::per_raw_vertex(&rig, &raw, count));
        rig_txt::write(&job.out, &rig)?;
    } else {
        save_clips(&job.out, &asset, &[], &ExportOptions { keep_clips: false, ..Default::default() })?;
    }
    if let Some(picture) = &job.picture {
        tell(progress, Event::Stage { name: "drawing" })?;
        if extension(picture) == "png" {
            animimic_video::write_png(picture, &sheet(&asset)?)?;
        } else {
            turntable(&asset, picture, progress)?;
        }
    }
    Ok(RigReport::new(&asset, &job.rigger))
}

/// Which rig an animation is made with.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum RigChoice {
    /// The model's own; where it has none that bends it, one is made.
    #[default]
    Auto,
    /// The model's own, or an error.
    Keep,
    /// That of a file: a rigged GLB of the same shape, or RigNet's `rig.txt`.
    File(PathBuf),
}

impl std::str::FromStr for RigChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "auto" => Self::Auto,
            "keep" => Self::Keep,
            file => Self::File(file.into()),
        })
    }
}

/// Where a model's rig is from.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// In words.
    pub words: String,
    /// Whether it was made from the shape alone.
    pub made: bool,
}

/// Gives a model read from `path` the rig that was chosen, and says where it is from. A rig that was made is a warning of the
/// asset as well: it reaches the events and the report.
///
/// # Errors
/// No rig that bends the model where its own is to be kept; the rigger's own errors.
pub fn choose(asset: &mut Asset, path: &Path, choice: &RigChoice) -> Result<Chosen, Error> {
    let articulated = asset.rig.is_articulated();
    let joints = asset.rig.skeleton.joints.len();
    if articulated && joints > MAX_JOINTS && !matches!(choice, RigChoice::File(_)) {
        return Err(Error::Input(format!(
            "{}: a skeleton of {joints} joints, more than the {MAX_JOINTS} that are solved: make one with `animimic rig` or give --rig FILE",
            path.display()
        )));
    }
    let (rigger, file) = match choice {
        RigChoice::Auto | RigChoice::Keep if articulated => {
            return Ok(Chosen { words: "the model's own".into(), made: false });
        }
        RigChoice::Keep => {
            let what = "has no skeleton that bends it: leave out --rig keep, or give a rigged model";
            return Err(Error::Input(format!("{}: {what}", path.display())));
        }
        RigChoice::Auto => (DEFAULT_RIGGER, None),
        RigChoice::File(file) => ("from-file", Some(file.clone())),
    };
    let made = file.is_none();
    let options = RigOptions { file, raw_vertices: raw_vertices(path)?, ..RigOptions::default() };
    let rig = make(asset, rigger, &options)?;
    riggers::attach(asset, rig);
    let report = RigReport::new(asset, rigger);
    if made {
        asset.warnings.push(format!(
            "the model has no skeleton that bends it, so a skeleton with {} joints was made ({}); `animimic rig` shows it",
            report.joints.len(),
            report.rigger
        ));
    }
    Ok(Chosen { words: format!("{}, {} joints", report.rigger, report.joints.len()), made })
}

/// A rig for a model in memory.
///
/// # Errors
/// An unknown rigger, and the rigger's own.
pub fn make(asset: &Asset, rigger: &str, options: &RigOptions) -> Result<Rig, Error> {
    Ok(find(rigger)?.rig(asset, options)?)
}

fn find(name: &str) -> Result<&'static dyn riggers::Rigger, Error> {
    riggers::rigger(name)
        .ok_or_else(|| Error::Input(format!("no rigger is called {name:?}; `animimic list riggers` names them")))
}

/// How a `rig.txt` counts the vertices of a model read from an OBJ; `None` for other formats.
fn raw_vertices(model: &Path) -> Result<Option<(Vec<u32>, usize)>, Error> {
    let path = if model.is_dir() { model.join("objs").join("mesh.obj") } else { model.to_owned() };
    if extension(&path) != "obj" {
        return Ok(None);
    }
    Ok(Some(obj::raw_vertices(path)?))
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// The model in one grey, for pictures in which the skeleton is what matters.
fn plain_studio(asset: &Asset) -> Result<Studio, Error> {
    Studio::with_light(asset, animimic_render::Light::default())
}
