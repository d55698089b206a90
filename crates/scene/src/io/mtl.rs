//! Wavefront MTL: the diffuse colour, opacity, emission and diffuse texture of named materials.

use super::{load, picture, text};
use crate::image::linear_from_srgb;
use crate::{AlphaMode, Look, Texture};
use std::path::Path;

/// Reads the looks of an MTL library. Textures that cannot be read are left out with a warning.
pub(crate) fn read(path: &Path, warnings: &mut Vec<String>) -> Vec<Look> {
    match load(path) {
        Ok(bytes) => parse(&text::lines(&bytes), path, warnings),
        Err(e) => {
            warnings.push(format!("materials left out: {e}"));
            Vec::new()
        }
    }
}

fn parse(text: &str, path: &Path, warnings: &mut Vec<String>) -> Vec<Look> {
    let mut looks: Vec<Look> = Vec::new();
    for line in text.lines() {
        let (key, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        if key == "newmtl" {
            looks.push(Look { name: rest.trim().to_string(), ..Look::default() });
            continue;
        }
        let Some(look) = looks.last_mut() else { continue };
        let numbers: Vec<f32> =
            rest.split_whitespace().map_while(|w| w.parse().ok()).filter(|x: &f32| x.is_finite()).collect();
        match (key, numbers.as_slice()) {
            // MTL colours are display values; the renderer's are linear.
            ("Kd", [r, g, b, ..]) => {
                look.base_color[..3].copy_from_slice(&[*r, *g, *b].map(|c| linear_from_srgb(c.clamp(0.0, 1.0))))
            }
            ("Ke", [r, g, b, ..]) => look.emissive = [*r, *g, *b].map(|c| linear_from_srgb(c.clamp(0.0, 1.0))),
            ("d", [d, ..]) => set_opacity(look, *d),
            ("Tr", [t, ..]) => set_opacity(look, 1.0 - t),
            ("map_Kd", _) => look.texture = texture(rest, path, warnings),
            _ => {}
        }
    }
    looks
}

fn set_opacity(look: &mut Look, opacity: f32) {
    look.base_color[3] = opacity.clamp(0.0, 1.0);
    look.alpha = if look.base_color[3] < 1.0 { AlphaMode::Blend } else { AlphaMode::Opaque };
}

/// The file of a `map_Kd` statement is its last word, or everything after the options where names have spaces.
fn texture(statement: &str, library: &Path, warnings: &mut Vec<String>) -> Option<Texture> {
    let folder = library.parent().unwrap_or(Path::new(""));
    let clamp = statement.contains("-clamp on");
    let whole = statement.trim();
    let last = whole.rsplit(char::is_whitespace).next().unwrap_or("");
    let candidates = [whole, last].map(|name| name.replace('\\', "/"));
    let found = candidates.iter().find_map(|name| {
        let direct = folder.join(name);
        let beside = folder.join(Path::new(name).file_name().unwrap_or_default());
        [direct, beside].into_iter().find(|p| p.is_file())
    });
    let decoded = found.ok_or_else(|| "is not there".to_string()).and_then(|p| {
        let bytes = load(&p).map_err(|e| e.to_string())?;
        picture::decode(&bytes)
    });
    match decoded {
        Ok((image, alpha)) => Some(Texture { image, alpha, repeat: [!clamp; 2], nearest: false }),
        Err(what) => {
            warnings.push(format!("texture left out: {last} {what}"));
            None
        }
    }
}
