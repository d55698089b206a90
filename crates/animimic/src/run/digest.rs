//! Keys: the SHA-256 of all that a result depends on.
//!
//! Inputs count as they were read, not as files lie: a model moved to another folder is the same model, and a texture changed
//! beside it is another.

use crate::Error;
use animimic_scene::{Asset, Image, Look, Source, Video};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::path::Path;
use std::sync::OnceLock;

/// What a result depends on.
#[derive(Clone)]
pub struct Key(Sha256);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "Key({self})")
    }
}

/// The hash in hexadecimal.
impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.0.clone().finalize().iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Lets `write!` hash text as it is made.
struct Text<'a>(&'a mut Sha256);

impl std::fmt::Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.update(text.as_bytes());
        Ok(())
    }
}

impl Key {
    /// A key of this program and a purpose.
    pub fn new(purpose: &str) -> Self {
        Self(Sha256::new()).and(program()).and(purpose)
    }

    /// The key with a further dependency: all that its `Debug` shows, which for numbers is exact.
    pub fn and(mut self, value: impl std::fmt::Debug) -> Self {
        // Hashing cannot fail; the end mark keeps ("ab", "c") apart from ("a", "bc").
        let _ = write!(Text(&mut self.0), "{value:?}\0");
        self
    }

    /// The key with bytes.
    pub fn and_bytes(mut self, bytes: &[u8]) -> Self {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// The key with a model as it was read and rigged.
    pub fn and_asset(self, asset: &Asset) -> Self {
        let Asset { mesh, looks, rig, motions, source, warnings } = asset;
        let mut key = self.and(mesh).and(rig).and(motions).and(warnings);
        for look in looks {
            // Texels are hashed as bytes: there are many.
            let (mut texture, pixels) = (look.texture.clone(), look.texture.as_ref().map(|t| &t.image));
            if let Some(texture) = &mut texture {
                key = key.and_bytes(&std::mem::take(&mut texture.alpha));
                texture.image = Image::default();
            }
            key = pixels.into_iter().fold(key, Self::and_image).and(Look { texture, ..look.clone() });
        }
        match source {
            Source::Plain => key,
            Source::Gltf { json, buffers } => {
                buffers.iter().fold(key.and_bytes(json.to_string().as_bytes()), |k, b| k.and_bytes(b))
            }
        }
    }

    /// The key with a video as it was read.
    pub fn and_video(self, video: &Video) -> Self {
        let Video { fps, frames, alpha, native_size, source_frames, source_times_secs, warnings } = video;
        let key = self.and((fps, native_size, source_frames, source_times_secs, warnings));
        let key = frames.iter().fold(key, Self::and_image);
        alpha.iter().fold(key, |k, mask| k.and_bytes(&mask.coverage))
    }

    fn and_image(self, image: &Image) -> Self {
        self.and((image.width, image.height)).and_bytes(image.rgb.as_flattened())
    }

    /// The key with the bytes of a file, or of all files directly in a folder with their names.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn and_path(self, path: &Path) -> Result<Self, Error> {
        if !path.is_dir() {
            return Ok(self.and_bytes(&std::fs::read(path).map_err(Error::io(path))?));
        }
        let entries = std::fs::read_dir(path).map_err(Error::io(path))?;
        let mut files: Vec<_> = entries.flatten().map(|e| e.path()).filter(|p| p.is_file()).collect();
        files.sort();
        files.iter().try_fold(self, |key, file| key.and(file.file_name()).and_path(file))
    }
}

/// Version and build of the program: two builds of one version share no results.
fn program() -> &'static str {
    static PROGRAM: OnceLock<String> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let mut build = Sha256::new();
        // Where the program cannot be read, its version alone must do.
        let _ = std::env::current_exe().and_then(File::open).and_then(|mut f| std::io::copy(&mut f, &mut build));
        format!("animimic {} {:x}", env!("CARGO_PKG_VERSION"), build.finalize())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_dependency_changes_the_key_and_where_one_ends_does_too() {
        let base = || Key::new("a");
        let folder = tempfile::tempdir().expect("made");
        let file = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
        file("a", "1");
        let one = base().and_path(folder.path()).expect("read");
        file("a", "2");
        let two = base().and_path(folder.path()).expect("read");
        std::fs::rename(folder.path().join("a"), folder.path().join("b")).expect("renamed");
        let three = base().and_path(folder.path()).expect("read");
        let (video, other) = (Video::default(), Video { fps: 0.1 + 0.2, ..Video::default() });
        let mut asset = Asset::default();
        let empty = base().and_asset(&asset);
        asset.warnings.push("mended".into());
        let keys = [
            base(),
            Key::new("b"),
            base().and(0.3),
            base().and(0.1 + 0.2),
            base().and("ab").and("c"),
            base().and("a").and("bc"),
            base().and_video(&video),
            base().and_video(&other),
            empty,
            base().and_asset(&asset),
            one,
            two,
            three,
        ];
        let words: std::collections::BTreeSet<String> = keys.iter().map(Key::to_string).collect();
        assert_eq!(words.len(), keys.len());
        assert!(words.iter().all(|w| w.len() == 64));
        assert_eq!(base().and(0.3).to_string(), base().and(0.3).to_string());
    }
}
