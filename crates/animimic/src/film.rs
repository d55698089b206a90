//! Frames drawn one after the other into a file that appears whole, or not at all where the user stops.

use crate::Error;
use crate::event::{Event, Progress, tell};
use animimic_scene::Image;
use animimic_video::{VideoError, encode_mp4, write_whole};
use std::path::Path;

/// Makes a file's bytes of frames at a rate.
pub(crate) type Encode = fn(&mut dyn Iterator<Item = Image>, f64) -> Result<Vec<u8>, VideoError>;

/// Draws `frames` frames and writes them as an MP4; `share` is the part of the progress that this takes.
pub(crate) fn film(
    path: &Path,
    (frames, fps): (usize, f64),
    share: (f64, f64),
    draw: impl Fn(usize) -> Image,
    progress: &mut Progress,
) -> Result<(), Error> {
    film_as(encode_mp4, path, (frames, fps), share, draw, progress)
}

/// The same in a file of another kind.
pub(crate) fn film_as(
    encode: Encode,
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
    let encoded = encode(&mut drawn, fps);
    stop?;
    Ok(write_whole(path, &encoded?)?)
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
