//! Runs of the program on the example, and what they leave.
// Each test file uses a part of it.
#![allow(dead_code)]

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A file of the example.
pub fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/creature").join(name)
}

/// The program with some arguments.
pub fn animimic(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_animimic"));
    command.args(arguments);
    command
}

/// A short `animate` of the example into a folder.
pub fn animate(out: &Path, more: &[&str]) -> Command {
    let mut command = animimic(&["animate", "--frames", "0..4", "--height", "160", "-q"]);
    command.arg(example("creature.glb")).arg(example("creature.mp4")).arg("--camera").arg(example("camera.json"));
    command.arg("-o").arg(out).args(more);
    command
}

/// Runs a command that must succeed.
pub fn done(command: &mut Command) -> Output {
    let out = command.output().unwrap();
    assert!(out.status.success(), "{command:?}: {}", text(&out.stderr));
    out
}

/// Bytes as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Files of a result folder by name, with their bytes; `report.json` without its timings, `report.html` left out, for it shows them.
pub fn results(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_file()) {
        let name = entry.file_name().unwrap().to_string_lossy().into_owned();
        let mut bytes = std::fs::read(&entry).unwrap();
        if name == "report.json" {
            let mut json: Value = serde_json::from_slice(&bytes).unwrap();
            json["timings"] = Value::Null;
            bytes = json.to_string().into_bytes();
        }
        if name != "report.html" {
            files.push((name, bytes));
        }
    }
    files.sort();
    files
}

/// Fails where two result folders differ, with the name of the file.
pub fn assert_same(a: &[(String, Vec<u8>)], b: &[(String, Vec<u8>)], when: &str) {
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(a), names(b), "{when}");
    for (x, y) in a.iter().zip(b) {
        assert!(x == y, "{} differs {when}", x.0);
    }
}

/// Names of what a run has kept so far.
pub fn kept(out: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(out.join("state"));
    let mut names: Vec<String> =
        entries.into_iter().flatten().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
