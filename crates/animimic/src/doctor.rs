//! What this machine offers, and how to get what it lacks.

use crate::generate::{Host, PROVIDERS, Provider, keys_set};
use crate::run::memory::total_and_free;
use animimic_video::source::SOURCES;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// How a finding is to be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// As it should be.
    Good,
    /// Something more could be had.
    Optional,
    /// Work may fail.
    Lacking,
}

impl State {
    /// The word that stands before the finding.
    pub fn word(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Optional => "-",
            Self::Lacking => "!!",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug)]
pub struct Finding {
    /// What was looked at.
    pub what: String,
    /// How it is to be taken.
    pub state: State,
    /// What was found.
    pub found: String,
    /// What to do to have more of it.
    pub fix: Option<String>,
}

impl Finding {
    /// A flat JSON object.
    pub fn to_json(&self) -> Value {
        let state = match self.state {
            State::Good => "good",
            State::Optional => "optional",
            State::Lacking => "lacking",
        };
        json!({"what": self.what, "state": state, "found": self.found, "fix": self.fix})
    }

    fn new(what: impl Into<String>, found: impl Into<String>) -> Self {
        Self { what: what.into(), state: State::Good, found: found.into(), fix: None }
    }

    fn unless(self, good: bool, state: State, fix: impl Into<String>) -> Self {
        if good { self } else { Self { state, fix: Some(fix.into()), ..self } }
    }
}

/// Free memory below which is warned [bytes]: a choice, five times what six frames of the example took.
const WANTED_MEMORY: u64 = 1 << 30;
/// Room that a run may take in the temporary folder [bytes].
const WANTED_ROOM: u64 = 1 << 30;

/// Looks at everything. Never fails: what cannot be found out is said so.
pub fn examine(host: &dyn Host) -> Vec<Finding> {
    let mut findings = vec![processors(), threads(), memory(), temporary(&std::env::temp_dir())];
    findings.extend(codecs());
    findings.push(ffmpeg());
    findings.extend(PROVIDERS.iter().map(|p| provider(*p, host)));
    findings
}

fn processors() -> Finding {
    let count = std::thread::available_parallelism().map_or(1, usize::from);
    Finding::new("processors", format!("{count} ({})", std::env::consts::ARCH))
}

fn threads() -> Finding {
    let (used, there) = (rayon::current_num_threads(), std::thread::available_parallelism().map_or(1, usize::from));
    Finding::new("threads", format!("{used} are used")).unless(
        used >= there,
        State::Optional,
        "leave out --threads to use every processor; the result is the same",
    )
}

fn memory() -> Finding {
    let Some((total, free)) = total_and_free() else {
        return Finding::new("memory", "unknown on this system");
    };
    Finding::new("memory", format!("{} of {} free", gib(free), gib(total))).unless(
        free >= WANTED_MEMORY,
        State::Lacking,
        "close other programs, or work on less at once: --height 256, fewer --frames",
    )
}

fn temporary(folder: &Path) -> Finding {
    let what = "temporary folder";
    let written = tempfile::NamedTempFile::new_in(folder).and_then(|mut f| f.write_all(b"animimic"));
    let fix = "set TMPDIR to a folder that can be written to and has room";
    if let Err(e) = written {
        let found = format!("{} cannot be written to: {e}", folder.display());
        return Finding { state: State::Lacking, fix: Some(fix.into()), ..Finding::new(what, found) };
    }
    match room_bytes(folder) {
        Some(room) => Finding::new(what, format!("{}, {} free", folder.display(), gib(room))).unless(
            room >= WANTED_ROOM,
            State::Lacking,
            fix,
        ),
        None => Finding::new(what, format!("{} can be written to", folder.display())),
    }
}

/// Free room of the folder's file system [bytes].
#[cfg(unix)]
fn room_bytes(folder: &Path) -> Option<u64> {
    let told = rustix::fs::statvfs(folder).ok()?;
    Some(told.f_bavail.saturating_mul(told.f_frsize))
}

/// Other systems are not asked.
#[cfg(not(unix))]
fn room_bytes(_folder: &Path) -> Option<u64> {
    None
}

fn codecs() -> [Finding; 2] {
    let read: Vec<&str> = SOURCES.iter().map(|s| s.name()).collect();
    let detail = "H.264 in MP4 is decoded and encoded here";
    [
        Finding::new("videos read", format!("{}; {detail}", read.join(", "))),
        Finding::new("videos written", "MP4 (H.264), GIF, PNG"),
    ]
}

/// What a system ffmpeg adds to what is built in.
const FFMPEG_ADDS: &str = "HEVC, VP9, AV1, 10-bit and 4:4:4 H.264, WebM, MKV and AVI";

fn ffmpeg() -> Finding {
    let run = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).stderr(Stdio::null()).output();
    let first = |out: Vec<u8>| String::from_utf8_lossy(&out).lines().next().unwrap_or_default().to_owned();
    match run {
        Ok(out) if out.status.success() => {
            let line = first(out.stdout);
            let version = line.split_whitespace().nth(2).unwrap_or("of unknown version").to_owned();
            Finding::new("ffmpeg", format!("{version}; adds {FFMPEG_ADDS}"))
        }
        _ => Finding::new("ffmpeg", "none, and none is needed for H.264 MP4, GIF, WebP and folders of frames").unless(
            false,
            State::Optional,
            format!("install ffmpeg to read {FFMPEG_ADDS}"),
        ),
    }
}

fn provider(provider: &dyn Provider, host: &dyn Host) -> Finding {
    let about = provider.about();
    let what = format!("provider {}", about.name);
    if about.keys.is_empty() {
        return Finding::new(what, "needs no key");
    }
    match keys_set(about, host) {
        Some(names) => Finding::new(what, format!("{} set", names.join(", "))),
        None => {
            let names: Vec<&str> = about.keys.iter().filter_map(|k| k.variables.last().copied()).collect();
            Finding::new(what, "no key").unless(false, State::Optional, format!("set {}", names.join(" and ")))
        }
    }
}

fn gib(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / (1u64 << 30) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ops::ControlFlow;

    struct With(&'static [(&'static str, &'static str)]);

    impl Host for With {
        fn unix_secs(&self) -> u64 {
            0
        }
        fn wait(&mut self, _secs: f64) -> ControlFlow<()> {
            ControlFlow::Continue(())
        }
        fn variable(&self, name: &str) -> Option<String> {
            self.0.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
        }
    }

    #[test]
    fn keys_are_told_by_name_and_never_by_value() {
        let host = With(&[("FAL_KEY", "verysecret"), ("KLING_ACCESS_KEY", "half"), ("REPLICATE_API_TOKEN", "  ")]);
        let findings = examine(&host);
        let of = |name: &str| findings.iter().find(|f| f.what == name).expect("looked at");
        for f in &findings {
            println!("{f:?}");
            assert!(!f.to_json().to_string().contains("verysecret"));
            assert_eq!(f.fix.is_some(), f.state != State::Good, "{}", f.what);
        }
        assert_eq!(of("provider fal").found, "FAL_KEY set");
        assert_eq!(of("provider kling").state, State::Optional, "one of two keys");
        assert_eq!(of("provider replicate").state, State::Optional, "a blank key");
    }

    #[test]
    fn a_temporary_folder_that_is_not_there_is_lacking_and_has_a_fix() {
        let bad = temporary(Path::new("/nowhere/at/all"));
        println!("{bad:?}");
        assert!(bad.state == State::Lacking && bad.fix.is_some());
        let folder = tempfile::tempdir().expect("made");
        let good = temporary(folder.path());
        println!("{good:?}");
        assert!(good.found.contains("free") && std::fs::read_dir(folder.path()).expect("listed").count() == 0);
    }
}
