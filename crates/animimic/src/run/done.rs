//! Finished runs: their files with their hashes, under the key of all that they were made from.

use super::{Kept, Key, Record, Run};
use crate::Error;
use serde_json::Value;
use std::path::{Path, PathBuf};

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
    /// Notes that the run's files are all there.
    ///
    /// # Errors
    /// The disk.
    pub fn finish(&self, out: &Path, key: &Key, files: &[PathBuf]) -> Result<(), Error> {
        self.save(NAME, key, &Done::of(out, files)?)
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
