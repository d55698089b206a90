//! Lists of jobs as people run them: failures, kills, shards, a configuration file, and an engine that spreads them.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

mod runner;

use runner::{animate, animimic, assert_same, done, example, results, text};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const NAMES: [&str; 3] = ["short", "small", "twice"];

/// A list of three small jobs, beside links to the example; the last has two videos.
fn list(folder: &Path) -> PathBuf {
    for name in ["creature.glb", "creature.mp4", "camera.json"] {
        std::fs::copy(example(name), folder.join(name)).unwrap();
    }
    let path = folder.join("jobs.toml");
    let text = r#"
        [defaults]
        model = "creature.glb"
        videos = ["creature.mp4"]
        camera = "camera.json"
        height = 96
        frames = "0..4"
        stage = "pose"

        [[job]]
        name = "short"
        frames = "0..3"

        [[job]]
        name = "small"
        height = 64
        clip = ["dance"]

        [[job]]
        name = "twice"
        frames = "0..3"
        videos = ["creature.mp4", "creature.mp4"]
        clip = ["one", "two"]
    "#;
    std::fs::write(&path, text).unwrap();
    path
}

fn batch(list: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = animimic(&["batch", "-q", "--json"]);
    command.arg(list).arg("-o").arg(out).args(more);
    command
}

fn states(out: &std::process::Output) -> Vec<(String, String)> {
    let json: Value = serde_json::from_slice(&out.stdout).unwrap();
    let word = |row: &Value, key: &str| row[key].as_str().unwrap().to_owned();
    json["jobs"].as_array().unwrap().iter().map(|r| (word(r, "name"), word(r, "state"))).collect()
}

fn all(state: &str) -> Vec<(String, String)> {
    NAMES.iter().map(|n| ((*n).to_owned(), state.to_owned())).collect()
}

fn assert_same_jobs(out: &Path, expected: &Path, when: &str) {
    for name in NAMES {
        assert_same(&results(&out.join(name)), &results(&expected.join(name)), &format!("{when} ({name})"));
    }
}

#[test]
fn jobs_are_done_once_one_or_two_at_a_time_and_each_as_animate_does_it() {
    let folder = tempfile::tempdir().unwrap();
    let list = list(folder.path());
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    let first = done(&mut batch(&list, &one, &[]));
    assert_eq!(states(&first), all("done"));
    assert_eq!(states(&done(&mut batch(&list, &one, &[]))), all("kept"));
    assert_eq!(states(&done(&mut batch(&list, &two, &["--jobs", "2"]))), all("done"));
    assert_same_jobs(&two, &one, "two at a time");
    let alone = folder.path().join("alone");
    let mut command =
        animimic(&["animate", "--frames", "0..4", "--height", "64", "--clip", "dance", "--stage", "pose", "-q", "-o"]);
    command.arg(&alone).arg("--camera").arg(example("camera.json"));
    done(command.arg(example("creature.glb")).arg(example("creature.mp4")));
    assert_same(&results(&alone), &results(&one.join("small")), "alone");
    let summary: Value = serde_json::from_slice(&std::fs::read(one.join("summary.json")).unwrap()).unwrap();
    println!("{summary:#}");
    assert_eq!(summary["jobs"][2]["clips"].as_array().unwrap().len(), 2, "one GLB, two clips");
}

#[cfg(unix)]
#[test]
fn a_batch_killed_in_the_middle_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let list = list(folder.path());
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    let begin = Instant::now();
    done(&mut batch(&list, &whole, &[]));
    let secs = begin.elapsed().as_secs_f64();
    for share in [0.45, 0.4] {
        let mut child = batch(&list, &out, &[]).stdout(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(share * secs));
        assert!(child.try_wait().unwrap().is_none(), "it was to be killed in the middle");
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let last = done(&mut batch(&list, &out, &[]));
    println!("after two kills: {:?}", states(&last));
    assert_eq!(states(&last)[0].1, "kept");
    assert_same_jobs(&out, &whole, "after two kills");
}

#[test]
fn a_failed_job_stops_no_other_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let list = list(folder.path());
    let text_of = std::fs::read_to_string(&list).unwrap().replacen("height = 64", "model = \"lost.glb\"", 1);
    std::fs::write(&list, text_of).unwrap();
    let out = folder.path().join("out");
    let ended = batch(&list, &out, &[]).output().unwrap();
    let said = text(&ended.stderr);
    println!("{said}");
    assert_eq!(ended.status.code(), Some(1));
    assert!(said.contains("1 of 3 jobs failed: small"));
    let words: Vec<String> = states(&ended).into_iter().map(|s| s.1).collect();
    assert_eq!(words, ["done", "failed", "done"]);
    let json: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert!(json["jobs"][1]["error"].as_str().unwrap().contains("lost.glb"));
    assert!(!out.join("small").exists());
}

#[test]
fn what_is_wrong_in_a_list_is_told_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jobs.toml");
    let job = "[[job]]\nname = \"a\"\nmodel = \"a.glb\"\nvideos = [\"a.mp4\"]\n";
    for (text_of, told) in [
        (String::new(), "no job in it"),
        ("[[job]\n".into(), "line 1"),
        (format!("{job}hight = 3\n"), "hight is no option"),
        (format!("{job}height = \"tall\"\n"), "invalid value 'tall'"),
        (format!("{job}{job}"), "two jobs are called a"),
        (job.replace("name = \"a\"", "name = \"../a\""), "no name of a folder"),
        (job.replace("name = \"a\"\n", ""), "it has no name"),
        (job.replace("videos = [\"a.mp4\"]\n", ""), "required"),
        (format!("speed = 3\n{job}"), "speed is neither"),
        (format!("{job}threads = 3\n"), "of the whole batch"),
    ] {
        std::fs::write(&path, &text_of).unwrap();
        let ended = batch(&path, &folder.path().join("out"), &[]).output().unwrap();
        let said = text(&ended.stderr);
        println!("{said}");
        assert_eq!(ended.status.code(), Some(1), "{text_of}");
        assert!(said.contains(told) && said.trim_end().lines().count() == 1, "{said}");
        assert!(said.contains("jobs.toml") || told.contains("two jobs"), "{said}");
    }
    assert!(!folder.path().join("out").exists());
}

#[test]
fn shards_and_names_pick_jobs_and_together_they_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let list = list(folder.path());
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    done(&mut batch(&list, &whole, &[]));
    let names = |more: &[&str]| -> Vec<String> {
        states(&done(&mut batch(&list, &out, more))).into_iter().map(|s| s.0).collect()
    };
    assert_eq!(names(&["--shard", "1/2"]), ["short", "twice"]);
    assert!(!out.join("summary.json").exists(), "a shard has no summary of the whole");
    assert_eq!(names(&["--only", "small"]), ["small"]);
    assert_eq!(states(&done(&mut batch(&list, &out, &[]))), all("kept"));
    assert_same_jobs(&out, &whole, "in shards");
    assert_eq!(batch(&list, &out, &["--shard", "3/2"]).output().unwrap().status.code(), Some(2));
    assert!(text(&batch(&list, &out, &["--only", "tall"]).output().unwrap().stderr).contains("there are short"));
}

#[test]
fn a_file_of_options_is_the_same_as_the_options_and_the_command_line_counts_before_it() {
    let folder = tempfile::tempdir().unwrap();
    list(folder.path());
    let file = folder.path().join("fox.toml");
    let options = "model = \"creature.glb\"\nvideos = [\"creature.mp4\"]\ncamera = \"camera.json\"\nout = \"from_file\"\n\
                   height = 64\nframes = \"0..4\"\nquiet = true\n";
    std::fs::write(&file, options).unwrap();
    let expected = folder.path().join("expected");
    done(&mut animate(&expected, &[]));
    let file_name = file.display().to_string();
    done(&mut animimic(&["animate", "--config", &file_name, "--height", "160"]));
    assert_same(&results(&folder.path().join("from_file")), &results(&expected), "from a file");
    let other = folder.path().join("other").display().to_string();
    let equals = format!("--config={file_name}");
    done(&mut animimic(&["animate", &equals, "-o", &other, "--height=160"]));
    assert_same(&results(Path::new(&other)), &results(&expected), "into another folder");
    std::fs::write(&file, options.replace("height", "hight")).unwrap();
    let said = text(&animimic(&["animate", "--config", &file_name]).output().unwrap().stderr);
    println!("{said}");
    assert!(said.contains("fox.toml") && said.contains("hight is no option of animate"));
}

/// The recipe of the guide: its shell lines between the fences marked with a word, with the program's path and the list's put in.
fn recipe(word: &str, list: &Path, out: &Path) -> String {
    let guide = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guide.md")).unwrap();
    let fence = format!("```{word}\n");
    let lines =
        guide.split(&fence).nth(1).unwrap_or_else(|| panic!("no {fence} in the guide")).split("```").next().unwrap();
    let program = env!("CARGO_BIN_EXE_animimic");
    lines
        .replace("animimic batch jobs.toml", &format!("{program} batch {} -o {}", list.display(), out.display()))
        .replace(
            "\"animimic\", \"batch\", \"jobs.toml\"",
            &format!("{program:?}, \"batch\", {list:?}, \"-o\", {out:?}"),
        )
}

/// Whether a program is there and answers.
fn is_here(program: &str, arguments: &[&str]) -> bool {
    let run = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    run.is_ok_and(|s| s.success())
}

/// Runs a recipe under its engine and compares with a batch of our own.
fn spread(interpreter: &str, word: &str) {
    let folder = tempfile::tempdir().unwrap();
    let list = list(folder.path());
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    let script = recipe(word, &list, &out);
    println!("{script}");
    done(&mut batch(&list, &whole, &[]));
    let home = folder.path().join("home");
    std::fs::create_dir(&home).unwrap();
    let run = Command::new(interpreter).args(["-c", &script]).current_dir(&home).env("HOME", &home).output().unwrap();
    println!("{}{}", text(&run.stdout), text(&run.stderr));
    assert!(run.status.success());
    assert_same_jobs(&out, &whole, "under the engine");
    assert_eq!(states(&done(&mut batch(&list, &out, &[]))), all("kept"));
}

#[cfg(unix)]
#[test]
fn the_guides_recipe_for_hyperqueue_in_a_shell_spreads_the_jobs() {
    if !is_here("hq", &["--version"]) {
        println!("skipped: hq is not here");
        return;
    }
    spread("sh", "sh hyperqueue");
}

/// Runs a recipe in Python where the engine's package is installed.
fn spread_from_python(package: &str) {
    let python = std::env::var("ENGINES_PYTHON").unwrap_or_else(|_| "python3".into());
    if !is_here(&python, &["-c", &format!("import {package}")]) {
        println!("skipped: {python} has no {package} (set ENGINES_PYTHON)");
        return;
    }
    spread(&python, &format!("python {package}"));
}

#[test]
fn the_guides_recipe_for_hyperqueue_in_python_spreads_the_jobs() {
    spread_from_python("hyperqueue");
}

#[test]
fn the_guides_recipe_for_ray_spreads_the_jobs() {
    spread_from_python("ray");
}
