//! From time stamps to frames at a constant rate.

/// Which source frame is shown at each output time.
#[derive(Clone, Debug, PartialEq)]
pub struct Resampling {
    /// Output frames per second.
    pub fps: f64,
    /// Source frame \[output frame\].
    pub source: Vec<usize>,
}

/// A stamp may be off its place on an even grid by this share of the frame interval and still be jitter
/// (24 fps stamped on a 60 Hz clock is off by up to 0.4).
const MAX_JITTER: f64 = 0.45;
/// Stamps can claim any length; no more output frames than this are made of them.
const MAX_FRAMES: usize = 1_000_000;
/// Frame rates within this factor of the limit are not reduced (30.003 is 30).
const RATE_SLACK: f64 = 1.02;

/// Resamples stamps [s] (strictly increasing) to at most `max_fps`.
///
/// Evenly spaced stamps, up to jitter, keep every n-th frame and never drop or double one. Otherwise every output
/// frame shows the source frame that a player would show at its middle.
pub fn resample(times_secs: &[f64], max_fps: f64) -> Resampling {
    let n = times_secs.len();
    if n < 2 {
        return Resampling { fps: max_fps.min(24.0), source: (0..n).collect() };
    }
    if let Some(interval) = even_interval(times_secs) {
        let rate = nominal_rate(1.0 / interval);
        let step = ((rate / (max_fps * RATE_SLACK)).ceil() as usize).max(1);
        return Resampling { fps: rate / step as f64, source: (0..n).step_by(step).collect() };
    }
    let mut intervals: Vec<f64> = times_secs.windows(2).map(|w| w[1] - w[0]).collect();
    intervals.sort_by(f64::total_cmp);
    let typical = intervals[intervals.len() / 2];
    let fps = nominal_rate(1.0 / typical).min(max_fps);
    let end = times_secs[n - 1] + typical;
    let count = ((end * fps).round() as usize).clamp(1, MAX_FRAMES);
    let source = (0..count)
        .map(|k| {
            let middle = (k as f64 + 0.5) / fps;
            times_secs.partition_point(|&t| t <= middle).saturating_sub(1)
        })
        .collect();
    Resampling { fps, source }
}

/// Interval [s] of the best even grid t_k ≈ a + k·dt, when every stamp lies near its own grid point.
fn even_interval(times_secs: &[f64]) -> Option<f64> {
    let n = times_secs.len() as f64;
    let mean_k = (n - 1.0) / 2.0;
    let mean_t = times_secs.iter().sum::<f64>() / n;
    let (mut skk, mut skt) = (0.0, 0.0);
    for (k, t) in times_secs.iter().enumerate() {
        let dk = k as f64 - mean_k;
        skk += dk * dk;
        skt += dk * (t - mean_t);
    }
    let dt = skt / skk;
    let off = |(k, t): (usize, &f64)| (t - mean_t - (k as f64 - mean_k) * dt).abs();
    let worst = times_secs.iter().enumerate().map(off).fold(0.0, f64::max);
    (dt > 0.0 && worst < MAX_JITTER * dt).then_some(dt)
}

/// Rates within half a percent of a whole number are that number: stamps are rounded to the container's clock.
fn nominal_rate(rate: f64) -> f64 {
    let whole = rate.round();
    // 24000/1001 and its kin differ by 0.1 % and are kept.
    if whole >= 1.0 && (rate - whole).abs() < 3e-4 * whole { whole } else { rate }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_stamps_keep_every_frame_up_to_the_limit_and_every_nth_beyond() {
        let even =
            |fps: f64, n: usize| (0..n).map(|i| (i as f64 / fps * 15360.0).round() / 15360.0).collect::<Vec<_>>();
        for (fps, limit, step, out) in [
            (24.0, 30.0, 1, 24.0),
            (30.0, 30.0, 1, 30.0),
            (60.0, 30.0, 2, 30.0),
            (120.0, 30.0, 4, 30.0),
            (50.0, 30.0, 2, 25.0),
        ] {
            let r = resample(&even(fps, 61), limit);
            assert_eq!(r.source, (0..61).step_by(step).collect::<Vec<_>>(), "{fps}");
            assert!((r.fps - out).abs() < 1e-9, "{} for {fps}", r.fps);
        }
        let ntsc = resample(&even(24000.0 / 1001.0, 100), 30.0);
        assert!((ntsc.fps - 23.976).abs() < 2e-3, "{}", ntsc.fps);
    }

    #[test]
    fn film_stamped_on_a_60_hz_clock_keeps_every_frame() {
        let stamps: Vec<f64> = (0..121).map(|k| (f64::from(k) * 2.5).floor() / 60.0).collect();
        let r = resample(&stamps, 30.0);
        assert_eq!(r.source, (0..121).collect::<Vec<_>>());
        assert!((r.fps - 24.0).abs() < 0.05, "{}", r.fps);
    }

    #[test]
    fn a_held_frame_is_repeated_for_as_long_as_it_is_shown() {
        let mut stamps: Vec<f64> = (0..10).map(|k| f64::from(k) * 0.04).collect();
        stamps.extend((0..10).map(|k| 1.36 + f64::from(k) * 0.04));
        let r = resample(&stamps, 30.0);
        assert_eq!(r.fps, 25.0);
        assert_eq!(r.source.iter().filter(|&&s| s == 9).count(), 25);
        assert_eq!(r.source.len(), 44);
    }
}
