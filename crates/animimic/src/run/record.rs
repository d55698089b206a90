//! What a stage found, as a file: a NumPy archive of its key, a JSON part and arrays, exact to the last bit.

use super::Key;
use crate::Error;
use animimic_scene::io::npz::{self, Archive, Array, Values};
use serde_json::Value;
use std::path::Path;

/// Something that can be kept.
pub trait Kept: Sized {
    /// All of it.
    fn to_record(&self) -> Record;
    /// The same again; `None` where the record is of something else.
    fn from_record(record: Record) -> Option<Self>;
}

/// What is kept: words and few numbers as JSON, many numbers as arrays.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Words and few numbers, finite ones only.
    pub json: Value,
    /// Arrays by name.
    pub arrays: Vec<(String, Array)>,
}

impl Record {
    /// Adds an array.
    pub fn with(mut self, name: &str, shape: &[usize], values: Values) -> Self {
        self.arrays.push((name.into(), Array { shape: shape.to_vec(), values }));
        self
    }

    /// Adds an array of doubles.
    pub fn with_f64(self, name: &str, shape: &[usize], values: Vec<f64>) -> Self {
        self.with(name, shape, Values::F64(values))
    }

    /// The array of that name.
    pub fn get(&self, name: &str) -> Option<&Array> {
        self.arrays.iter().find(|a| a.0 == name).map(|a| &a.1)
    }

    /// The doubles of that name.
    pub fn f64s(&self, name: &str) -> Option<Vec<f64>> {
        match &self.get(name)?.values {
            Values::F64(v) => Some(v.clone()),
            _ => None,
        }
    }

    /// Writes the record with its key.
    ///
    /// # Errors
    /// The disk.
    pub fn write(self, path: &Path, key: &Key) -> Result<(), Error> {
        let bytes = |v: Vec<u8>| Array { shape: vec![v.len()], values: Values::U8(v) };
        let mut arrays = vec![
            ("key".to_owned(), bytes(key.to_string().into_bytes())),
            ("json".to_owned(), bytes(self.json.to_string().into_bytes())),
        ];
        arrays.extend(self.arrays);
        Ok(npz::write(path, &Archive { arrays })?)
    }

    /// Reads the record with that key; `None` where there is none.
    pub fn read(path: &Path, key: &Key) -> Option<Self> {
        Self::read_if(path, |own| own == key.to_string())
    }

    /// Reads the record, whatever its key; `None` where there is none.
    pub fn read_any(path: &Path) -> Option<Self> {
        Self::read_if(path, |_| true)
    }

    fn read_if(path: &Path, wanted: impl Fn(&str) -> bool) -> Option<Self> {
        let mut archive = npz::read(path).ok()?;
        let text = |name: &str| String::from_utf8(archive.get(name)?.to_u8()?).ok();
        if !wanted(&text("key")?) {
            return None;
        }
        let json = serde_json::from_str(&text("json")?).ok()?;
        archive.arrays.retain(|a| a.0 != "key" && a.0 != "json");
        Some(Self { json, arrays: archive.arrays })
    }
}
