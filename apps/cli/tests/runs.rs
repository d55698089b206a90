//! Runs that can be trusted: killed, stopped, crowded out and run out of room, they lose nothing and leave nothing broken.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]
#![cfg(unix)]

mod runner;

use runner::{animate, assert_same, done, kept, results, text};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// SplitMix64, in [0, 1): seeded, so that a failure can be had again.
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
}

/// How often to kill: ANIMIMIC_KILLS, or a few.
fn kills() -> usize {
    std::env::var("ANIMIMIC_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(4)
}

fn start(command: &mut Command) -> Child {
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn killed_at_random_times_and_resumed_the_results_are_those_of_an_undisturbed_run() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    let begin = Instant::now();
    done(&mut animate(&whole, &[]));
    let whole_secs = begin.elapsed().as_secs_f64();
    let expected = results(&whole);
    let (mut state, mut midway) = (7u64, 0);
    for k in 0..kills() {
        let out = folder.path().join(k.to_string());
        let after = uniform(&mut state) * whole_secs;
        let mut child = start(&mut animate(&out, &[]));
        std::thread::sleep(Duration::from_secs_f64(after));
        midway += usize::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let there = kept(&out);
        let begin = Instant::now();
        done(&mut animate(&out, &["--resume"]));
        let secs = begin.elapsed().as_secs_f64();
        println!("killed after {after:.2} s of {whole_secs:.2}, resumed in {secs:.2} s from {there:?}");
        assert_same(&results(&out), &expected, &format!("killed after {after:.2} s"));
        assert!(!kept(&out).iter().any(|n| n.contains(".step.") || n == "lock"), "{:?}", kept(&out));
    }
    assert!(2 * midway > kills(), "only {midway} of {} runs were killed midway", kills());
}

#[test]
fn killed_again_and_again_in_one_folder_it_still_arrives() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    let begin = Instant::now();
    // Soft tissue is one step, longer than a slice.
    done(&mut animate(&whole, &["--stage", "pose"]));
    let slice = begin.elapsed() / 2;
    let mut rounds = 0;
    loop {
        let mut child = start(&mut animate(&out, &["--stage", "pose", "--resume"]));
        // Half the time of a whole run each, so that it must go on where it was.
        let end = Instant::now() + slice;
        while Instant::now() < end && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(20));
        }
        rounds += 1;
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success());
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(rounds < 20, "it does not get on");
    }
    println!("arrived in round {rounds}, in slices of {:.2} s", slice.as_secs_f64());
    assert!(rounds > 1);
    assert_same(&results(&out), &results(&whole), "after many kills");
}

#[test]
fn a_second_run_in_a_folder_is_told_who_the_first_is_and_a_killed_run_holds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut first = start(&mut animate(&out, &[]));
    while !kept(&out).contains(&"lock".to_owned()) {
        assert!(first.try_wait().unwrap().is_none(), "the first run ended early");
        std::thread::sleep(Duration::from_millis(2));
    }
    let second = animate(&out, &[]).output().unwrap();
    let said = text(&second.stderr);
    println!("{said}");
    assert_eq!(second.status.code(), Some(1));
    assert!(said.contains(&format!("process {}", first.id())) || said.contains("just begun"), "{said}");
    assert_eq!(said.trim_end().lines().count(), 1);
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(kept(&out).contains(&"lock".to_owned()), "killed, it could not clean up");
    done(&mut animate(&out, &["--resume"]));
}

#[test]
fn ctrl_c_keeps_what_is_done_and_prints_the_command_that_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, out) = (folder.path().join("whole"), folder.path().join("a folder"));
    done(&mut animate(&whole, &[]));
    let child = start(&mut animate(&out, &[]));
    while !kept(&out).iter().any(|n| n.contains(".step.refinement")) {
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    let said = text(&ended.stderr);
    println!("{said}{:?}", kept(&out));
    assert_eq!(ended.status.code(), Some(1));
    assert!(results(&out).is_empty(), "stopped midway, it has no results");
    let command = said.split("go on with: ").nth(1).unwrap().trim();
    assert!(command.ends_with("--resume") && command.contains("'"), "{command}");
    assert!(Command::new("sh").args(["-c", command]).status().unwrap().success());
    assert_same(&results(&out), &results(&whole), "after Ctrl-C");
}

/// Every file of the results that is there is whole: as `expected` has it, and no part of one is left.
fn assert_nothing_half_written(out: &Path, expected: &[(String, Vec<u8>)]) {
    for (name, bytes) in if out.exists() { results(out) } else { Vec::new() } {
        assert!(expected.contains(&(name.clone(), bytes)), "{name} is there in part");
    }
    assert!(!kept(out).iter().any(|n| n.ends_with(".part")), "{:?}", kept(out));
}

#[test]
fn where_files_may_not_grow_the_error_names_the_file_and_nothing_is_left_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    // What is kept of soft tissue is larger than every result, so that no limit would fall between.
    done(&mut animate(&whole, &["--stage", "pose"]));
    let expected = results(&whole);
    let largest = expected.iter().map(|f| f.1.len()).max().unwrap();
    let (mut said, out) = (Vec::new(), folder.path().join("out"));
    // Blocks of 512 bytes: room for a lock, for every step of the fit, for all but the largest result.
    for blocks in [1, 128, largest / 512 - 1] {
        let inner = format!("{:?}", animate(&out, &["--stage", "pose", "--resume"])).replace('"', "'");
        let limited = format!("trap '' XFSZ; ulimit -f {blocks}; exec {inner}");
        // POSIX counts in 512 bytes; bash does so only when asked.
        let ended = Command::new("sh").env("POSIXLY_CORRECT", "1").args(["-c", &limited]).output().unwrap();
        let error = text(&ended.stderr);
        println!("{blocks} blocks: {error}");
        assert_eq!(ended.status.code(), Some(1), "{error}");
        assert!(error.trim_end().lines().count() == 1 && error.contains("out/"), "{error}");
        assert_nothing_half_written(&out, &expected);
        said.push(error);
    }
    said.dedup();
    assert_eq!(said.len(), 3, "each limit stops another file");
    done(&mut animate(&out, &["--stage", "pose", "--resume"]));
    assert_same(&results(&out), &expected, "with room again");
}

#[test]
fn on_a_full_disk_the_error_is_clear_and_the_run_goes_on_once_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, disk) = (folder.path().join("whole"), folder.path().join("disk"));
    done(&mut animate(&whole, &[]));
    let expected = results(&whole);
    std::fs::create_dir(&disk).unwrap();
    let mount = |size: &str, how: &str| {
        let options = format!("{how}size={size}");
        let run = Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(&disk).output();
        run.is_ok_and(|o| o.status.success())
    };
    if !mount("64k", "") {
        println!("skipped: no file system can be mounted here");
        return;
    }
    let out = disk.join("out");
    let mut errors = Vec::new();
    for size in ["64k", "300k", "800k"] {
        assert!(mount(size, "remount,"));
        let ended = animate(&out, &["--resume"]).output().unwrap();
        let error = text(&ended.stderr);
        println!("{size}: {error}{:?}", kept(&out));
        errors.push((ended.status.code(), error));
        assert_nothing_half_written(&out, &expected);
    }
    assert!(mount("16m", "remount,"));
    let last = animate(&out, &["--resume"]).output().unwrap();
    let same = results(&out) == expected;
    assert!(Command::new("umount").arg(&disk).status().unwrap().success());
    for (code, error) in errors {
        assert_eq!(code, Some(1));
        assert!(error.contains("No space left") && error.trim_end().lines().count() == 1, "{error}");
    }
    assert!(last.status.success() && same, "{}", text(&last.stderr));
}

#[test]
fn a_finished_run_is_not_done_again_and_a_lost_file_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let first = done(&mut animate(&out, &["--json"]));
    let expected = results(&out);
    let written = |name: &str| std::fs::metadata(out.join(name)).unwrap().modified().unwrap();
    let before = written("views.mp4");
    let again = done(&mut animate(&out, &["--resume", "--json"]));
    assert_eq!(again.stdout, first.stdout, "the same report, timings and all");
    assert_eq!(written("views.mp4"), before);
    std::fs::remove_file(out.join("contact_sheet.png")).unwrap();
    done(&mut animate(&out, &["--resume"]));
    assert_same(&results(&out), &expected, "after a file was lost");
    // Other options are another run.
    done(&mut animate(&out, &["--resume", "--clip", "hello"]));
    assert_ne!(results(&out), expected);
}
