//! Reads a video, finds masks and tracks and writes them with an overlay video: `cues VIDEO FOLDER [height]`.

use animimic_scene::Cues;
use animimic_video::cues::{MaskOptions, TrackOptions, masks, overlay, tracks, write_masks, write_tracks};
use animimic_video::{ReadOptions, read, write_mp4, write_png};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, input, output, ..] = &arguments[..] else { return Err("usage: cues VIDEO FOLDER [height]".into()) };
    let working_height = arguments.get(3).map(|h| h.parse()).transpose()?;
    let folder = Path::new(output);
    std::fs::create_dir_all(folder)?;
    let video = read(Path::new(input), &ReadOptions { working_height, ..ReadOptions::default() })?;
    let found = masks(&video, &MaskOptions::default());
    let tracks = tracks(&video, &found.masks, &TrackOptions::default());
    let cues = Cues { masks: found.masks, tracks, ..Cues::default() };
    write_masks(&folder.join("masks.npz"), &cues.masks)?;
    write_tracks(&folder.join("tracks.npz"), &cues.tracks)?;
    let frames = overlay(&video, &cues);
    write_png(&folder.join("overlay.png"), &frames[frames.len() / 2])?;
    write_mp4(&folder.join("overlay.mp4"), &mut frames.into_iter(), video.fps)?;
    println!("{} frames, {} tracks, warnings {:?}", video.frames.len(), cues.tracks.query_frame.len(), video.warnings);
    Ok(())
}
