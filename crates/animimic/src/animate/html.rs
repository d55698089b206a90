//! `report.html`: one file with everything in it, to look at and to send.

use super::certainty;
use super::chart::line_chart;
use super::report::{ClipReport, Report};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1100px;padding:0 1rem;color:#1d2b33;background:#fbfaf7}\
h1{font-weight:600}h2{margin-top:2.2rem;border-bottom:1px solid #d8d4c8}video,img{width:100%;border-radius:6px;background:#ddd}\
table{border-collapse:collapse;margin:.6rem 2rem .6rem 0;display:inline-table;vertical-align:top}td{padding:.1rem .8rem .1rem 0;border-bottom:1px solid #eae6da}\
td:last-child{text-align:right;font-variant-numeric:tabular-nums}svg{background:#fff;border:1px solid #eae6da;border-radius:6px;margin:.3rem}\
svg text{font-size:10px;fill:#5b6a70}svg .t{font-size:12px;fill:#1d2b33}polyline{fill:none;stroke:#147d86;stroke-width:1.6}.axis{stroke:#bbb}\
.doubt{background:#fff3d6;border-left:4px solid #e2a52b;padding:.4rem .8rem;margin:.3rem 0}.fine{color:#557}";

/// Files shown for one clip.
pub struct Shown {
    /// The MP4's bytes.
    pub views: Vec<u8>,
    /// The PNG's bytes.
    pub sheet: Vec<u8>,
    /// File name of the video of residuals, beside the page.
    pub residuals: String,
}

/// The page.
pub fn page(report: &Report, shown: &[Shown]) -> String {
    let mut out = String::new();
    let title = escape(&report.model);
    let _ = write!(
        out,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title} – animimic</title><style>{STYLE}</style><h1>{title}</h1><p class=\"fine\">{}</p>",
        escape(&report.program)
    );
    for warning in &report.warnings {
        let _ = write!(out, "<p class=\"doubt\">{}</p>", escape(warning));
    }
    for (clip, shown) in report.clips.iter().zip(shown) {
        clip_section(&mut out, clip, shown);
    }
    material(&mut out, &report.material);
    let _ = write!(out, "<h2>Run</h2>{}{}{}", table(&report.size), table(&report.options), table(&report.timings));
    out.push_str("</html>\n");
    out
}

fn clip_section(out: &mut String, clip: &ClipReport, shown: &Shown) {
    let _ = write!(
        out,
        "<h2>{}</h2><p>{} frames at {:.3} frames a second, {}×{} px (file: {}×{} px). Video, result (skinned and soft, where soft tissue was asked for), and the result turned by 45° to either side:</p>\
         <video controls loop muted autoplay playsinline src=\"data:video/mp4;base64,{}\"></video>\
         <p>Eight frames: video, result, outline and skeleton over the video.</p><img alt=\"contact sheet\" src=\"data:image/png;base64,{}\">\
         <p>Where result and video disagree: <a href=\"{}\">{}</a> (warm: colour; blue: the model sticks out; red: it does not reach).</p>",
        escape(&clip.name),
        clip.frames,
        clip.fps,
        clip.size_px[0],
        clip.size_px[1],
        clip.native_size_px[0],
        clip.native_size_px[1],
        STANDARD.encode(&shown.views),
        STANDARD.encode(&shown.sheet),
        escape(&shown.residuals),
        escape(&shown.residuals),
    );
    out.push_str("<h3>What was uncertain</h3>");
    if clip.uncertain.is_empty() {
        out.push_str("<p class=\"fine\">Nothing that the run noticed.</p>");
    }
    for doubt in &clip.uncertain {
        let _ = write!(out, "<p class=\"doubt\">{}</p>", escape(doubt));
    }
    if !clip.certainty.is_empty() {
        let _ = write!(
            out,
            "<h3>How well each part is known</h3><p>Standard deviation of its place, in % of the model's diagonal: mean beside \
             the name, and frame by frame (white: 0; brown: 4 % or more). A limb that leans the wrong way in depth is not in it.</p>{}",
            certainty::chart(&clip.certainty)
        );
    }
    if let Some(verdict) = clip.softness["verdict"].as_str() {
        let _ = write!(out, "<h3>Soft tissue</h3><p>{}</p>{}", escape(verdict), table(&clip.softness));
    }
    let _ = write!(out, "<h3>Numbers</h3>{}{}<h3>Loss</h3>", table(&clip.metrics), table(&clip.cues));
    for curve in &clip.losses {
        out.push_str(&line_chart(&escape(&curve.stage), &curve.values));
    }
}

/// What was learnt of the flesh.
fn material(out: &mut String, material: &Value) {
    let Some(groups) = material["groups"].as_array() else { return };
    let loose: Vec<&str> = material["loose"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let loose = if loose.is_empty() { "none".to_owned() } else { loose.join(", ") };
    let _ = write!(
        out,
        "<h2>Material</h2><p>Young's modulus by group of flesh, at a model {} m long, with the standard deviation of its logarithm. \
         What the videos do not tell stays at {:.0} Pa. Loose joints: {}.</p><table>",
        material["size_m"],
        material["prior_young"].as_f64().unwrap_or(f64::NAN),
        escape(&loose)
    );
    for group in groups {
        let number = |key: &str| group[key].as_f64().unwrap_or(f64::NAN);
        let told = if group["learnt"] == true { "" } else { " (not told by the video)" };
        let _ = write!(
            out,
            "<tr><td>{}{told}</td><td>{:.3e} Pa, ± {:.2}</td></tr>",
            escape(group["group"].as_str().unwrap_or_default()),
            number("young"),
            number("ln_young_deviation")
        );
    }
    out.push_str("</table>");
}

/// The scalar members of an object as a two-column table.
fn table(value: &Value) -> String {
    let mut out = String::from("<table>");
    for (key, v) in value.as_object().into_iter().flatten() {
        let text = match v {
            Value::Number(n) => {
                n.as_u64().map_or_else(|| format!("{:.4}", n.as_f64().unwrap_or(f64::NAN)), |u| u.to_string())
            }
            Value::String(s) => escape(s),
            Value::Null => continue,
            Value::Object(o) => {
                for (k, why) in o {
                    let _ = write!(
                        out,
                        "<tr><td>{}</td><td>not available: {}</td></tr>",
                        escape(k),
                        escape(why.as_str().unwrap_or_default())
                    );
                }
                continue;
            }
            other => escape(&other.to_string()),
        };
        let _ = write!(out, "<tr><td>{}</td><td>{text}</td></tr>", escape(key));
    }
    out + "</table>"
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_files_cannot_break_out_of_the_page() {
        let t = table(&serde_json::json!({"<script>": "a\"b", "n": 3, "x": 0.5}));
        assert_eq!(
            t,
            "<table><tr><td>&lt;script&gt;</td><td>a&quot;b</td></tr><tr><td>n</td><td>3</td></tr><tr><td>x</td><td>0.5000</td></tr></table>"
        );
    }
}
