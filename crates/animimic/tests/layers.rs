//! The house's one-way stairs: math, scene, {render, rig, sim, video}, fit, animimic, apps.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

/// Crate folder, and the project's crates that it may import.
const LAYERS: &[(&str, &[&str])] = &[
    ("crates/math", &[]),
    ("crates/scene", &["math"]),
    ("crates/render", &["math", "scene"]),
    ("crates/rig", &["math", "scene"]),
    ("crates/sim", &["math", "scene"]),
    ("crates/video", &["math", "scene"]),
    ("crates/fit", &["math", "scene", "render", "rig", "sim"]),
    ("crates/animimic", &["math", "scene", "render", "rig", "sim", "video", "fit"]),
    ("apps/cli", &["animimic"]),
];

const CRATES: &[&str] = &["math", "scene", "render", "rig", "sim", "video", "fit", "animimic"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Cargo's name of one of the project's library crates.
fn package(name: &str) -> String {
    if name == "animimic" { name.into() } else { format!("animimic-{name}") }
}

fn rust_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Names of the dependencies listed in a manifest, of all kinds.
fn dependencies(manifest: &str) -> Vec<String> {
    let mut section = String::new();
    let mut out = Vec::new();
    for line in manifest.lines().map(str::trim) {
        if let Some(head) = line.strip_prefix('[') {
            section = head.trim_end_matches(']').to_owned();
            if let Some((_, name)) = section.split_once("dependencies.") {
                out.push(name.to_owned());
            }
        } else if section.ends_with("dependencies")
            && let Some(name) = line.split(['=', '.', ' ']).next().filter(|n| !n.is_empty() && !n.starts_with('#'))
        {
            out.push(name.to_owned());
        }
    }
    out
}

#[test]
fn every_crate_depends_only_on_those_below_it() {
    for (folder, allowed) in LAYERS {
        let manifest = std::fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap();
        for name in CRATES {
            let listed = dependencies(&manifest).contains(&package(name));
            assert!(!listed || allowed.contains(name), "{folder}/Cargo.toml lists {}", package(name));
        }
    }
}

#[test]
fn no_source_names_a_crate_above_or_beside_its_own() {
    for (folder, allowed) in LAYERS {
        let mut files = Vec::new();
        rust_files(&root().join(folder), &mut files);
        assert!(!files.is_empty(), "{folder} has no sources");
        for file in files {
            let text = std::fs::read_to_string(&file).unwrap();
            for name in CRATES.iter().filter(|n| !allowed.contains(n) && !folder.ends_with(*n)) {
                let import = format!("{}::", package(name).replace('-', "_"));
                // `animimic::` must not match inside `animimic_x::` or `other_animimic::`.
                let found = text.match_indices(&import).any(|(at, _)| {
                    !text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == '"' || c == '`')
                });
                assert!(!found, "{} names {import}", file.display());
            }
        }
    }
}

#[test]
fn every_crate_of_the_workspace_has_its_layer() {
    let mut folders: Vec<String> = ["crates", "apps"]
        .iter()
        .flat_map(|top| {
            std::fs::read_dir(root().join(top)).unwrap().filter_map(move |e| {
                let e = e.unwrap();
                e.path().join("Cargo.toml").exists().then(|| format!("{top}/{}", e.file_name().to_string_lossy()))
            })
        })
        .collect();
    folders.sort();
    let mut known: Vec<String> = LAYERS.iter().map(|(f, _)| (*f).to_owned()).collect();
    known.sort();
    assert_eq!(folders, known, "LAYERS above must name every crate");
}

#[test]
fn libraries_do_not_print_or_exit() {
    for (folder, _) in LAYERS.iter().filter(|(f, _)| f.starts_with("crates/")) {
        let mut files = Vec::new();
        rust_files(&root().join(folder).join("src"), &mut files);
        for file in files.into_iter().filter(|f| !f.ends_with("tests.rs") && !f.ends_with("fixtures.rs")) {
            let text = std::fs::read_to_string(&file).unwrap();
            // Tests at the foot of a file print the numbers they got.
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            for word in ["println!", "eprintln!", "process::exit", "thread::sleep"] {
                let used = code.lines().any(|l| l.contains(word) && !l.trim_start().starts_with("//"));
                assert!(!used, "{} uses {word}", file.display());
            }
        }
    }
}
