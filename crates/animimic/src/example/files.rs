//! The example as files, and its truth in the form that [`crate::truth`] reads.

use super::{Example, creature, film, surfaces};
use crate::Error;
use crate::event::{Event, Progress, tell};
use crate::pictures::silhouette;
use animimic_scene::io::gltf::{ExportOptions, save_clips};
use animimic_scene::io::npz::{self, Archive, Array, Values};
use animimic_scene::{Camera, io};
use glam::DVec3;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `creature.glb`, `creature.mp4` and `camera.json`, and with `truth` the folder `truth`; returns the files.
///
/// # Errors
/// An unwritable folder, or a stop.
pub fn write(folder: &Path, truth: bool, progress: &mut Progress) -> Result<Vec<PathBuf>, Error> {
    tell(progress, Event::Stage { name: "making the creature" })?;
    let example = creature();
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let [model, video, camera] = ["creature.glb", "creature.mp4", "camera.json"].map(|name| folder.join(name));
    save_clips(&model, &example.asset, &[], &ExportOptions::default())?;
    io::camera_json::write(&camera, &example.camera)?;
    tell(progress, Event::Stage { name: "simulating" })?;
    let surfaces = surfaces(&example)?;
    tell(progress, Event::Stage { name: "filming" })?;
    animimic_video::write_mp4(&video, &mut film(&example, &surfaces)?, example.motion.fps)?;
    let mut files = vec![model.clone(), video, camera.clone()];
    if truth {
        tell(progress, Event::Stage { name: "truth" })?;
        files.extend(write_truth(&folder.join("truth"), &example, &surfaces, &model)?);
    }
    Ok(files)
}

fn write_truth(folder: &Path, example: &Example, vertices: &[Vec<DVec3>], model: &Path) -> Result<Vec<PathBuf>, Error> {
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let [gt, masks, meta, camera, still] =
        ["gt.npz", "masks.npz", "meta.json", "camera.json", "static.glb"].map(|name| folder.join(name));
    let rig = &example.asset.rig;
    let world: Vec<_> = example.motion.poses.iter().map(|p| rig.skeleton.world_from_joint(&p.locals)).collect();
    let joints: Vec<Vec<DVec3>> = world.iter().map(|w| w.iter().map(|j| j.translation).collect()).collect();
    let count = vertices[0].len();
    let array = |shape: &[usize], values| Array { shape: shape.to_vec(), values };
    let points = |p: &[Vec<DVec3>]| {
        array(&[p.len(), p[0].len(), 3], Values::F32(p.iter().flatten().flat_map(|x| x.as_vec3().to_array()).collect()))
    };
    let arrays = vec![
        ("verts_unique".into(), points(vertices)),
        ("vert_to_unique".into(), array(&[count], Values::U32((0..count as u32).collect()))),
        ("joint_pos".into(), points(&joints)),
        (
            "faces".into(),
            array(
                &[example.asset.mesh.triangles.len(), 3],
                Values::U32(example.asset.mesh.triangles.iter().flatten().copied().collect()),
            ),
        ),
    ];
    npz::write(&gt, &Archive { arrays })?;
    npz::write(&masks, &Archive { arrays: views(example, vertices) })?;
    // Nodes as the GLB numbers them: names are unique, so the reader finds the joints by name.
    let names: Vec<_> = rig.skeleton.joints.iter().map(|j| serde_json::json!({"name": j.name})).collect();
    let json = serde_json::json!({"joints": names, "parts": [{"name": "creature", "count": count}]}).to_string();
    io::write_atomically(&meta, |w| w.write_all(json.as_bytes()))?;
    io::camera_json::write(&camera, &example.camera)?;
    let bytes = std::fs::read(model).map_err(Error::io(model))?;
    io::write_atomically(&still, |w| w.write_all(&bytes))?;
    Ok(vec![gt, masks, meta, camera, still])
}

/// Silhouettes in all views as packed bits.
fn views(example: &Example, vertices: &[Vec<DVec3>]) -> Vec<(String, Array)> {
    let file = &example.camera;
    let all = std::iter::once(("main", file.main)).chain(file.views.iter().map(|(n, c)| (n.as_str(), *c)));
    all.map(|(name, camera): (&str, Camera)| {
        let masks: Vec<_> = vertices.iter().map(|x| silhouette(&camera, &example.asset.mesh, x)).collect();
        let packed = animimic_video::cues::packed_bits(&masks);
        let (frames, height, bytes) = (masks.len(), camera.height as usize, (camera.width as usize).div_ceil(8));
        (name.to_owned(), Array { shape: vec![frames, height, bytes], values: Values::U8(packed) })
    })
    .collect()
}
