//! The program under limits, and files to throw at it.
#![allow(dead_code, clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The limits: address space [KiB], which bounds memory from above, and processor time [s].
const MEMORY_KIB: u64 = 1 << 20;
const CPU_SECS: u64 = 1;

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub fn example(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/creature").join(name).display().to_string()
}

/// Runs the program; a child that takes more memory or time than it may is killed, which no assertion on exit codes forgives.
pub fn limited(arguments: &[&str], cpu_secs: Option<u64>) -> Output {
    let program = env!("CARGO_BIN_EXE_animimic");
    if cfg!(not(unix)) {
        return Command::new(program).args(arguments).output().unwrap();
    }
    let time = cpu_secs.map_or(String::new(), |s| format!("ulimit -t {s};"));
    let script = format!("ulimit -v {MEMORY_KIB}; {time} exec \"$0\" \"$@\"");
    Command::new("sh").args(["-c", &script, program]).args(arguments).output().unwrap()
}

/// A folder with inputs, and one for results that must stay empty.
pub struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("results")).unwrap();
        Self { folder }
    }

    /// The path of an input.
    pub fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    /// The path of a result.
    pub fn out(&self, name: &str) -> String {
        self.folder.path().join("results").join(name).display().to_string()
    }

    pub fn put(&self, name: &str, bytes: &[u8]) -> String {
        std::fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }

    /// What was written.
    pub fn results(&self) -> Vec<PathBuf> {
        std::fs::read_dir(self.folder.path().join("results")).unwrap().map(|e| e.unwrap().path()).collect()
    }

    /// The program must refuse: exit 1, one sentence that names the file and says `words`, nothing on standard output, nothing
    /// written, within a second of processor time and a gibibyte.
    pub fn refuses(&self, arguments: &[&str], words: &[&str]) -> String {
        let out = limited(arguments, Some(CPU_SECS));
        let error = text(&out.stderr);
        println!("{}: {}", arguments[0], error.trim_end());
        assert_eq!(out.status.code(), Some(1), "{arguments:?}: {:?} {error}", out.status);
        assert!(error.starts_with("animimic: ") && error.trim_end().lines().count() == 1, "{error}");
        for word in words {
            assert!(error.contains(word), "{error:?} does not say {word:?}");
        }
        assert!(out.stdout.is_empty());
        assert_eq!(self.results(), Vec::<PathBuf>::new(), "{arguments:?} left something");
        error
    }

    /// The program must do it within the memory, and its warnings must say `words`.
    pub fn does(&self, arguments: &[&str], words: &[&str]) -> Output {
        let out = limited(arguments, None);
        let said = text(&out.stderr);
        println!("{}: {}", arguments[0], said.trim_end());
        assert!(out.status.success(), "{arguments:?}: {said}");
        for word in words {
            assert!(said.contains(word), "{said:?} does not say {word:?}");
        }
        out
    }
}
