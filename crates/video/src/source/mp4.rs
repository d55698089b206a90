//! MP4 (ISO/IEC 14496-12) with H.264: demultiplexed by `re_mp4`, decoded by `rusty_h264`.
//!
//! A frame's time is its sample's composition time, so B-frames need no reordering by picture order count. We apply
//! what the two libraries leave out: edit lists, track rotation, VUI colour, and a bound on everything read from the file.

use super::{Decoded, Opened, Picture, Source};
use crate::color::{ColorSpace, rgb_from_yuv};
use crate::error::{Result, VideoError};
use crate::h264;
use crate::quiet::catch_quietly;
use crate::turn::Turn;
use rayon::prelude::*;
use rusty_h264::{DecodeError, Decoder, YuvFrame};
use std::path::{Path, PathBuf};

/// Largest file that is read into memory [bytes].
const MAX_FILE_BYTES: u64 = 2 << 30;
/// Largest number of samples that a file may promise: nine hours at 30 frames a second.
const MAX_SAMPLES: u64 = 1_000_000;
/// After this many lost frames decoding ends: the file is hopeless, its length a claim.
const MAX_LOST_IN_A_FILE: usize = 2_000;
/// Pictures converted to RGB at a time, in parallel.
const BATCH: usize = 16;

/// The MP4 source.
pub struct Mp4;

impl Source for Mp4 {
    fn name(&self) -> &'static str {
        "H.264 MP4"
    }

    fn accepts(&self, _path: &Path, head: &[u8]) -> bool {
        head.get(4..8).is_some_and(|kind| matches!(kind, b"ftyp" | b"moov" | b"mdat" | b"wide" | b"free" | b"styp"))
    }

    fn open(&self, path: &Path) -> Result<Box<dyn Opened>> {
        Self::open_file(path)
    }
}

impl Mp4 {
    /// Demultiplexes a file.
    pub fn open_file(path: &Path) -> Result<Box<dyn Opened>> {
        let bytes = std::fs::metadata(path).map_err(VideoError::io(path))?.len();
        if bytes > MAX_FILE_BYTES {
            return Err(VideoError::Limit {
                path: path.into(),
                reason: format!("{bytes} bytes are more than the {MAX_FILE_BYTES} that are read; cut the video first"),
            });
        }
        let data = std::fs::read(path).map_err(VideoError::io(path))?;
        Ok(Box::new(Movie::parse(path, data)?))
    }
}

/// One access unit of the file.
struct Sample {
    bytes: std::ops::Range<usize>,
    /// Index among the displayed frames; `None` for samples that the edit list hides.
    shown_as: Option<usize>,
}

/// A demultiplexed movie.
struct Movie {
    path: PathBuf,
    data: Vec<u8>,
    samples: Vec<Sample>,
    times_secs: Vec<f64>,
    parameter_sets: Vec<u8>,
    length_size: usize,
    color: ColorSpace,
    size: (usize, usize),
    turn: Turn,
    warnings: Vec<String>,
}

impl Movie {
    fn parse(path: &Path, data: Vec<u8>) -> Result<Self> {
        check_boxes(path, &data)?;
        let mp4 = catch_quietly(|| re_mp4::Mp4::read(Bounded::new(&data), data.len() as u64))
            .map_err(|_| {
                VideoError::invalid(path, "the MP4's sample tables contradict each other; record or convert it anew")
            })?
            .map_err(|e| VideoError::invalid(path, format!("broken MP4: {e}; record or convert it anew")))?;
        let track = mp4
            .tracks()
            .values()
            .find(|t| t.kind == Some(re_mp4::TrackKind::Video))
            .or_else(|| mp4.tracks().values().find(|t| t.width > 0 && t.height > 0))
            .ok_or_else(|| VideoError::invalid(path, "the MP4 has no video track; give a file with moving pictures"))?;
        let trak = track.trak(&mp4);
        let re_mp4::StsdBoxContent::Avc1(avc1) = &trak.mdia.minf.stbl.stsd.contents else {
            let codec = track.codec_string(&mp4).unwrap_or_else(|| "of an unknown kind".into());
            return Err(super::ffmpeg::unsupported(path, format!("the video codec ({codec}) is not H.264")));
        };
        let avcc = &avc1.avcc.contents;
        let mut warnings = Vec::new();
        let (info, parameter_sets) = read_parameter_sets(path, avc1)?;
        if track.samples.is_empty() {
            return Err(VideoError::invalid(path, "the MP4 holds no frames"));
        }
        if track.timescale == 0 {
            return Err(VideoError::invalid(path, "the MP4's frames have no time scale; record or convert it again"));
        }
        let times = DisplayTimes::of(&mp4, trak, track, &mut warnings);
        let turn = Turn::from_matrix(trak.tkhd.matrix.a, trak.tkhd.matrix.b, trak.tkhd.matrix.c, trak.tkhd.matrix.d)
            .unwrap_or_else(|| {
                warnings.push("the track's transformation is not a quarter turn or a flip and was ignored".into());
                Turn::default()
            });
        let color = info.color_space().unwrap_or_else(|| {
            warnings.push(format!("matrix coefficients {} are unknown, BT.601 was used", info.matrix_coefficients));
            ColorSpace::BT601
        });
        let samples = track
            .samples
            .iter()
            .zip(times.shown_as)
            .map(|(s, shown_as)| {
                let start = usize::try_from(s.offset).unwrap_or(usize::MAX).min(data.len());
                let end = usize::try_from(s.offset.saturating_add(s.size)).unwrap_or(usize::MAX);
                // A sample that reaches past the end of the file is empty: it counts as missing.
                Sample { bytes: if end > data.len() { start..start } else { start..end }, shown_as }
            })
            .collect();
        let size = turn.size(usize::from(avc1.width), usize::from(avc1.height));
        let length_size = usize::from(avcc.length_size_minus_one & 3) + 1;
        Ok(Self {
            path: path.into(),
            samples,
            times_secs: times.secs,
            parameter_sets,
            length_size,
            color,
            size,
            turn,
            warnings,
            data,
        })
    }
}

/// A file in memory that can be read from only so often: `re_mp4` loops for ever on some boxes that lead it backwards.
struct Bounded<'a> {
    bytes: std::io::Cursor<&'a [u8]>,
    reads_left: usize,
}

impl<'a> Bounded<'a> {
    fn new(data: &'a [u8]) -> Self {
        // A sound index is read once, a few bytes at a time.
        Self { bytes: std::io::Cursor::new(data), reads_left: 2 * data.len() + 4096 }
    }
}

impl std::io::Read for Bounded<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        self.reads_left =
            self.reads_left.checked_sub(1).ok_or_else(|| std::io::Error::other("its boxes run in circles"))?;
        self.bytes.read(out)
    }
}

impl std::io::Seek for Bounded<'_> {
    fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
        self.bytes.seek(to)
    }
}

/// Boxes that hold boxes, on the way to what `re_mp4` reads.
const CONTAINERS: [&[u8; 4]; 9] = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"mvex", b"moof", b"traf"];

fn be32(data: &[u8], at: usize) -> Option<u64> {
    data.get(at..at + 4).map(|b| u64::from(u32::from_be_bytes([b[0], b[1], b[2], b[3]])))
}

/// Walks the boxes in `from..to`: each must have a header and end inside its parent. `re_mp4` trusts their sizes and can
/// loop for ever on sizes that lead it backwards.
fn check_nesting(path: &Path, data: &[u8], from: usize, to: usize, depth: usize) -> Result<()> {
    let mut at = from;
    while at + 8 <= to {
        let kind: &[u8] = &data[at + 4..at + 8];
        let size = match be32(data, at) {
            Some(0) if depth == 0 => (to - at) as u64,
            Some(1) => (be32(data, at + 8).unwrap_or(0) << 32) | be32(data, at + 12).unwrap_or(0),
            size => size.unwrap_or(0),
        };
        let end = (at as u64).saturating_add(size);
        let is_data = depth == 0 && kind == b"mdat";
        if size < 8 || (end > to as u64 && !is_data) {
            let name: String = kind.iter().map(|&b| if b.is_ascii_graphic() { b as char } else { '?' }).collect();
            let reason = format!(
                "the box {name:?} at byte {at} of the MP4 claims {size} bytes, its place ends at byte {to}; record or download it again"
            );
            return Err(VideoError::invalid(path, reason));
        }
        if depth < 8 && CONTAINERS.iter().any(|c| c[..] == *kind) {
            check_nesting(path, data, at + 8, end as usize, depth + 1)?;
        }
        at = end.min(to as u64) as usize;
    }
    Ok(())
}

/// Bounds the counts that `re_mp4` trusts, before it allocates by them.
fn check_boxes(path: &Path, data: &[u8]) -> Result<()> {
    let find = |kind: &[u8; 4]| data.windows(4).position(|w| w == kind);
    if find(b"moov").is_none() {
        return Err(VideoError::invalid(
            path,
            format!(
                "the MP4 has no index (moov box) in its {} bytes: it was cut off or never finished; record or download it again",
                data.len()
            ),
        ));
    }
    check_nesting(path, data, 0, data.len(), 0)?;
    let count_at = |at: usize| be32(data, at);
    for (kind, offset) in [(b"stsz", 12), (b"trun", 8)] {
        let mut from = 0;
        while let Some(at) = data[from..].windows(4).position(|w| w == kind).map(|p| p + from) {
            // The four letters can also occur inside picture data: only what sits in a box of plausible size counts.
            let size = at.checked_sub(4).and_then(count_at).unwrap_or(0);
            if (16..data.len() as u64).contains(&size) && count_at(at + offset).is_some_and(|n| n > MAX_SAMPLES) {
                return Err(VideoError::invalid(
                    path,
                    format!("the MP4 promises more than {MAX_SAMPLES} frames at byte {at}"),
                ));
            }
            from = at + 4;
        }
    }
    Ok(())
}

/// Annex B parameter sets and what they say; refuses what the embedded decoder cannot do.
fn read_parameter_sets(path: &Path, avc1: &re_mp4::Avc1Box) -> Result<(h264::SequenceInfo, Vec<u8>)> {
    let avcc = &avc1.avcc.contents;
    let sets = avcc.sequence_parameter_sets.iter().chain(&avcc.picture_parameter_sets);
    let annex_b: Vec<u8> = sets.flat_map(|nal| [0, 0, 0, 1].into_iter().chain(nal.bytes.iter().copied())).collect();
    let info = avcc
        .sequence_parameter_sets
        .first()
        .and_then(|nal| h264::parse_sps(&nal.bytes))
        .ok_or_else(|| VideoError::invalid(path, "the H.264 sequence parameter set is missing or broken"))?;
    if info.chroma_format_idc != 1 || info.bit_depth != 8 {
        let chroma = ["4:0:0", "4:2:0", "4:2:2", "4:4:4"][info.chroma_format_idc.min(3) as usize];
        return Err(super::ffmpeg::unsupported(
            path,
            format!("H.264 with {chroma} chroma and {} bits", info.bit_depth),
        ));
    }
    Ok((info, annex_b))
}

/// When samples are shown.
struct DisplayTimes {
    /// [s], increasing, first at 0.
    secs: Vec<f64>,
    /// Position in `secs` \[sample in decode order\].
    shown_as: Vec<Option<usize>>,
}

impl DisplayTimes {
    fn of(mp4: &re_mp4::Mp4, trak: &re_mp4::TrakBox, track: &re_mp4::Track, warnings: &mut Vec<String>) -> Self {
        let timescale = track.timescale.max(1) as f64;
        let (start, end) = edit_window(mp4, trak, warnings);
        let mut order: Vec<usize> = (0..track.samples.len())
            .filter(|&i| {
                let t = track.samples[i].composition_timestamp as f64;
                // Half a tick of tolerance: edit lists are rounded to the movie's coarser time scale.
                let tick = 1.5 * timescale / mp4.moov.mvhd.timescale.max(1) as f64;
                t > start - tick && t < end - tick
            })
            .collect();
        if order.is_empty() {
            warnings.push("the edit list hides every frame and was ignored".into());
            order = (0..track.samples.len()).collect();
        }
        order.sort_by_key(|&i| (track.samples[i].composition_timestamp, i));
        let first = track.samples[order[0]].composition_timestamp;
        let mut shown_as = vec![None; track.samples.len()];
        let mut secs: Vec<f64> = Vec::with_capacity(order.len());
        for &i in &order {
            let t = (track.samples[i].composition_timestamp - first) as f64 / timescale;
            // Two frames at one time: the later one in the file is never seen.
            if secs.last().is_none_or(|&last| t > last) {
                shown_as[i] = Some(secs.len());
                secs.push(t);
            }
        }
        if secs.len() < order.len() {
            warnings
                .push(format!("{} frames share another frame's time stamp and were dropped", order.len() - secs.len()));
        }
        Self { secs, shown_as }
    }
}

/// What the edit list shows, in units of the track, relative to the smallest composition time (as `re_mp4` shifts them).
fn edit_window(mp4: &re_mp4::Mp4, trak: &re_mp4::TrakBox, warnings: &mut Vec<String>) -> (f64, f64) {
    let whole = (f64::NEG_INFINITY, f64::INFINITY);
    let Some(edits) = trak.edts.as_ref().and_then(|e| e.elst.as_ref()) else { return whole };
    let is_empty = |media_time: u64| media_time == u64::from(u32::MAX) || media_time == u64::MAX;
    let mut shown = edits.entries.iter().filter(|e| !is_empty(e.media_time));
    let Some(first) = shown.next() else { return whole };
    if shown.next().is_some() {
        warnings.push("the edit list has several parts; only the first is read".into());
    }
    let start = first.media_time as f64 - smallest_composition_time(trak) as f64;
    let per_movie_tick = f64::from(trak.mdia.mdhd.timescale) / f64::from(mp4.moov.mvhd.timescale.max(1));
    let length =
        if first.segment_duration == 0 { f64::INFINITY } else { first.segment_duration as f64 * per_movie_tick };
    (start, start + length)
}

/// The smallest composition time in the sample tables (0 for fragmented files, whose tables are empty).
fn smallest_composition_time(trak: &re_mp4::TrakBox) -> i64 {
    let stbl = &trak.mdia.minf.stbl;
    let Some(ctts) = &stbl.ctts else { return 0 };
    let run = |n: u32| n.min(MAX_SAMPLES as u32) as usize;
    let deltas =
        stbl.stts.entries.iter().flat_map(|e| std::iter::repeat_n(i64::from(e.sample_delta), run(e.sample_count)));
    let offsets =
        ctts.entries.iter().flat_map(|e| std::iter::repeat_n(i64::from(e.sample_offset), run(e.sample_count)));
    let mut decode_time = 0;
    let mut smallest = i64::MAX;
    for (delta, offset) in deltas.zip(offsets).take(MAX_SAMPLES as usize) {
        smallest = smallest.min(decode_time + offset);
        decode_time += delta;
    }
    if smallest == i64::MAX { 0 } else { smallest }
}

impl Opened for Movie {
    fn times_secs(&self) -> &[f64] {
        &self.times_secs
    }

    fn size(&self) -> (usize, usize) {
        self.size
    }

    fn decode(
        &self,
        wanted: &dyn Fn(usize) -> bool,
        finish: &(dyn Fn(Picture) -> Picture + Sync),
        sink: &mut dyn FnMut(usize, Picture),
    ) -> Result<Decoded> {
        let last_needed = self.samples.iter().rposition(|s| s.shown_as.is_some_and(wanted)).unwrap_or(0);
        let mut report = Decoded { warnings: self.warnings.clone(), ..Decoded::default() };
        let mut pictures = SampleDecoder::new(self);
        let mut batch: Vec<(usize, YuvFrame)> = Vec::with_capacity(BATCH);
        let mut flush = |batch: &mut Vec<(usize, YuvFrame)>| {
            let done: Vec<(usize, Picture)> = batch
                .par_drain(..)
                .map(|(i, yuv)| {
                    let image = self.turn.apply(rgb_from_yuv(&yuv, self.color));
                    (i, finish(Picture { image, alpha: None }))
                })
                .collect();
            for (i, picture) in done {
                sink(i, picture);
            }
        };
        for sample in &self.samples[..=last_needed] {
            let picture = pictures.next(sample)?;
            let Some(i) = sample.shown_as else { continue };
            report.promised += 1;
            let Some(yuv) = picture else {
                if report.promised - report.sound > MAX_LOST_IN_A_FILE {
                    break;
                }
                continue;
            };
            report.sound += 1;
            if wanted(i) {
                batch.push((i, yuv));
                if batch.len() == BATCH {
                    flush(&mut batch);
                }
            }
        }
        flush(&mut batch);
        if report.sound == 0 {
            return Err(VideoError::invalid(
                &self.path,
                format!("none of the {} frames can be decoded", report.promised),
            ));
        }
        Ok(report)
    }
}

/// Decodes samples in order and knows which of them are damaged by earlier losses.
struct SampleDecoder<'a> {
    movie: &'a Movie,
    decoder: Decoder,
    /// A reference picture was lost: what follows is not sound until the next IDR picture.
    damaged: bool,
    first: bool,
}

impl<'a> SampleDecoder<'a> {
    fn new(movie: &'a Movie) -> Self {
        Self { movie, decoder: Decoder::new(), damaged: false, first: true }
    }

    /// The sample's picture; `None` when it is lost or damaged. Fails on coding tools that the decoder lacks.
    fn next(&mut self, sample: &Sample) -> Result<Option<YuvFrame>> {
        let Some(unit) = h264::annex_b_from_sample(&self.movie.data[sample.bytes.clone()], self.movie.length_size)
        else {
            self.damaged = true;
            return Ok(None);
        };
        let (idr, reference) = h264::access_unit_kind(&unit);
        let mut stream = if self.first { self.movie.parameter_sets.clone() } else { Vec::new() };
        stream.extend_from_slice(&unit);
        self.first = false;
        if idr {
            self.damaged = false;
        }
        let decoder = &mut self.decoder;
        match catch_quietly(std::panic::AssertUnwindSafe(|| decoder.decode(&stream))) {
            Ok(Ok(Some(picture))) => Ok((!self.damaged).then_some(picture)),
            Ok(Err(DecodeError::Unsupported(tool))) => {
                Err(super::ffmpeg::unsupported(&self.movie.path, format!("H.264 with {tool}")))
            }
            Err(_panicked) => {
                self.decoder = Decoder::new();
                self.first = true;
                self.damaged = true;
                Ok(None)
            }
            Ok(Ok(None) | Err(_)) => {
                self.damaged |= reference || unit.is_empty();
                Ok(None)
            }
        }
    }
}

/// All displayed frames of a file as decoded, before any colour conversion, in display order: for conformance tests.
pub fn raw_frames(path: &Path) -> Result<Vec<YuvFrame>> {
    let movie = Movie::parse(path, std::fs::read(path).map_err(VideoError::io(path))?)?;
    let mut decoder = SampleDecoder::new(&movie);
    let mut frames = Vec::new();
    for sample in &movie.samples {
        if let (Some(frame), Some(shown)) = (decoder.next(sample)?, sample.shown_as) {
            frames.push((shown, frame));
        }
    }
    frames.sort_by_key(|(shown, _)| *shown);
    Ok(frames.into_iter().map(|(_, frame)| frame).collect())
}
