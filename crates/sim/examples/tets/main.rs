//! Cages for every model of a folder, against pytetwild.
//!
//! `cargo run --release -p animimic-sim --example tets -- DIR [docs/benchmarks.md RIVAL.jsonl]`, DIR with folders of models. One JSON line a
//! model, and one with the slowest; fails where that takes longer than [`LIMIT_S`]. With the path of `docs/benchmarks.md` and what `tetwild.py` beside this file prints for the same folder, the table there is
//! written anew.

mod models;

use animimic_sim::tet::{DEFAULT_TETS, Quality, cage, quality};
use models::models;
use serde_json::{Value, json};
use std::path::Path;

/// No model takes longer than this [CPU s, all threads together].
const LIMIT_S: f64 = 5.0;
const MARKS: [&str; 2] = ["<!-- tets: generated -->", "<!-- /tets -->"];

/// CPU time of the process [s].
fn cpu_s() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}

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
    let seconds = |v: &Value| v["cpu_s"].as_f64().unwrap_or(f64::INFINITY);
    let slowest = ours.iter().max_by(|a, b| seconds(&a.1).total_cmp(&seconds(&b.1)));
    if let Some((name, v)) = slowest {
        println!("{}", json!({"slowest": name, "cpu_s": v["cpu_s"], "limit_s": LIMIT_S}));
        if seconds(v) > LIMIT_S {
            return Err(format!("{name} takes {} s, more than {LIMIT_S}", v["cpu_s"]).into());
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
