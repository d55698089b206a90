//! Finished runs: their files with their hashes, under the key of all that they were made from.

use super::{Kept, Key, Record, Run};
use crate::Error;
use serde_json::Value;
use std::path::{Component, Path, PathBuf};

/// Files of a finished run: paths relative to its folder, and the hash of their bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Done(Vec<(String, String)>);

/// Name under which it is kept.
const NAME: &str = "done";

impl Done {
    /// The files as they are now.
    ///
    /// # Errors
    /// [`Error::Io`] where one cannot be read.
    pub fn of(out: &Path, files: &[PathBuf]) -> Result<Self, Error> {
        let entry = |path: &PathBuf| {
            let name = path.strip_prefix(out).unwrap_or(path).to_string_lossy().into_owned();
            Ok((name, Key::new("file").and_path(path)?.to_string()))
        };
        Ok(Self(files.iter().map(entry).collect::<Result<_, Error>>()?))
    }

    /// Removes those files that `now` has no more and that nobody has changed since: beside new results they would pass for new.
    fn clear(&self, out: &Path, now: &Self) {
        let inside = |name: &str| Path::new(name).components().all(|c| matches!(c, Component::Normal(_)));
        for (name, hash) in self.0.iter().filter(|(name, _)| inside(name) && !now.0.iter().any(|n| n.0 == *name)) {
            let path = out.join(name);
            if Key::new("file").and_path(&path).is_ok_and(|key| key.to_string() == *hash) {
                // What cannot be removed stays.
                let _ = std::fs::remove_file(path);
            }
        }
    }

    /// Whether the files are still those.
    fn holds(&self, out: &Path) -> bool {
        let same = |(name, hash): &(String, String)| {
            let now = Key::new("file").and_path(&out.join(name));
            now.is_ok_and(|key| key.to_string() == *hash)
        };
        !self.0.is_empty() && self.0.iter().all(same)
    }
}

impl Kept for Done {
    fn to_record(&self) -> Record {
        let pairs: Vec<[&str; 2]> = self.0.iter().map(|(name, hash)| [name.as_str(), hash.as_str()]).collect();
        Record { json: serde_json::json!(pairs), arrays: Vec::new() }
    }

    fn from_record(record: Record) -> Option<Self> {
        let pair = |v: &Value| Some((v.get(0)?.as_str()?.to_owned(), v.get(1)?.as_str()?.to_owned()));
        Some(Self(record.json.as_array()?.iter().map(pair).collect::<Option<_>>()?))
    }
}

impl Run {
    /// Notes that the run's files are all there, and removes those of the run before that this one did not write again.
    ///
    /// # Errors
    /// The disk.
    pub fn finish(&self, out: &Path, key: &Key, files: &[PathBuf]) -> Result<(), Error> {
        let now = Done::of(out, files)?;
        let before = self.state().and_then(|state| Record::read_any(&super::file(state, NAME)));
        if let Some(before) = before.and_then(Done::from_record) {
            before.clear(out, &now);
        }
        self.save(NAME, key, &now)
    }

    /// Whether some run finished here, and may be taken: cheap to ask before its key is computed.
    pub fn may_be_finished(&self) -> bool {
        self.place.as_ref().is_some_and(|p| p.resume && super::file(&p.state, NAME).exists())
    }

    /// Whether a run with that key finished here and its files are as it left them.
    pub fn is_finished(&self, out: &Path, key: &Key) -> bool {
        self.load::<Done>(NAME, key).is_some_and(|done| done.holds(out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_later_run_does_not_write_again_goes_unless_someone_changed_it() {
        let folder = tempfile::tempdir().expect("made");
        let out = folder.path();
        let files = |names: &[&str]| names.iter().map(|n| out.join(n)).collect::<Vec<_>>();
        let write = |name: &str, text: &str| std::fs::write(out.join(name), text).expect("written");
        for name in ["animated.glb", "soft.glb", "views.mp4", "own.txt"] {
            write(name, name);
        }
        let run = Run::begin(out, false).expect("begins");
        run.finish(out, &Key::new("one"), &files(&["animated.glb", "soft.glb", "views.mp4"])).expect("noted");
        write("views.mp4", "cut by its owner");
        write("animated.glb", "new");
        run.finish(out, &Key::new("two"), &files(&["animated.glb"])).expect("noted");
        let there = ["animated.glb", "soft.glb", "views.mp4", "own.txt"].map(|n| out.join(n).exists());
        assert_eq!(there, [true, false, true, true]);
        assert!(Run::begin(out, true).is_err(), "one run at a time");
        drop(run);
        assert!(Run::begin(out, true).expect("begins").is_finished(out, &Key::new("two")));
    }
}
