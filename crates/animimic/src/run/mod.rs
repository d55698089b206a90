//! Runs that can be trusted: one at a time in a folder, and what is done is never done again.
//!
//! `DIR/state/` holds what each finished stage found, under the SHA-256 of all that it was found from: the inputs as they were
//! read, the options, the program. A run that was cut off at any time goes on with `--resume`: stages whose hash is the same are
//! taken from there to the last bit, the others are done. `DIR/state/lock` is held while a run works.

mod digest;
mod done;
mod keeper;
mod lock;
pub(crate) mod memory;
mod record;

pub use digest::Key;
pub use done::Done;
pub use keeper::Checkpoints;
pub use lock::Lock;

pub use record::{Kept, Record};

use crate::Error;
use animimic_scene::io;
use std::path::{Path, PathBuf};

/// A run in a folder, or one that keeps nothing.
#[derive(Debug, Default)]
pub struct Run {
    place: Option<Place>,
}

/// Where a run keeps what it found; folders that it made are removed with it where they are still empty.
#[derive(Debug)]
struct Place {
    state: PathBuf,
    resume: bool,
    made: Vec<PathBuf>,
    lock: Option<Lock>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.lock.take();
        // Folders that hold something are kept by the system itself.
        for folder in &self.made {
            let _ = std::fs::remove_dir(folder);
        }
    }
}

impl Run {
    /// Begins a run in the folder `out`, made if absent; with `resume`, what earlier runs found is taken where it fits.
    ///
    /// # Errors
    /// [`Error::Busy`] where another run works there, [`Error::Io`] where nothing can be written.
    pub fn begin(out: &Path, resume: bool) -> Result<Self, Error> {
        let state = out.join("state");
        let made: Vec<PathBuf> =
            state.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists()).map(Path::to_owned).collect();
        let mut place = Place { state, resume, made, lock: None };
        std::fs::create_dir_all(&place.state).map_err(Error::io(&place.state))?;
        place.lock = Some(Lock::take(&place.state.join("lock"), out)?);
        io::sweep(&place.state, true);
        io::sweep(out, false);
        Ok(Self { place: Some(place) })
    }

    /// The folder of what is kept.
    pub(crate) fn state(&self) -> Option<&Path> {
        self.place.as_ref().map(|p| p.state.as_path())
    }

    /// What was kept under a name and key, if it may be taken.
    pub fn load<T: Kept>(&self, name: &str, key: &Key) -> Option<T> {
        let place = self.place.as_ref().filter(|p| p.resume)?;
        Record::read(&file(&place.state, name), key).and_then(T::from_record)
    }

    /// Keeps something under a name and key.
    ///
    /// # Errors
    /// The disk.
    pub fn save<T: Kept>(&self, name: &str, key: &Key, found: &T) -> Result<(), Error> {
        let Some(place) = &self.place else { return Ok(()) };
        found.to_record().write(&file(&place.state, name), key)
    }

    /// What `work` finds, or found before.
    ///
    /// # Errors
    /// Those of `work`, and the disk.
    pub fn kept<T: Kept>(&self, name: &str, key: &Key, work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        if let Some(found) = self.load(name, key) {
            return Ok(found);
        }
        let found = work()?;
        self.save(name, key, &found)?;
        Ok(found)
    }

    /// Forgets all that was kept under names that begin so.
    pub fn forget(&self, beginning: &str) {
        let Some(entries) = self.state().and_then(|s| std::fs::read_dir(s).ok()) else { return };
        for path in entries.flatten().map(|e| e.path()) {
            if path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(beginning)) {
                // What cannot be removed does no harm: its key tells what it is.
                let _ = std::fs::remove_file(path);
            }
        }
    }
}

fn file(state: &Path, name: &str) -> PathBuf {
    state.join(format!("{name}.npz"))
}

/// A name fit for a file.
pub(crate) fn safe(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    impl Kept for Vec<f64> {
        fn to_record(&self) -> Record {
            Record { json: json!({ "count": self.len() }), arrays: Vec::new() }.with_f64(
                "v",
                &[self.len()],
                self.clone(),
            )
        }
        fn from_record(record: Record) -> Option<Self> {
            record.f64s("v")
        }
    }

    #[test]
    fn what_was_found_is_taken_again_bit_by_bit_under_the_same_key_only() {
        let folder = tempfile::tempdir().expect("made");
        let out = folder.path().join("a/b");
        let (key, other) = (Key::new("one"), Key::new("two"));
        let found = vec![0.1, -0.0, f64::NAN, f64::MIN_POSITIVE / 8.0, 1.0 / 3.0];
        let bits = |v: &[f64]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let first = Run::begin(&out, false).expect("begins");
        assert_eq!(bits(&first.kept("x", &key, || Ok(found.clone())).expect("kept")), bits(&found));
        assert_eq!(first.kept("x", &key, || Ok(vec![5.0])).expect("fresh"), [5.0], "no resume: done again");
        first.save("x", &key, &found).expect("kept");
        drop(first);
        let again = Run::begin(&out, true).expect("begins");
        let taken: Vec<f64> = again.kept("x", &key, || panic!("it is there")).expect("kept");
        assert_eq!(bits(&taken), bits(&found));
        assert_eq!(again.kept("x", &other, || Ok(vec![6.0])).expect("another key"), [6.0]);
        std::fs::write(out.join("state/x.npz"), b"PK half a file").expect("written");
        assert!(again.load::<Vec<f64>>("x", &other).is_none(), "a broken file is no result");
        again.forget("x");
        assert!(!out.join("state/x.npz").exists());
    }

    #[test]
    fn a_run_that_found_nothing_leaves_nothing() {
        let folder = tempfile::tempdir().expect("made");
        drop(Run::begin(&folder.path().join("a/b/c"), false).expect("begins"));
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0);
        std::fs::create_dir(folder.path().join("own")).expect("made");
        drop(Run::begin(&folder.path().join("own"), false).expect("begins"));
        assert!(folder.path().join("own").exists() && !folder.path().join("own/state").exists());
    }
}
