//! Mask IoU: overlap of silhouettes, per view.

use super::{Evidence, Metric, Missing, Reading, mean};

pub struct MaskIou;

impl Metric for MaskIou {
    fn name(&self) -> &'static str {
        "mask iou"
    }

    fn definition(&self) -> &'static str {
        "intersection over union of coverage ≥ 0.5 at native size, per view: mean over frames, the worst frame, and frame 0"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        if e.silhouettes.is_empty() {
            return Err(Missing("needs a video or truth masks"));
        }
        let mut out = Vec::new();
        for pair in e.silhouettes {
            let ious: Vec<f64> = pair.result.iter().zip(&pair.reference).map(|(a, b)| a.iou(b)).collect();
            out.push((format!("iou_{}", pair.view), mean(ious.iter().copied())));
            out.push((format!("iou_{}_min", pair.view), ious.iter().copied().fold(1.0, f64::min)));
            out.push((format!("iou_{}_frame0", pair.view), ious.first().copied().unwrap_or(1.0)));
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{SilhouettePair, fixtures};
    use super::*;
    use animimic_scene::Mask;

    #[test]
    fn a_square_shifted_by_half_its_width_overlaps_by_a_third() {
        let square = |x0: usize| {
            let mut m = Mask { width: 16, height: 8, coverage: vec![0; 128] };
            (0..8).for_each(|y| (x0..x0 + 8).for_each(|x| m.coverage[y * 16 + x] = 255));
            m
        };
        let pair = SilhouettePair {
            view: "main".into(),
            result: vec![square(0), square(0)],
            reference: vec![square(0), square(4)],
        };
        let (asset, frames) = fixtures::sliding(0.0, 2);
        let pairs = [pair];
        let e = Evidence { silhouettes: &pairs, ..fixtures::evidence(&asset, &frames) };
        let r = MaskIou.measure(&e).unwrap();
        println!("{r:?}");
        assert!((r[0].1 - 2.0 / 3.0).abs() < 1e-12 && (r[1].1 - 1.0 / 3.0).abs() < 1e-12);
    }
}
