//! Mutations inside an npz, which its check sums would otherwise refuse.
#![allow(clippy::unwrap_used)]

use super::mutate::{Random, mutated};
use std::io::{Read, Write};

/// The archive with its arrays changed inside, and the check sums that belong to them.
pub fn repacked(packed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut from = zip::ZipArchive::new(std::io::Cursor::new(packed)).unwrap();
    let mut to = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for i in 0..from.len() {
        let mut file = from.by_index(i).unwrap();
        let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        to.start_file(file.name().unwrap().to_string(), options).unwrap();
        let mut array = Vec::new();
        file.read_to_end(&mut array).unwrap();
        // The header is what can mislead.
        let rest = array.split_off(array.len().min(128));
        to.write_all(&[mutated(&array, random), rest].concat()).unwrap();
    }
    to.finish().unwrap().into_inner()
}
