//! `generate` and `doctor` as people run them: killed for real, and with keys that must not be found anywhere.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

#[path = "../../../crates/video/tests/support/server.rs"]
mod server;

use serde_json::{Value, json};
use server::{Reply, Server};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const KEY: &str = "key-0123456789-secret";

fn animimic(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_animimic"));
    command
        .args(arguments)
        .env("FAL_KEY", KEY)
        .env_remove("ANIMIMIC_FAL_KEY")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn example(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/creature").join(name).display().to_string()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn assert_no_key(folder: &Path, out: &Output) {
    assert!(!text(&out.stdout).contains(KEY) && !text(&out.stderr).contains(KEY));
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let bytes = std::fs::read(entry.path()).unwrap();
        assert!(!bytes.windows(KEY.len()).any(|w| w == KEY.as_bytes()), "a key is in {}", entry.path().display());
    }
}

#[test]
fn a_killed_run_leaves_its_job_and_the_next_one_fetches_the_video_without_a_second_order() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("motion.mp4");
    let ready = Arc::new(AtomicBool::new(false));
    let (done, film) = (Arc::clone(&ready), std::fs::read(example("creature.mp4")).unwrap());
    let server = Server::start(move |request, own| match request.path.as_str() {
        "/film.mp4" => Reply::new(200, film.clone()),
        "/r" => Reply::json(&json!({"video": {"url": format!("{own}/film.mp4")}})),
        "/s" if done.load(Ordering::SeqCst) => Reply::json(&json!({"status": "COMPLETED"})),
        "/s" => Reply::json(&json!({"status": "IN_QUEUE", "queue_position": 4})),
        _ => Reply::json(
            &json!({"request_id": "j", "status_url": format!("{own}/s"), "response_url": format!("{own}/r")}),
        ),
    });
    let (model, file) = (example("creature.glb"), out.display().to_string());
    let words = ["generate", &model, "--prompt", "it dances", "--provider", "fal", "-o", &file, "--size", "320x240"];
    let words = [&words[..], &["--url", &server.url, "--json", "-q"]].concat();
    let mut child = animimic(&words).spawn().unwrap();
    let job = folder.path().join("motion.mp4.job.json");
    let start = std::time::Instant::now();
    while server.count("GET", "/s") == 0 {
        assert!(start.elapsed().as_secs() < 120, "the job was never asked after");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(job.exists(), "remembered before it was asked after");
    child.kill().unwrap();
    assert_no_key(folder.path(), &child.wait_with_output().unwrap());
    assert!(!out.exists());
    ready.store(true, Ordering::SeqCst);
    let second = animimic(&words).output().unwrap();
    assert!(second.status.success(), "{}", text(&second.stderr));
    let said: Value = serde_json::from_slice(&second.stdout).unwrap();
    println!("{said:#}");
    assert_eq!((server.count("POST", "/"), &said["resumed"], &said["job"]), (1, &json!(true), &json!("j")));
    assert_eq!(std::fs::read(&out).unwrap(), std::fs::read(example("creature.mp4")).unwrap());
    assert_no_key(folder.path(), &second);
    // The still's camera is there for `animate`.
    assert!(
        Path::new(said["camera"].as_str().unwrap()).exists() && Path::new(said["still"].as_str().unwrap()).exists()
    );
    let dry = animimic(&[&words[..], &["--dry-run"]].concat()).output().unwrap();
    assert!(dry.status.success() && text(&dry.stdout).contains("Key ***"), "{}", text(&dry.stdout));
    assert_eq!(server.count("POST", "/"), 1);
    assert_no_key(folder.path(), &dry);
}

#[cfg(unix)]
#[test]
fn a_program_of_ones_own_makes_a_video_of_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("motion.mp4").display().to_string();
    let (model, film) = (example("creature.glb"), example("creature.mp4"));
    let words = ["generate", &model, "--prompt", "it dances", "--provider", "command", "-o", &out, "--size", "320x240"];
    let run = animimic(&[&words[..], &["-q", "--", "cp", &film, "{out}"]].concat()).output().unwrap();
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert_eq!(std::fs::read(&out).unwrap(), std::fs::read(&film).unwrap());
    let bad = animimic(&["generate", &model, "--prompt", "x", "--provider", "dream", "-o", &out]).output().unwrap();
    println!("{}", text(&bad.stderr));
    assert!(bad.status.code() == Some(1) && text(&bad.stderr).contains("replicate"));
    assert_eq!(
        animimic(&["generate", "--prompt", "x", "--provider", "fal", "-o", &out]).output().unwrap().status.code(),
        Some(2)
    );
}

#[test]
fn the_doctor_tells_what_there_is_and_names_keys_without_showing_them() {
    let out = animimic(&["doctor", "--json"]).output().unwrap();
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let rows: Value = serde_json::from_slice(&out.stdout).unwrap();
    let found = |what: &str| rows.as_array().unwrap().iter().find(|r| r["what"] == what).unwrap()["found"].to_string();
    for what in ["processors", "threads", "memory", "temporary folder", "videos read", "videos written", "ffmpeg"] {
        println!("{what}: {}", found(what));
    }
    assert!(found("provider fal").contains("FAL_KEY") && !text(&out.stdout).contains(KEY));
    let table = animimic(&["doctor"]).env("PATH", "").env("TMPDIR", "/nowhere").output().unwrap();
    println!("{}", text(&table.stdout));
    assert_eq!(table.status.code(), Some(0));
    assert!(text(&table.stdout).contains("install ffmpeg") && text(&table.stdout).contains("set TMPDIR"));
}
