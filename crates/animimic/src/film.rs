//! Frames drawn one after the other into an MP4 that appears whole, or not at all where the user stops.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::Image;
use std::path::Path;

/// Draws `frames` frames and writes them as a video; `share` is the part of the progress that this takes.
pub(crate) fn film(
    path: &Path,
    (frames, fps): (usize, f64),
    share: (f64, f64),
    draw: impl Fn(usize) -> Image,
    progress: &mut Progress,
) -> Result<(), Error> {
    let mut stop = Ok(());
    let mut drawn = (0..frames).map_while(|t| {
        let done = share.0 + (share.1 - share.0) * t as f64 / frames as f64;
        stop = tell(progress, Event::Step { done, loss: None });
        stop.is_ok().then(|| draw(t))
    });
    let encoded = animimic_video::encode_mp4(&mut drawn, fps);
    stop?;
    Ok(animimic_video::write_whole(path, &encoded?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ops::ControlFlow;

    #[test]
    fn a_stop_leaves_the_video_that_was_there() {
        let folder = tempfile::tempdir().expect("made");
        let path = folder.path().join("a.mp4");
        std::fs::write(&path, b"of an earlier run").expect("written");
        let draw = |t: usize| Image::filled(16, 16, [10 * t as u8; 3]);
        let mut heard = 0;
        let mut stop = |_: Event| {
            heard += 1;
            if heard > 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        assert!(matches!(film(&path, (5, 24.0), (0.0, 1.0), draw, &mut stop), Err(Error::Cancelled)));
        assert_eq!(std::fs::read(&path).expect("there"), b"of an earlier run");
        film(&path, (5, 24.0), (0.0, 1.0), draw, &mut |_| ControlFlow::Continue(())).expect("written");
        assert_eq!(&std::fs::read(&path).expect("there")[4..8], b"ftyp");
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);
    }
}
