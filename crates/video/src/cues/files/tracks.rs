//! Point tracks: npz archives of several programs.

use super::{any, maybe, opened, saved};
use crate::error::{Result, VideoError};
use animimic_scene::Tracks;
use animimic_scene::io::npz::Values;
use std::path::Path;

/// Names under which programs say which points are seen; the flag tells whether the values say the contrary.
const SEEN: [(&str, bool); 9] = [
    ("visibility", false),
    ("visibilities", false),
    ("visibs", false),
    ("visconf", false),
    ("pred_visibility", false),
    ("visibles", false),
    ("visible", false),
    ("occluded", true),
    ("occlusion", true),
];

/// Reads tracks: `tracks` \[T,N,2\] [px] (or `trajs`, `pred_tracks`, `points`), `visibility` \[T,N\] (truth values or confidence; see
/// `visibs`, `visibles`, `occluded`; several numbers a point are multiplied, as AllTracker's visibility and confidence), `queries` \[N\] or
/// \[N,≥1\] (first column: frame) if there. A leading axis of length 1 (batch) is dropped.
///
/// TAPIR and its kin write \[N,T,2\]: so read where `frames`, the video's number of frames, says that the second axis is time.
pub fn read_tracks(path: &Path, frames: Option<usize>) -> Result<Tracks> {
    let archive = opened(path)?;
    let array = any(path, &archive, &["tracks", "trajs", "pred_tracks", "points"])?;
    let [first, second, 2] = array.squeezed(3)[..] else {
        return Err(VideoError::invalid(path, format!("{} must be [T,N,2], not {:?}", array.name, array.shape)));
    };
    let by_point = frames.is_some_and(|n| first != n && second == n);
    let (count, points) = if by_point { (second, first) } else { (first, second) };
    let at = |t: usize, k: usize| if by_point { k * count + t } else { t * points + k };
    let seen = seen(path, &archive, count * points)?;
    let queries = maybe(path, &archive, &["queries", "query_points"])?.map(|q| q.values).unwrap_or_default();
    let columns = queries.len() / points.max(1);
    let query = |k: usize| queries.get(k * columns).filter(|_| columns > 0).map_or(0, |v| v.max(0.0) as u32);
    let sample = |t: usize, k: usize| {
        let i = at(t, k);
        let (pixel, confidence) = ([array.values[2 * i], array.values[2 * i + 1]], seen[i]);
        let sound = pixel.iter().all(|v| v.is_finite()) && confidence.is_finite();
        if sound { (pixel, confidence.clamp(0.0, 1.0)) } else { ([0.0; 2], 0.0) }
    };
    Ok(Tracks {
        pixels: (0..count).map(|t| (0..points).map(|k| sample(t, k).0).collect()).collect(),
        confidence: (0..count).map(|t| (0..points).map(|k| sample(t, k).1).collect()).collect(),
        query_frame: (0..points).map(query).collect(),
    })
}

/// Confidence of each sample, in the file's order; 1 where the file does not tell.
fn seen(path: &Path, archive: &animimic_scene::io::npz::Archive, samples: usize) -> Result<Vec<f32>> {
    for (name, contrary) in SEEN {
        let Some(array) = maybe(path, archive, &[name])? else { continue };
        let each = array.values.len() / samples.max(1);
        if each == 0 || each * samples != array.values.len() {
            let what = format!("{name} is {:?}: not the frames and points of the tracks", array.shape);
            return Err(VideoError::invalid(path, what));
        }
        let value = |v: &[f32]| v.iter().product::<f32>();
        return Ok(array.values.chunks(each).map(|v| if contrary { 1.0 - value(v) } else { value(v) }).collect());
    }
    Ok(vec![1.0; samples])
}

/// Writes tracks as [`read_tracks`] reads them; `visibility` holds the confidence, `queries` \[N,3\] frame, x and y as CoTracker takes them.
pub fn write_tracks(path: &Path, tracks: &Tracks) -> Result<()> {
    let (frames, points) = (tracks.pixels.len(), tracks.query_frame.len());
    let query = |(k, &t): (usize, &u32)| {
        let at = tracks.pixels.get(t as usize).and_then(|row| row.get(k)).copied().unwrap_or_default();
        [t as f32, at[0], at[1]]
    };
    let pixels = tracks.pixels.iter().flatten().flatten().copied().collect();
    let queries = tracks.query_frame.iter().enumerate().flat_map(query).collect();
    saved(
        path,
        vec![
            ("tracks", vec![frames, points, 2], Values::F32(pixels)),
            ("visibility", vec![frames, points], Values::F32(tracks.confidence.iter().flatten().copied().collect())),
            ("queries", vec![points, 3], Values::F32(queries)),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_survive_and_the_forms_of_other_programs_are_read() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("tracks.npz");
        let tracks = Tracks {
            pixels: vec![vec![[1.5, 2.5], [3.25, 4.0]]; 3],
            confidence: vec![vec![0.5, 1.0], vec![0.0, 0.25], vec![1.0, 0.0]],
            query_frame: vec![0, 2],
        };
        write_tracks(&path, &tracks).expect("writes");
        let back = read_tracks(&path, Some(3)).expect("reads");
        assert_eq!(
            (back.pixels, back.confidence, back.query_frame),
            (tracks.pixels, tracks.confidence, tracks.query_frame)
        );
        // Two points in three frames, point by point, with what is hidden.
        let points: Vec<f32> = (0..12).map(|i| i as f32).collect();
        let occluded = vec![false, true, false, false, false, true];
        saved(
            &path,
            vec![
                ("points", vec![2, 3, 2], Values::F32(points.clone())),
                ("occluded", vec![2, 3], Values::Bool(occluded)),
            ],
        )
        .expect("writes");
        let tapir = read_tracks(&path, Some(3)).expect("reads");
        assert_eq!(tapir.pixels[1], [[2.0, 3.0], [8.0, 9.0]]);
        assert_eq!(tapir.confidence, [[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]]);
        // A batch of one, visibility and confidence beside each other.
        let pairs = Values::F32(vec![1.0, 0.5, 1.0, 1.0, 0.0, 1.0, 0.5, 0.5, 1.0, 1.0, 1.0, 0.0]);
        saved(&path, vec![("trajs", vec![1, 3, 2, 2], Values::F32(points)), ("visconf", vec![1, 3, 2, 2], pairs)])
            .expect("writes");
        let all = read_tracks(&path, Some(3)).expect("reads");
        assert_eq!((all.pixels[1][1], all.confidence[1].clone()), ([6.0, 7.0], vec![0.0, 0.25]));
    }
}
