//! Where result and video disagree, as a picture: heat over the grey frame.
//!
//! Where the model is drawn and the object observed, heat shows the colour difference; where only one of both is, the pixel is
//! marked: the model sticks out, or does not reach.

use animimic_scene::{Image, Mask};

/// Colour difference (largest channel) that is full heat [levels].
const FULL: f32 = 96.0;
/// How much of the grey frame's contrast is left.
const GREY_CONTRAST: f32 = 0.6;
/// Heat from none to full.
const HEAT: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [130.0, 25.0, 90.0], [235.0, 105.0, 35.0], [255.0, 240.0, 150.0]];
/// The model is drawn where the video shows background.
pub const OUTSIDE: [u8; 3] = [60, 130, 255];
/// The video shows the object where the model is not drawn.
pub const MISSING: [u8; 3] = [255, 60, 90];

/// The heat map of one frame; all four have its size.
pub fn heat_map(frame: &Image, mask: &Mask, drawn: &Image, coverage: &Mask) -> Image {
    let rgb = (0..frame.rgb.len())
        .map(|p| {
            let f = frame.rgb[p].map(f32::from);
            let grey = 128.0 + GREY_CONTRAST * (0.299 * f[0] + 0.587 * f[1] + 0.114 * f[2] - 128.0);
            let (here, there) = (f32::from(coverage.coverage[p]) / 255.0, f32::from(mask.coverage[p]) / 255.0);
            let difference = (0..3).map(|c| (f32::from(drawn.rgb[p][c]) - f[c]).abs()).fold(0.0, f32::max);
            let shared = here.min(there);
            let strength = (difference / FULL).min(1.0) * shared;
            let (color, opacity) = if here - there > 0.0 { (OUTSIDE, here - there) } else { (MISSING, there - here) };
            let hot = heat(strength);
            [0, 1, 2].map(|c| {
                let inner = grey * (1.0 - strength.sqrt()) + hot[c] * strength.sqrt();
                (inner * (1.0 - opacity) + f32::from(color[c]) * opacity + 0.5) as u8
            })
        })
        .collect();
    Image { width: frame.width, height: frame.height, rgb }
}

fn heat(strength: f32) -> [f32; 3] {
    let at = strength * (HEAT.len() - 1) as f32;
    let k = (at as usize).min(HEAT.len() - 2);
    let u = at - k as f32;
    [0, 1, 2].map(|c| HEAT[k][c] * (1.0 - u) + HEAT[k + 1][c] * u)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agreement_is_grey_difference_is_hot_and_one_sided_coverage_is_marked() {
        let frame = Image { width: 4, height: 1, rgb: vec![[100; 3], [100; 3], [100; 3], [100; 3]] };
        let drawn = Image { width: 4, height: 1, rgb: vec![[100; 3], [255; 3], [200; 3], [100; 3]] };
        let mask = Mask { width: 4, height: 1, coverage: vec![255, 255, 0, 255] };
        let coverage = Mask { width: 4, height: 1, coverage: vec![255, 255, 255, 0] };
        let map = heat_map(&frame, &mask, &drawn, &coverage);
        println!("{:?}", map.rgb);
        assert!(map.rgb[0][0] == map.rgb[0][1] && map.rgb[0][1] == map.rgb[0][2]);
        assert_eq!(map.rgb[1], [255, 240, 150]);
        assert_eq!((map.rgb[2], map.rgb[3]), (OUTSIDE, MISSING));
    }
}
