//! How much memory a run will take, told before it is taken.

use crate::Error;
use animimic_scene::{Asset, Video};

/// What a fit holds per pixel of the video and frame: the frame, its mask, its background and the rest of the renderer's pictures,
/// as in the hungriest of the videos whose peaks were measured (50 and 153 frames of a real fish; plain ones take down to 16) [bytes].
const PER_PIXEL: u64 = 26;
/// What is held per pixel whatever the number of frames: flow, and one frame's differentiable rendering per thread, from the same
/// peaks [bytes].
const PER_WORKING_PIXEL: u64 = 170;
/// What is held per vertex and per texel: the model, what is drawn of it, and the file that is written [bytes].
const PER_VERTEX: u64 = 500;
const PER_TEXEL: u64 = 12;
/// The program itself [bytes].
const BASE: u64 = 110 << 20;

/// Peak memory of finding the motion of a model in a video [bytes].
pub(crate) fn needed(asset: &Asset, video: &Video) -> u64 {
    let pixels = video.frames.first().map_or(0, |f| f.width as u64 * f.height as u64);
    let textures = asset.looks.iter().filter_map(|l| l.texture.as_ref());
    let texels: u64 = textures.map(|t| t.image.rgb.len() as u64).sum();
    let vertices = asset.mesh.positions.len() as u64;
    BASE + pixels * (PER_PIXEL * video.frames.len() as u64 + PER_WORKING_PIXEL)
        + PER_VERTEX * vertices
        + PER_TEXEL * texels
}

/// Refuses what the machine cannot hold; returns a warning where it can, but not now.
///
/// # Errors
/// [`Error::Input`] with what would take less.
pub(crate) fn check(name: &str, needed: u64, frames: usize) -> Result<Option<String>, Error> {
    total_and_free().map_or(Ok(None), |machine| weigh(name, needed, frames, machine))
}

fn weigh(name: &str, needed: u64, frames: usize, (total, free): (u64, u64)) -> Result<Option<String>, Error> {
    let gib = |bytes: u64| bytes as f64 / (1u64 << 30) as f64;
    let advice = "lower --height, or give a part of the video with --frames A..B";
    if needed > total {
        return Err(Error::Input(format!(
            "{name}: {frames} frames need about {:.1} GiB of memory, and this machine has {:.1}: {advice}",
            gib(needed),
            gib(total)
        )));
    }
    let words = || {
        format!(
            "{name}: needs about {:.1} GiB of memory, {:.1} are free; if it is too slow, {advice}",
            gib(needed),
            gib(free)
        )
    };
    Ok((needed > free).then(words))
}

/// Total and available memory [bytes], as Linux tells, within the limit of a container; `None` on other systems.
pub(crate) fn total_and_free() -> Option<(u64, u64)> {
    let number = |path: &str| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = |name: &str| {
        let rest = text.lines().find_map(|l| l.strip_prefix(name))?;
        Some(1024 * rest.split_whitespace().next()?.parse::<u64>().ok()?)
    };
    let (total, free) = (line("MemTotal:")?, line("MemAvailable:")?);
    let Some(limit) = number("/sys/fs/cgroup/memory.max") else { return Some((total, free)) };
    let used = number("/sys/fs/cgroup/memory.current").unwrap_or(0);
    Some((total.min(limit), free.min(limit.saturating_sub(used))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_scene::Image;

    #[test]
    fn what_cannot_be_held_is_refused_with_advice_and_what_is_tight_is_told() {
        let frame = Image { width: 8192, height: 8192, rgb: Vec::new() };
        let video = Video { frames: vec![frame; 2000], ..Video::default() };
        let needed = needed(&Asset::default(), &video);
        println!("{} GiB", needed >> 30);
        let refused = weigh("walk", needed, 2000, (16 << 30, 8 << 30)).expect_err("too much").to_string();
        println!("{refused}");
        assert!(refused.contains("walk: 2000 frames") && refused.contains("--height") && refused.contains("16.0"));
        assert!(
            weigh("walk", 9 << 30, 50, (16 << 30, 8 << 30)).expect("fits").expect("tight").contains("8.0 are free")
        );
        assert_eq!(weigh("walk", 7 << 30, 50, (16 << 30, 8 << 30)).expect("fits"), None);
    }
}
