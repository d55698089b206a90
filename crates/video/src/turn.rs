//! Quarter turns and flips of pictures: the rotation that cameras and phones leave to the player.

use animimic_scene::Image;

/// One of the eight symmetries of the rectangle: transpose first, then mirror.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Turn {
    /// Swap x and y.
    pub transpose: bool,
    /// Mirror left and right (after transposing).
    pub mirror_x: bool,
    /// Mirror top and bottom (after transposing).
    pub mirror_y: bool,
}

impl Turn {
    /// From a track header matrix (16.16 fixed point): x' = a·x + c·y, y' = b·x + d·y. `None` if it is not a symmetry.
    pub fn from_matrix(a: i32, b: i32, c: i32, d: i32) -> Option<Self> {
        const ONE: i32 = 1 << 16;
        match (a, b, c, d) {
            (_, 0, 0, _) if a.abs() == ONE && d.abs() == ONE => {
                Some(Self { transpose: false, mirror_x: a < 0, mirror_y: d < 0 })
            }
            (0, _, _, 0) if b.abs() == ONE && c.abs() == ONE => {
                Some(Self { transpose: true, mirror_x: c < 0, mirror_y: b < 0 })
            }
            _ => None,
        }
    }

    /// Size of the turned picture.
    pub fn size(&self, width: usize, height: usize) -> (usize, usize) {
        if self.transpose { (height, width) } else { (width, height) }
    }

    /// The turned picture.
    pub fn apply(&self, image: Image) -> Image {
        if *self == Self::default() {
            return image;
        }
        let (width, height) = self.size(image.width, image.height);
        let mut rgb = Vec::with_capacity(image.rgb.len());
        for y in 0..height {
            for x in 0..width {
                let u = if self.mirror_x { width - 1 - x } else { x };
                let v = if self.mirror_y { height - 1 - y } else { y };
                rgb.push(if self.transpose { image.at(v, u) } else { image.at(u, v) });
            }
        }
        Image { width, height, rgb }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_clockwise_moves_the_top_left_pixel_to_the_top_right() {
        let mut image = Image::filled(3, 2, [0; 3]);
        image.rgb[0] = [255; 3];
        // 90° clockwise: (x, y) → (−y, x).
        let turned = Turn::from_matrix(0, 1 << 16, -(1 << 16), 0).expect("a symmetry").apply(image.clone());
        assert_eq!((turned.width, turned.height), (2, 3));
        assert_eq!(turned.at(1, 0), [255; 3]);
        let half = Turn::from_matrix(-(1 << 16), 0, 0, -(1 << 16)).expect("a symmetry").apply(image);
        assert_eq!(half.at(2, 1), [255; 3]);
        assert_eq!(Turn::from_matrix(40_000, 30_000, -30_000, 40_000), None);
    }
}
