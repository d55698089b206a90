//! Progress on standard error, and Ctrl-C.

use crate::Common;
use animimic::Event;
use animimic::generate::Host;
use indicatif::{ProgressBar, ProgressStyle};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Exit code of a program ended by Ctrl-C, by convention of shells.
const INTERRUPT_EXIT: i32 = 130;

/// The first Ctrl-C asks the computation to stop cleanly; the second ends the program at once. Files are whole either way.
pub fn catch_interrupts() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(INTERRUPT_EXIT);
        }
    })?;
    Ok(())
}

/// A progress bar that listens to events. Silent when quiet; indicatif hides it where standard error is no terminal.
pub struct Bar {
    bar: Option<ProgressBar>,
}

/// Longest time that a Ctrl-C goes unseen while waiting.
const INTERRUPT_DELAY: Duration = Duration::from_millis(50);

/// Steps of the bar: shares are shown to a thousandth.
const STEPS: u64 = 1000;

impl Bar {
    pub fn new(common: &Common) -> Self {
        let style = ProgressStyle::with_template("{msg:28} {bar:32} {percent:>3} %  {elapsed} (left {eta})")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = (!common.quiet).then(|| ProgressBar::new(STEPS).with_style(style));
        if let Some(bar) = &bar {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Self { bar }
    }

    /// Shows an event; asks to stop after Ctrl-C.
    pub fn on_event(&mut self, event: Event) -> ControlFlow<()> {
        if let Some(bar) = &self.bar {
            match event {
                Event::Stage { name } => {
                    bar.reset();
                    bar.set_message(name);
                }
                Event::Step { done, loss } => {
                    bar.set_position((done.clamp(0.0, 1.0) * STEPS as f64) as u64);
                    if let Some(loss) = loss {
                        let stage = bar.message();
                        let stage = stage.split("  loss").next().unwrap_or_default();
                        bar.set_message(format!("{stage}  loss {loss:.4e}"));
                    }
                }
                Event::Warning(text) => bar.suspend(|| eprintln!("warning: {text}")),
            }
        }
        if INTERRUPTED.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// The world of [`animimic::generate`]: the clock, sleep that Ctrl-C ends, the environment, and news for the bar.
impl Host for Bar {
    fn unix_secs(&self) -> u64 {
        SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
    }

    fn wait(&mut self, secs: f64) -> ControlFlow<()> {
        let end = Instant::now() + Duration::from_secs_f64(secs.max(0.0));
        while !INTERRUPTED.load(Ordering::SeqCst) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return ControlFlow::Continue(());
            }
            std::thread::sleep(left.min(INTERRUPT_DELAY));
        }
        ControlFlow::Break(())
    }

    fn variable(&self, name: &str) -> Option<String> {
        std::env::var(name).ok()
    }

    fn news(&mut self, words: &'static str) {
        // Whether to stop is asked by `wait`.
        let _ = self.on_event(Event::Stage { name: words });
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
