//! One run at a time: a file that the system itself keeps locked for as long as the process that locked it lives.
//!
//! So a lock never outlives its run, however that ended, and none has to be judged stale by its process number.

use crate::Error;
use serde_json::{Value, json};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A lock that is held; dropping it frees it and removes its file.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// Closing it frees the lock.
    _file: File,
}

impl Lock {
    /// Takes the lock `path`, which stands for `what`; its file tells who holds it.
    ///
    /// # Errors
    /// [`Error::Busy`] with process, machine and time of the run that holds it; [`Error::Io`].
    pub fn take(path: &Path, what: &Path) -> Result<Self, Error> {
        loop {
            let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
            let mut file = file.map_err(Error::io(path))?;
            match file.try_lock() {
                Ok(()) if !is_at(&file, path) => continue,
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::Busy { what: what.to_owned(), holder: holder(&mut file) });
                }
                // Some network file systems know no locks: work goes on without.
                Err(TryLockError::Error(e)) if e.kind() == std::io::ErrorKind::Unsupported => {}
                Err(TryLockError::Error(e)) => return Err(Error::io(path)(e)),
            }
            let me = json!({"process": std::process::id(), "machine": machine(), "since_unix_secs": now()});
            let written = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| writeln!(file, "{me}"));
            if let Err(e) = written {
                let _ = std::fs::remove_file(path);
                return Err(Error::io(path)(e));
            }
            return Ok(Self { path: path.to_owned(), _file: file });
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Removed while held: who opened it meanwhile sees that it is no longer at its path, and opens anew.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Whether an open file is still the one at a path.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(open), Ok(there)) = (file.metadata(), std::fs::metadata(path)) else { return false };
    (open.dev(), open.ino()) == (there.dev(), there.ino())
}

/// Elsewhere an open file cannot be removed.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> bool {
    true
}

/// Who holds a lock, in words.
fn holder(file: &mut File) -> String {
    let mut text = String::new();
    let said = file.read_to_string(&mut text).ok().and_then(|_| serde_json::from_str::<Value>(&text).ok());
    let number = |key: &str| said.as_ref()?.get(key)?.as_u64();
    let (Some(process), Some(since)) = (number("process"), number("since_unix_secs")) else {
        return "another run, which has just begun".into();
    };
    let machine = said.as_ref().and_then(|s| s["machine"].as_str()).unwrap_or("this machine");
    let minutes = now().saturating_sub(since) / 60;
    let age = match minutes {
        0 => "less than a minute".into(),
        1..60 => format!("{minutes} min"),
        _ => format!("{} h {} min", minutes / 60, minutes % 60),
    };
    format!("process {process} on {machine}, for {age}")
}

fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

fn machine() -> String {
    let linux = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let named = linux.or_else(|| std::env::var("HOSTNAME").ok()).or_else(|| std::env::var("COMPUTERNAME").ok());
    named.map(|n| n.trim().to_owned()).filter(|n| !n.is_empty()).unwrap_or_else(|| "this machine".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_told_who_the_first_is_and_a_freed_lock_is_there_for_the_next() {
        let folder = tempfile::tempdir().expect("made");
        let path = folder.path().join("lock");
        let first = Lock::take(&path, folder.path()).expect("free");
        let told = Lock::take(&path, folder.path()).expect_err("held").to_string();
        println!("{told}");
        assert!(told.contains(&format!("process {}", std::process::id())) && told.contains("less than a minute"));
        drop(first);
        assert!(!path.exists());
        drop(Lock::take(&path, folder.path()).expect("free again"));
        // What a killed run left behind is no lock.
        std::fs::write(&path, r#"{"process": 1, "machine": "elsewhere", "since_unix_secs": 1}"#).expect("written");
        drop(Lock::take(&path, folder.path()).expect("nobody holds it"));
    }

    #[test]
    fn of_many_at_once_one_at_a_time_has_it() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let folder = tempfile::tempdir().expect("made");
        let path = folder.path().join("lock");
        let (inside, had) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|s| {
            for _ in 0..4 {
                s.spawn(|| {
                    for _ in 0..200 {
                        let Ok(lock) = Lock::take(&path, folder.path()) else { continue };
                        assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0, "two at once");
                        had.fetch_add(1, Ordering::SeqCst);
                        inside.fetch_sub(1, Ordering::SeqCst);
                        drop(lock);
                    }
                });
            }
        });
        println!("{} of 800 tries had it", had.load(Ordering::SeqCst));
        assert!(had.load(Ordering::SeqCst) > 0);
    }
}
