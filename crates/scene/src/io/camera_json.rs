//! `camera.json`: intrinsics, frame rate and OpenCV world-to-camera matrices of named views.
//!
//! Required: `width, height, fps, fx, fy, cx, cy, views.main.world_to_camera_opencv` (4×4, row-major); other views share the intrinsics
//! unless they state their own; everything else is ignored.

use super::{SceneError, load, write_atomically};
use crate::{Camera, CameraFile};
use glam::{DAffine3, DMat3, DMat4, DVec3};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// A rotation may deviate from orthonormality by this much (files are written with six or more digits).
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Largest image side that is believed [px].
const MAX_SIDE: f64 = 65_536.0;

/// Reads a `camera.json`.
///
/// # Errors
/// [`SceneError::Invalid`] with the JSON pointer of what is missing or impossible; [`SceneError::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<CameraFile, SceneError> {
    let path = path.as_ref();
    parse(&load(path)?).map_err(|e| e.in_file(path))
}

/// The same from bytes in memory.
///
/// # Errors
/// [`SceneError::Invalid`].
pub fn parse(bytes: &[u8]) -> Result<CameraFile, SceneError> {
    let json: Value = serde_json::from_slice(bytes).map_err(|e| SceneError::invalid("", format!("not JSON: {e}")))?;
    let fps = number(&json, "", "fps")?;
    if !(fps > 0.0 && fps <= 1000.0) {
        return Err(SceneError::invalid("/fps", format!("{fps} frames per second")));
    }
    let views = json.get("views").and_then(Value::as_object);
    let views = views.ok_or_else(|| SceneError::invalid("/views", "is missing; it should hold \"main\""))?;
    let main = views.get("main").ok_or_else(|| SceneError::invalid("/views/main", "is missing"))?;
    let mut file =
        CameraFile { main: camera(&json, main, "/views/main")?, fps, views: Vec::new(), target: target(main) };
    for (name, view) in views.iter().filter(|(name, _)| *name != "main") {
        file.views.push((name.clone(), camera(&json, view, &format!("/views/{name}"))?));
    }
    Ok(file)
}

fn number(of: &Value, place: &str, key: &str) -> Result<f64, SceneError> {
    let pointer = format!("{place}/{key}");
    let value = of.get(key).ok_or_else(|| SceneError::invalid(pointer.clone(), "is missing"))?;
    value.as_f64().filter(|x| x.is_finite()).ok_or_else(|| SceneError::invalid(pointer, "should be a number"))
}

fn camera(defaults: &Value, view: &Value, place: &str) -> Result<Camera, SceneError> {
    let own = |key: &str| if view.get(key).is_some() { number(view, place, key) } else { number(defaults, "", key) };
    let (width, height, fx, fy) = (own("width")?, own("height")?, own("fx")?, own("fy")?);
    let side = |x: f64| (1.0..=MAX_SIDE).contains(&x) && x.fract() == 0.0;
    if !side(width) || !side(height) || fx <= 0.0 || fy <= 0.0 {
        return Err(SceneError::invalid(
            place,
            format!("impossible intrinsics: {width}×{height} px, focal lengths {fx}, {fy} px"),
        ));
    }
    Ok(Camera {
        width: width as u32,
        height: height as u32,
        fx,
        fy,
        cx: own("cx")?,
        cy: own("cy")?,
        view_from_world: matrix(view, place)?,
    })
}

fn matrix(view: &Value, place: &str) -> Result<DAffine3, SceneError> {
    let pointer = format!("{place}/world_to_camera_opencv");
    let invalid = |what: &str| SceneError::invalid(pointer.clone(), what);
    let rows = view.get("world_to_camera_opencv").and_then(Value::as_array);
    let rows = rows.ok_or_else(|| invalid("is missing; it should be a 4×4 matrix of rows"))?;
    let entries: Vec<f64> =
        rows.iter().filter_map(Value::as_array).filter(|r| r.len() == 4).flatten().filter_map(Value::as_f64).collect();
    let entries: [f64; 16] = entries.try_into().map_err(|_| invalid("should be four rows of four numbers"))?;
    let m = DMat4::from_cols_array(&entries).transpose();
    let r = DMat3::from_mat4(m);
    let rigid = (r * r.transpose()).abs_diff_eq(DMat3::IDENTITY, ROTATION_TOLERANCE)
        && r.determinant() > 0.0
        && m.row(3).abs_diff_eq(glam::DVec4::W, ROTATION_TOLERANCE)
        && m.is_finite();
    rigid
        .then(|| DAffine3::from_mat4(m))
        .ok_or_else(|| invalid("should be a rotation and a translation without scale or mirror"))
}

fn target(view: &Value) -> Option<DVec3> {
    let numbers: Vec<f64> = view.get("target")?.as_array()?.iter().filter_map(Value::as_f64).collect();
    <[f64; 3]>::try_from(numbers).ok().map(DVec3::from)
}

/// Writes a `camera.json`; views with the main view's intrinsics do not repeat them.
///
/// # Errors
/// [`SceneError::Io`].
pub fn write(path: impl AsRef<Path>, file: &CameraFile) -> Result<(), SceneError> {
    write_atomically(path, |w| w.write_all(to_json(file).as_bytes()))
}

/// The text of a `camera.json`.
pub fn to_json(file: &CameraFile) -> String {
    let c = &file.main;
    let mut views = serde_json::Map::new();
    views.insert("main".into(), view_json(c, c, file.target));
    for (name, camera) in &file.views {
        views.insert(name.clone(), view_json(camera, c, file.target));
    }
    let json = json!({
        "width": c.width, "height": c.height, "fps": file.fps, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
        "convention": "world_to_camera_opencv: 4x4, row-major, world = glTF world; camera x right, y down, z forward; pixel centres at +0.5",
        "views": views,
    });
    format!("{json:#}\n")
}

fn view_json(camera: &Camera, main: &Camera, target: Option<DVec3>) -> Value {
    let m = DMat4::from(camera.view_from_world).transpose();
    let rows: Vec<[f64; 4]> = (0..4).map(|i| m.col(i).to_array()).collect();
    let mut view = json!({ "world_to_camera_opencv": rows });
    if let Some(t) = target {
        view["target"] = json!(t.to_array());
    }
    let same = Camera { view_from_world: camera.view_from_world, ..*main } == *camera;
    if !same {
        view["width"] = json!(camera.width);
        view["height"] = json!(camera.height);
        for (key, x) in [("fx", camera.fx), ("fy", camera.fy), ("cx", camera.cx), ("cy", camera.cy)] {
            view[key] = json!(x);
        }
    }
    view
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_file_comes_back_bit_for_bit_with_all_its_views() {
        let target = DVec3::new(0.1, 0.2, 0.3);
        let main = Camera::orbit(target, 3.0, 0.7, 0.2, 0.6, 512, 384);
        let side = Camera { fx: 700.5, ..main.orbited(target, 0.5).resized(256, 192) };
        let file = CameraFile { main, fps: 23.976, views: vec![("side".into(), side)], target: Some(target) };
        assert_eq!(parse(to_json(&file).as_bytes()).unwrap(), file);
    }

    #[test]
    fn a_mirrored_or_scaled_matrix_is_refused_with_its_pointer() {
        let file = CameraFile {
            main: Camera::orbit(DVec3::ZERO, 3.0, 0.0, 0.0, 0.6, 64, 64),
            fps: 24.0,
            views: Vec::new(),
            target: None,
        };
        let mut json: Value = serde_json::from_str(&to_json(&file)).unwrap();
        json["views"]["main"]["world_to_camera_opencv"][0][0] = json!(-1.0);
        let message = parse(json.to_string().as_bytes()).unwrap_err().to_string();
        assert!(message.contains("/views/main/world_to_camera_opencv"), "{message}");
    }
}
