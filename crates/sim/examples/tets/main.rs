//! Cages for every model of a folder, against pytetwild.
//!
//! `cargo run --release -p animimic-sim --example tets -- DIR [docs/benchmarks.md RIVAL.jsonl]`, DIR with folders of models. One JSON line a
//! model. With the path of `docs/benchmarks.md` and what `tetwild.py` beside this file prints for the same folder, the table there is
//! written anew.

mod models;

use animimic_sim::tet::{DEFAULT_TETS, Quality, cage, quality};
use models::{cpu_s, models};
use serde_json::{Value, json};
use std::path::Path;

const MARKS: [&str; 2] = ["<!-- tets: generated -->", "<!-- /tets -->"];

fn measure(path: &Path) -> Result<Value, Box<dyn std::error::Error>> {
    let mesh = animimic_scene::io::read(path)?.mesh;
    let start = cpu_s();
    let made = cage(&mesh, DEFAULT_TETS)?;
    let seconds = cpu_s() - start;
    let Quality { dihedral_deg, radius_ratio, inverted, euler, components } = quality(&made.mesh);
    let rounded = |x: f64| (x * 1e3).round() / 1e3;
    Ok(json!({
        "triangles": mesh.triangles.len(), "cpu_s": (seconds * 1e2).round() / 1e2, "tets": made.mesh.tets.len(),
        "worst": rounded(radius_ratio[0]), "mean": rounded(radius_ratio[1]), "dihedral_deg": rounded(dihedral_deg[0]),
        "inverted": inverted, "euler": euler, "components": components,
    }))
}

/// Lines of the table: ours, and the rival's where it was run.
fn table(ours: &[(String, Value)], rival: &[Value]) -> String {
    let mut out = format!(
        "{}\nCPU seconds, all threads together; {DEFAULT_TETS} tets asked for, pytetwild with its own default settings. Quality: 3 × inscribed over \
         circumscribed radius, 1 for the regular tet, worst and mean.\n\n\
         | model | triangles | CPU s | tets | worst / mean | parts | pytetwild: CPU s | tets | worst / mean |\n|---|---|---|---|---|---|---|---|---|\n",
        MARKS[0]
    );
    for (name, v) in ours {
        let Some(other) = rival.iter().find(|r| r["model"] == name.as_str()) else { continue };
        let theirs = match other["failed"].as_str() {
            Some(why) => format!("{why} | – | –"),
            None => format!("{} | {} | {} / {}", other["cpu_s"], other["tets"], other["worst"], other["mean"]),
        };
        let name = name.trim_start_matches("static/").trim_start_matches("real/").replace("/objs/mesh.obj", "");
        out += &format!(
            "| {name} | {} | {} | {} | {} / {} | {} | {theirs} |\n",
            v["triangles"], v["cpu_s"], v["tets"], v["worst"], v["mean"], v["components"]
        );
    }
    out + MARKS[1]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let Some(folder) = arguments.get(1) else {
        eprintln!("usage: tets DIR (with models) [docs/benchmarks.md RIVAL.jsonl]");
        std::process::exit(2);
    };
    let mut paths = Vec::new();
    models(Path::new(folder), &mut paths);
    let mut ours = Vec::new();
    for path in paths {
        let name = path.strip_prefix(folder).unwrap_or(&path).display().to_string();
        match measure(&path) {
            Ok(mut v) => {
                v["model"] = name.as_str().into();
                println!("{v}");
                ours.push((name, v));
            }
            Err(e) => println!("{}", json!({"model": name, "error": e.to_string()})),
        }
    }
    if let [_, _, page, rival] = &arguments[..] {
        let lines = std::fs::read_to_string(rival)?;
        let rival: Vec<Value> = lines.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
        let text = std::fs::read_to_string(page)?;
        let (Some(a), Some(b)) = (text.find(MARKS[0]), text.find(MARKS[1])) else {
            return Err(format!("{page} has no place for the table: {} … {}", MARKS[0], MARKS[1]).into());
        };
        std::fs::write(page, format!("{}{}{}", &text[..a], table(&ours, &rival), &text[b + MARKS[1].len()..]))?;
    }
    Ok(())
}
