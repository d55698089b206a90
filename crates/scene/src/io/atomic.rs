//! Files appear whole or not at all: written beside, synced, renamed.

use super::SceneError;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a file through `write` so that no reader, crash or full disk ever sees a part of it.
///
/// # Errors
/// [`SceneError::Io`] where the system refuses; the unfinished neighbour is removed and an older file at `path` stays as it was.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), SceneError> {
    let path = path.as_ref();
    let beside = beside(path);
    let written = fill(&beside, write).and_then(|()| fs::rename(&beside, path));
    settle(path);
    written.map_err(|e| {
        // The neighbour may not exist; the first error is the one that matters.
        let _ = fs::remove_file(&beside);
        SceneError::io(path, "write it", e)
    })
}

/// Makes the new name outlive a power failure, where folders can be synced.
fn settle(path: &Path) {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Not every system can, and the file is whole in any case.
    let _ = File::open(folder).and_then(|f| f.sync_all());
}

/// Removes what killed processes left of unfinished files in a folder: those whose process is gone, as far as the system tells,
/// or of any process in a folder that is `ours` alone.
pub fn sweep(folder: &Path, ours: bool) {
    for path in fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()) {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let process = name.strip_prefix('.').and_then(|n| n.strip_suffix(".part")).and_then(|n| n.rsplit('.').next());
        let Some(process) = process.and_then(|p| p.parse::<u32>().ok()) else { continue };
        let processes = Path::new("/proc/self").exists();
        if ours || (processes && !Path::new("/proc").join(process.to_string()).exists()) {
            // What cannot be removed is hidden, and does no harm.
            let _ = fs::remove_file(path);
        }
    }
}

fn beside(path: &Path) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".{name}.{}.part", std::process::id()))
}

fn fill(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    write(&mut file)?;
    file.flush()?;
    file.get_ref().sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_dead_left_is_swept_and_what_the_living_write_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let living = beside(&folder.path().join("a.bin"));
        let dead = folder.path().join(".a.bin.4294967295.part");
        let other = folder.path().join(".hidden.part");
        [&living, &dead, &other].iter().for_each(|p| fs::write(p, b"half").unwrap());
        sweep(folder.path(), false);
        assert!(living.exists() && other.exists());
        assert_eq!(dead.exists(), !Path::new("/proc/self").exists());
        sweep(folder.path(), true);
        assert!(!living.exists() && !dead.exists() && other.exists());
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_part() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"new and longer")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
