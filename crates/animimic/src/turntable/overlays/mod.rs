//! What can be shown on a drawn view beside the model's looks.
//!
//! A new overlay is one file here and one word in [`OVERLAYS`].

mod residuals;
mod skeleton;
mod stiffness;
mod weights;

pub use residuals::Residuals;
pub use skeleton::Bones;
pub use stiffness::Stiffness;
pub use weights::Weights;

pub(crate) use skeleton::draw_bones;
pub(crate) use weights::colored_by_weights;

use crate::Error;
use animimic_scene::{Asset, Camera, Image, Mask};
use glam::DVec3;

/// What the video shows at the moment that is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a> {
    /// The frame, of the view's size.
    pub frame: &'a Image,
    /// Where the object is in it.
    pub mask: &'a Mask,
}

/// A view as it was drawn.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The model.
    pub asset: &'a Asset,
    /// Joint positions at that moment, world space \[joint\].
    pub joints: &'a [DVec3],
    /// The view's camera.
    pub camera: &'a Camera,
    /// Where the model was drawn.
    pub coverage: &'a Mask,
    /// What the video shows; only in the view of the video's own camera.
    pub observed: Option<Observed<'a>>,
}

/// One thing to show.
pub trait Overlay: Sync {
    /// Its word on the command line.
    fn name(&self) -> &'static str;
    /// One line on what it shows.
    fn summary(&self) -> &'static str;
    /// The model with other colours than its looks; `None` where they stay.
    fn repainted(&self, _asset: &Asset) -> Option<Asset> {
        None
    }
    /// What the model lacks to be shown so, and what to do; `None` where it lacks nothing.
    fn lacks(&self, _asset: &Asset) -> Option<&'static str> {
        None
    }
    /// Whether it decides the surface's colours, as only one overlay can.
    fn colours_the_surface(&self) -> bool {
        false
    }
    /// Whether it compares the model's looks with a video.
    fn compares(&self) -> bool {
        false
    }
    /// Draws over a view.
    fn paint(&self, _picture: &mut Image, _seen: &Seen) {}
}

/// All overlays, in the order in which they are drawn.
pub const OVERLAYS: &[&dyn Overlay] = &[&Weights, &Stiffness, &Residuals, &Bones];

/// The overlays of these names, in the order in which they are drawn.
///
/// # Errors
/// [`Error::Input`] for unknown names, and for two that want to colour the same surface.
pub fn find(names: &[String]) -> Result<Vec<&'static dyn Overlay>, Error> {
    let known = |n: &String| OVERLAYS.iter().any(|o| o.name() == n);
    if let Some(name) = names.iter().find(|n| !known(n)) {
        let all: Vec<&str> = OVERLAYS.iter().map(|o| o.name()).collect();
        return Err(Error::Input(format!("no overlay is called {name:?}: there are {}", all.join(", "))));
    }
    let chosen: Vec<_> = OVERLAYS.iter().copied().filter(|o| names.iter().any(|n| n == o.name())).collect();
    let colouring: Vec<&str> = chosen.iter().filter(|o| o.colours_the_surface()).map(|o| o.name()).collect();
    if colouring.len() > 1 {
        return Err(Error::Input(format!("{} colour the same surface: draw one of them", colouring.join(" and "))));
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> Result<Vec<&'static str>, String> {
        let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        find(&names).map(|list| list.iter().map(|o| o.name()).collect()).map_err(|e| e.to_string())
    }

    #[test]
    fn overlays_are_found_by_name_in_the_order_of_drawing_and_refused_where_they_hide_each_other() {
        assert_eq!(named(&["skeleton", "weights"]), Ok(vec!["weights", "skeleton"]));
        assert!(named(&["bones"]).unwrap_err().contains("weights, stiffness, residuals, skeleton"));
        assert!(named(&["residuals", "weights"]).unwrap_err().contains("one of them"));
        assert!(OVERLAYS.iter().all(|o| !o.summary().is_empty()));
    }
}
