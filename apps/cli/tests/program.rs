//! The program as people run it: exit codes, one-sentence errors, JSON, equal bytes.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn animimic(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_animimic")).args(arguments).output().unwrap()
}

fn example(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/creature").join(name).display().to_string()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Fails with exit code 1 and one sentence on standard error that contains `words`; nothing on standard output.
fn fails_with(arguments: &[&str], words: &str) {
    let start = std::time::Instant::now();
    let out = animimic(arguments);
    let error = text(&out.stderr);
    println!("{:.2} s: {error}", start.elapsed().as_secs_f64());
    assert_eq!(out.status.code(), Some(1), "{arguments:?}: {error}");
    assert!(error.starts_with("animimic: ") && error.trim_end().lines().count() == 1, "{error}");
    assert!(error.contains(words), "{error}");
    assert!(out.stdout.is_empty());
}

#[test]
fn wrong_usage_ends_with_2_and_help_with_0() {
    assert_eq!(animimic(&["animate"]).status.code(), Some(2));
    assert_eq!(animimic(&["dance"]).status.code(), Some(2));
    assert_eq!(animimic(&["list", "clouds"]).status.code(), Some(2));
    let help = animimic(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    for command in ["animate", "fit", "cues", "evaluate", "render", "still", "example", "list"] {
        assert!(text(&help.stdout).contains(command), "{command}");
    }
}

#[test]
fn lists_print_json_for_machines() {
    for kind in ["formats", "metrics", "cameras", "cues", "presets", "riggers", "models", "physics", "providers"] {
        let out = animimic(&["list", kind, "--json"]);
        let rows: Value = serde_json::from_slice(&out.stdout).unwrap();
        let least = if kind == "presets" { 2 } else { 3 };
        assert!(rows.as_array().unwrap().len() >= least, "{kind}");
    }
}

#[test]
fn bad_inputs_are_told_in_one_sentence_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let out = path("out");
    let (model, video, camera) = (example("creature.glb"), example("creature.mp4"), example("camera.json"));
    std::fs::write(path("empty.mp4"), b"").unwrap();
    std::fs::write(path("page.mp4"), b"<!doctype html><html>not here</html>").unwrap();
    std::fs::write(path("cut.mp4"), &std::fs::read(&video).unwrap()[..9000]).unwrap();
    std::fs::write(path("cut.glb"), &std::fs::read(&model).unwrap()[..9000]).unwrap();
    std::fs::write(path("lfs.glb"), b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n").unwrap();
    std::fs::write(path("half.json"), b"{\"width\": 512").unwrap();
    std::fs::create_dir(path("one")).unwrap();
    std::fs::copy(example_frame(&folder.path().join("frame.png")), folder.path().join("one/0.png")).unwrap();
    let run =
        |m: &str, v: &str, c: &str, words: &str| fails_with(&["animate", m, v, "--camera", c, "-o", &out, "-q"], words);
    run(&path("no.glb"), &video, &camera, "no.glb");
    run(&path("cut.glb"), &video, &camera, "cut.glb");
    run(&path("lfs.glb"), &video, &camera, "LFS");
    run(&model, &path("no.mp4"), &camera, "no.mp4");
    run(&model, &path("empty.mp4"), &camera, "empty");
    run(&model, &path("page.mp4"), &camera, "page.mp4");
    run(&model, &path("cut.mp4"), &camera, "cut.mp4");
    run(&model, &path("one"), &camera, "frame");
    run(&model, &video, &path("half.json"), "half.json");
    run(&model, &video, "preset:nowhere", "puppeteer:front");
    fails_with(&["evaluate", &model, &video, "--camera", &camera, "-q"], "no animation");
    fails_with(&["render", &model, "-o", &path("x.bmp")], ".gif or .png");
    assert!(!Path::new(&out).exists());
}

/// Draws one frame of the example.
fn example_frame(to: &Path) -> PathBuf {
    let out = animimic(&[
        "render",
        &example("creature.glb"),
        "-o",
        &to.display().to_string(),
        "--views",
        "input",
        "--height",
        "128",
        "-q",
    ]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    to.to_owned()
}

#[test]
fn the_shipped_example_is_what_the_program_makes_today() {
    let folder = tempfile::tempdir().unwrap();
    let out = animimic(&["example", "-o", &folder.path().display().to_string(), "-q", "--json"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let shipped = |name: &str| std::fs::read(example(name)).unwrap();
    let made = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let mut total = 0;
    for name in ["creature.glb", "creature.mp4", "camera.json"] {
        total += shipped(name).len();
        assert_eq!(
            shipped(name),
            made(name),
            "{name} differs: make it again with `animimic example -o examples/creature`"
        );
    }
    println!("{total} bytes");
    assert!(total < 2_000_000);
}

/// A short run of the whole way; files with their bytes, reports without timings.
fn results(folder: &Path, threads: &str) -> Vec<(String, Vec<u8>)> {
    let out = folder.join(threads).display().to_string();
    let run = animimic(&[
        "animate",
        &example("creature.glb"),
        &example("creature.mp4"),
        "--camera",
        &example("camera.json"),
        "-o",
        &out,
        "--frames",
        "0..4",
        "--height",
        "160",
        "--threads",
        threads,
        "--json",
        "-q",
    ]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(report["clips"][0]["frames"], 4);
    let mut files: Vec<_> =
        std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_file()).collect();
    files.sort();
    files
        .iter()
        .filter(|p| p.extension().unwrap() != "html")
        .map(|p| {
            let mut bytes = std::fs::read(p).unwrap();
            if p.ends_with("report.json") {
                let mut json: Value = serde_json::from_slice(&bytes).unwrap();
                json["timings"] = Value::Null;
                bytes = json.to_string().into_bytes();
            }
            (p.file_name().unwrap().to_string_lossy().into_owned(), bytes)
        })
        .collect()
}

/// A short run of `fit`; its report without timings, and the file's bytes.
fn fitted(out: &Path, preset: &str, height: &str) -> (Value, Vec<u8>) {
    let (model, video, camera, out) =
        (example("creature.glb"), example("creature.mp4"), example("camera.json"), out.display().to_string());
    let mut arguments = vec!["fit", &model, &video, "--camera", &camera, "-o", &out, "--frames", "0..4"];
    arguments.extend(["--height", height, "--preset", preset, "--json", "-q"]);
    let run = animimic(&arguments);
    assert!(run.status.success(), "{}", text(&run.stderr));
    (serde_json::from_slice(&run.stdout).unwrap(), std::fs::read(&out).unwrap())
}

#[test]
fn fit_writes_the_same_clip_as_animate_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let (report, glb) = fitted(&folder.path().join("clip.glb"), "default", "160");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let whole = results(folder.path(), "2");
    let animated = &whole.iter().find(|f| f.0 == "animated.glb").unwrap().1;
    assert!(glb == *animated, "{} and {} bytes", glb.len(), animated.len());
    let timings = report["timings"].as_object().unwrap();
    for part in ["motion: tracking", "motion: refinement", "motion: polish"] {
        assert!(timings.contains_key(part), "{part} is not in {timings:?}");
    }
    let stages: Vec<&str> =
        report["clips"][0]["losses"].as_array().unwrap().iter().map(|c| c["stage"].as_str().unwrap()).collect();
    for term in ["polish: rgb", "polish: mask", "polish: contour", "polish: smoothness"] {
        assert!(stages.contains(&term), "{term} is not in {stages:?}");
    }
    fails_with(
        &["fit", &example("creature.glb"), &example("creature.mp4"), "-o", &folder.path().display().to_string(), "-q"],
        "ends in .glb",
    );
}

#[test]
fn the_reference_preset_runs_and_is_another_motion() {
    let folder = tempfile::tempdir().unwrap();
    let (report, glb) = fitted(&folder.path().join("reference.glb"), "reference", "96");
    assert_eq!(report["options"]["preset"], "reference");
    let losses = report["clips"][0]["losses"][0]["values"].as_array().unwrap();
    println!("loss {} to {}", losses[0], losses[199]);
    assert_eq!(losses.len(), 200);
    assert!(losses[199].as_f64() < losses[0].as_f64());
    assert!(glb != fitted(&folder.path().join("default.glb"), "default", "96").1);
    assert_eq!(animimic(&["fit", "a", "b", "-o", "c.glb", "--preset", "fastest"]).status.code(), Some(2));
}

#[test]
fn one_thread_and_two_give_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (results(folder.path(), "1"), results(folder.path(), "2"));
    let names: Vec<&str> = one.iter().map(|f| f.0.as_str()).collect();
    assert_eq!(
        names,
        ["animated.glb", "camera.json", "contact_sheet.png", "report.json", "residuals.mp4", "soft.glb", "views.mp4"]
    );
    for (a, b) in one.iter().zip(&two) {
        println!("{} {} bytes", a.0, a.1.len());
        assert!(a == b, "{} differs", a.0);
    }
}

#[test]
fn a_result_measured_against_the_examples_truth_is_better_than_the_still_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    assert!(animimic(&["example", "-o", &path("example"), "--truth", "-q"]).status.success());
    let run = animimic(&[
        "animate",
        &example("creature.glb"),
        &example("creature.mp4"),
        "--camera",
        &example("camera.json"),
        "-o",
        &path("out"),
        "--height",
        "256",
        "-q",
    ]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let measured =
        animimic(&["evaluate", &path("out/animated.glb"), "--truth", &path("example/truth"), "--json", "-q"]);
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    let json: Value = serde_json::from_slice(&measured.stdout).unwrap();
    println!("{json:#}");
    let number = |key: &str| json[key].as_f64().unwrap();
    assert!(number("vertex_rms_pct") < 0.5 * number("static_rms_pct"));
    assert!(number("mpjpe_pct") < 3.0 && number("iou_main") > 0.9);
    assert!(number("rest_fidelity") < 1e-5);
}

#[test]
fn a_still_carries_its_camera_inside_and_beside_and_shows_the_model_whole() {
    let folder = tempfile::tempdir().unwrap();
    let still = folder.path().join("first.png").display().to_string();
    let out = animimic(&["still", &example("creature.glb"), "-o", &still, "--size", "320x240", "--json"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let said: Value = serde_json::from_slice(&out.stdout).unwrap();
    println!("{said:#}");
    assert!(said["surface_seen"].as_f64().unwrap() > 0.3);
    assert!(said["advice"].as_array().unwrap().iter().any(|l| l.as_str().unwrap().contains("static camera")));
    // The camera beside it and the camera inside it draw the same picture again, over the same background.
    let beside = said["camera"].as_str().unwrap();
    let again = |name: &str, camera: &str| {
        let file = folder.path().join(name).display().to_string();
        let colour: String =
            said["background_rgb"].as_array().unwrap().iter().map(|c| format!("{:02x}", c.as_u64().unwrap())).collect();
        // No size is asked for: the camera has one.
        let model = example("creature.glb");
        let drawn = animimic(&["still", &model, "-o", &file, "--camera", camera, "--background", &colour]);
        assert!(drawn.status.success(), "{}", text(&drawn.stderr));
        std::fs::read(file).unwrap()
    };
    let first = std::fs::read(&still).unwrap();
    assert!(again("beside.png", beside) == first && again("inside.png", &still) == first);
    let looked = |name: &str, camera: &str| {
        let file = folder.path().join(name).display().to_string();
        let arguments = ["--views", "input", "--height", "120", "-q", "--camera", camera];
        let out = animimic(&[&["render", &example("creature.glb"), "-o", &file][..], &arguments].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        std::fs::read(file).unwrap()
    };
    assert!(looked("look_beside.png", beside) == looked("look_inside.png", &still));
    // A picture from elsewhere has none.
    let frame = folder.path().join("frame.png");
    example_frame(&frame);
    let (model, video) = (example("creature.glb"), example("creature.mp4"));
    fails_with(
        &[
            "animate",
            &model,
            &video,
            "--camera",
            &frame.display().to_string(),
            "-o",
            &folder.path().join("o").display().to_string(),
            "-q",
        ],
        "no camera inside",
    );
    fails_with(&["still", &model, "-o", "first.jpg"], ".png");
}
