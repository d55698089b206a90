//! How well each part of the model is known: in numbers, in a sentence, and as a chart of parts over time.

use super::html::escape;
use animimic_fit::stage1::Certainty;
use animimic_scene::Skeleton;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// How well the part of the surface that follows one joint is known.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PartCertainty {
    /// Name of the joint.
    pub joint: String,
    /// Standard deviation of its surface's position in each frame [% of the model's diagonal].
    pub deviation_percent: Vec<f64>,
}

/// A part that deviates by more than this, on average over time, is named [% of the diagonal].
const DOUBTFUL_PERCENT: f64 = 2.0;
/// Deviation that is drawn in full colour [% of the diagonal].
const FULL_PERCENT: f64 = 4.0;

/// The same with joints named.
pub fn named(skeleton: &Skeleton, certainty: &[Certainty]) -> Vec<PartCertainty> {
    let part = |c: &Certainty| PartCertainty {
        joint: skeleton.joints[c.joint].name.clone(),
        deviation_percent: c.deviation.iter().map(|d| (1e5 * d).round() / 1e3).collect(),
    };
    certainty.iter().map(part).collect()
}

impl PartCertainty {
    fn mean(&self) -> f64 {
        self.deviation_percent.iter().sum::<f64>() / self.deviation_percent.len().max(1) as f64
    }

    /// Frame of the largest deviation, and that.
    fn worst(&self) -> Option<(usize, f64)> {
        self.deviation_percent.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Says which parts the video hardly shows, if there are any.
pub fn doubt(parts: &[PartCertainty], fps: f64) -> Option<String> {
    let doubtful = parts.iter().filter(|p| p.mean() > DOUBTFUL_PERCENT).count();
    let least = parts.iter().max_by(|a, b| a.mean().total_cmp(&b.mean())).filter(|_| doubtful > 0)?;
    let (frame, percent) = least.worst()?;
    Some(format!(
        "motion: the video shows {doubtful} of {} parts only roughly (to {DOUBTFUL_PERCENT} % of the model's size or worse); \
         least well {}, to {percent:.1} % at {:.2} s",
        parts.len(),
        least.joint,
        frame as f64 / fps
    ))
}

const ROW: f64 = 14.0;
const LABEL: f64 = 190.0;
const WIDTH: f64 = 1080.0;

/// One row per part, one cell per frame, the darker the less certain.
pub fn chart(parts: &[PartCertainty]) -> String {
    let frames = parts.iter().map(|p| p.deviation_percent.len()).max().unwrap_or(0);
    if frames == 0 {
        return String::new();
    }
    let cell = (WIDTH - LABEL) / frames as f64;
    let height = ROW * parts.len() as f64;
    let mut out =
        format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"certainty of parts over time\">");
    for (row, part) in parts.iter().enumerate() {
        let y = ROW * row as f64;
        let _ = write!(
            out,
            "<text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{} {:.2} %</text>",
            LABEL - 6.0,
            y + 10.5,
            escape(&part.joint),
            part.mean()
        );
        for (t, d) in part.deviation_percent.iter().enumerate() {
            let opacity = (d / FULL_PERCENT).clamp(0.0, 1.0);
            let _ = write!(
                out,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#b3541e\" fill-opacity=\"{opacity:.2}\"/>",
                LABEL + cell * t as f64,
                y + 1.0,
                cell + 0.2,
                ROW - 2.0
            );
        }
    }
    out + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_parts_that_are_hardly_seen_are_named_and_names_cannot_break_out_of_the_page() {
        let part = |name: &str, d: [f64; 3]| PartCertainty { joint: name.into(), deviation_percent: d.to_vec() };
        let known = [part("leg", [0.1, 0.3, 0.2])];
        assert!(doubt(&known, 10.0).is_none());
        let parts = [known[0].clone(), part("<tail>", [1.0, 2.0, 6.0])];
        let said = doubt(&parts, 10.0).expect("the tail is in doubt");
        println!("{said}");
        assert!(said.contains("1 of 2 parts") && said.contains("6.0 % at 0.20 s"));
        let drawn = chart(&parts);
        assert!(drawn.contains("&lt;tail&gt; 3.00 %") && !drawn.contains("<tail>"));
        assert_eq!(drawn.matches("<rect").count(), 6);
        assert!(chart(&[]).is_empty());
    }
}
