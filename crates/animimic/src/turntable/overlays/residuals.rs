use super::{Overlay, Seen};
use crate::animate::heat_map;
use animimic_scene::Image;

/// Where model and video disagree, in the view of the video's camera.
pub struct Residuals;

impl Overlay for Residuals {
    fn name(&self) -> &'static str {
        "residuals"
    }

    fn summary(&self) -> &'static str {
        "heat where the model differs from the video in colour; blue where it sticks out, red where it does not reach"
    }

    fn colours_the_surface(&self) -> bool {
        true
    }

    fn compares(&self) -> bool {
        true
    }

    fn paint(&self, picture: &mut Image, seen: &Seen) {
        if let Some(observed) = seen.observed {
            *picture = heat_map(observed.frame, observed.mask, picture, seen.coverage);
        }
    }
}
