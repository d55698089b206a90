//! From where an asset is drawn.

use super::Shoot;
use crate::Error;
use crate::camera::{self, CameraChoice};
use animimic_scene::{Asset, Camera};
use glam::DVec3;

/// A view to draw.
#[derive(Clone, Debug, PartialEq)]
pub enum View {
    /// The given camera.
    Input,
    /// The given camera turned about the vertical through the model [degrees].
    Turned(f64),
    /// The given camera going once around the model.
    Turntable,
    /// A camera of its own.
    Camera(CameraChoice),
}

impl std::str::FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(deg) = text.parse::<f64>()
            && deg.is_finite()
        {
            return Ok(Self::Turned(deg));
        }
        let camera = text.starts_with("preset:") || text.ends_with(".json") || text.ends_with(".png");
        match text {
            "input" => Ok(Self::Input),
            "turntable" => Ok(Self::Turntable),
            _ if camera => text.parse().map(Self::Camera).map_err(|never| match never {}),
            _ => {
                Err("a view is input, turntable, an angle in degrees such as +45, preset:NAME or a camera.json".into())
            }
        }
    }
}

/// The cameras of all views while they stand still, and the point that they turn about.
pub(super) struct Cameras {
    pub main: Camera,
    target: DVec3,
    views: Vec<(View, Camera)>,
}

impl Cameras {
    /// Cameras for pictures of `height` pixels; the main one for `width` × `height`, where a video says so.
    pub fn new(shoot: &Shoot, asset: &Asset, width: Option<u32>, height: u32) -> Result<Self, Error> {
        let (low, high) = asset.mesh.bounds();
        let center = 0.5 * (low + high);
        let (main, target) = match (&shoot.camera, width) {
            (CameraChoice::File(path), Some(width)) => {
                let file = camera::from_file(path, width, height)?;
                (file.main, file.target.unwrap_or(center))
            }
            (choice, _) => placed(choice, asset, width.unwrap_or(height), height)?,
        };
        let own = |view: &View| match view {
            View::Camera(choice) => Ok((view.clone(), placed(choice, asset, height, height)?.0)),
            _ => Ok((view.clone(), main)),
        };
        let views = shoot.views.iter().map(own).collect::<Result<_, Error>>()?;
        Ok(Self { main, target, views })
    }

    /// The views in order, with the camera of each when `share` of the way around is done.
    pub fn at(&self, share: f64) -> impl Iterator<Item = (&View, Camera)> {
        self.views.iter().map(move |(view, camera)| {
            let turn = match view {
                View::Turned(deg) => deg.to_radians(),
                View::Turntable => std::f64::consts::TAU * share,
                View::Input | View::Camera(_) => 0.0,
            };
            (view, if turn == 0.0 { *camera } else { camera.orbited(self.target, turn) })
        })
    }

    /// Width of all views side by side [px].
    pub fn width(&self) -> usize {
        self.views.iter().map(|(_, camera)| camera.width as usize).sum()
    }
}

/// A camera for pictures of that height, and what it looks at; files keep their own shape, others take the width.
fn placed(choice: &CameraChoice, asset: &Asset, width: u32, height: u32) -> Result<(Camera, DVec3), Error> {
    let (low, high) = asset.mesh.bounds();
    let center = 0.5 * (low + high);
    match choice {
        CameraChoice::Preset(name) => Ok((camera::preset(name, (low, high), width, height)?, center)),
        CameraChoice::Auto => Ok((crate::still::best_view(asset, &asset.mesh.positions, width, height)?.0, center)),
        CameraChoice::File(path) => {
            let file = camera::read(path)?;
            let shape = f64::from(file.main.width) / f64::from(file.main.height);
            let width = (shape * f64::from(height)).round().max(1.0) as u32;
            Ok((file.main.resized(width, height), file.target.unwrap_or(center)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_named_angles_or_cameras() {
        assert_eq!("input".parse(), Ok(View::Input));
        assert_eq!("-45".parse(), Ok(View::Turned(-45.0)));
        assert_eq!("+45".parse(), Ok(View::Turned(45.0)));
        assert_eq!("preset:a".parse(), Ok(View::Camera(CameraChoice::Preset("a".into()))));
        assert_eq!("b/c.json".parse(), Ok(View::Camera(CameraChoice::File("b/c.json".into()))));
        assert!("left".parse::<View>().is_err() && "nan".parse::<View>().is_err());
    }
}
