//! Every provider of videos against a server on this machine that speaks the service's documented protocol.
// In tests a panic is the message; helpers outside #[test] functions count as well.
#![allow(clippy::unwrap_used)]

#[path = "support/server.rs"]
mod server;
mod support;

use animimic_video::generate::{Ask, Generated, Host, JobFile, Patience, generate, job_path, plan, provider};
use animimic_video::{VideoError, write_gif, write_mp4, write_png};
use serde_json::{Value, json};
use server::{Reply, Request, Server};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// What the environment holds: found in no file, message or log.
const SECRETS: [&str; 2] = ["key-0123456789-first", "key-abcdefghij-second"];
/// The services that are spoken to over HTTP.
const SERVICES: [&str; 4] = ["comfyui", "fal", "kling", "replicate"];
const START: u64 = 1_700_000_000;

/// A clock that runs as fast as it is asked to.
struct World {
    waited: Vec<f64>,
    news: Vec<&'static str>,
    /// The user stops at this wait.
    stop_at: usize,
    keys: bool,
}

fn world() -> World {
    World { waited: Vec::new(), news: Vec::new(), stop_at: usize::MAX, keys: true }
}

impl Host for World {
    fn unix_secs(&self) -> u64 {
        START + self.waited.iter().sum::<f64>() as u64
    }

    fn wait(&mut self, secs: f64) -> ControlFlow<()> {
        self.waited.push(secs);
        std::thread::sleep(std::time::Duration::from_millis(1));
        if self.waited.len() > self.stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn variable(&self, name: &str) -> Option<String> {
        let second = name == "KLING_SECRET_KEY";
        let known = ["FAL_KEY", "KLING_ACCESS_KEY", "KLING_SECRET_KEY", "REPLICATE_API_TOKEN"].contains(&name);
        (self.keys && known).then(|| SECRETS[usize::from(second)].to_owned())
    }

    fn news(&mut self, words: &'static str) {
        self.news.push(words);
    }
}

/// The keys that a service is sent.
fn keys_of(name: &str) -> &'static [&'static str] {
    match name {
        "comfyui" => &[],
        "kling" => &SECRETS,
        _ => &SECRETS[..1],
    }
}

/// How a service ends its jobs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Video,
    Failure,
    Never,
    /// The answer to the order is JSON of another shape.
    NonsenseToOrder,
    /// The answer to the poll is JSON of another shape.
    NonsenseToPoll,
    /// The answer to the order is a web page.
    Page,
    /// What it calls a video is a web page.
    NoVideo,
}

/// A service: says `stumbles` first (status by status, repeating the keys), then queues for two polls.
fn service(name: &'static str, end: End, mut stumbles: Vec<u16>) -> Server {
    let video = movie();
    let mut polls = 0;
    Server::start(move |request, own| {
        if !stumbles.is_empty() {
            let said = format!("busy, {} {:?}", request.header("authorization"), keys_of(name));
            let headers = vec![("Retry-After", "7".to_owned())];
            return Reply { headers, ..Reply::new(stumbles.remove(0), said) };
        }
        let path = request.path.as_str();
        if path.starts_with("/files/") || path.starts_with("/view") {
            return Reply::new(200, if end == End::NoVideo { b"<html>gone</html>".to_vec() } else { video.clone() });
        }
        if path == "/upload/image" {
            return Reply::json(&json!({"name": "animimic (1).png", "subfolder": "", "type": "input"}));
        }
        if path.ends_with("/response") {
            return Reply::json(&json!({"video": {"url": format!("{own}/files/v.mp4"), "content_type": "video/mp4"}}));
        }
        if request.method == "POST" {
            return match end {
                End::NonsenseToOrder => Reply::json(&json!({"hello": [1, 2], "echo": keys_of(name)})),
                End::Page => Reply::new(200, format!("<html>{}</html>", request.header("authorization"))),
                _ => Reply::json(&accepted(name, own)),
            };
        }
        polls += 1;
        match (polls, end) {
            (_, End::NonsenseToPoll) => Reply::json(&json!(["what", keys_of(name)])),
            (1, _) => Reply::json(&standing(name, own, 0, end)),
            (2, _) | (_, End::Never) => Reply::json(&standing(name, own, 1, end)),
            _ => Reply::json(&standing(name, own, 2, end)),
        }
    })
}

/// What a service answers to an order.
fn accepted(name: &str, own: &str) -> Value {
    match name {
        "comfyui" => json!({"prompt_id": "job-1", "number": 3, "node_errors": {}}),
        "fal" => json!({
            "status": "IN_QUEUE", "request_id": "job-1", "status_url": format!("{own}/queue/job-1/status"),
            "response_url": format!("{own}/queue/job-1/response"),
        }),
        "kling" => json!({"code": 0, "message": "SUCCEED", "data": {"task_id": "job-1", "task_status": "submitted"}}),
        _ => json!({"id": "job-1", "status": "starting", "urls": {"get": format!("{own}/v1/predictions/job-1")}}),
    }
}

/// What a service answers to a poll at stage 0 (queued), 1 (running) or 2 (ended).
fn standing(name: &str, own: &str, stage: usize, end: End) -> Value {
    let failed = end == End::Failure;
    let file = format!("{own}/files/v.mp4");
    match name {
        "comfyui" if stage < 2 => json!({}),
        "comfyui" if failed => json!({"job-1": {"outputs": {}, "status": {"status_str": "error", "completed": false,
            "messages": [["execution_start", {}], ["execution_error", {"exception_message": "too wild\n"}]]}}}),
        "comfyui" => {
            json!({"job-1": {"status": {"status_str": "success", "completed": true, "messages": []}, "outputs": {
            "3": {"images": [{"filename": "preview.png", "subfolder": "", "type": "temp"}]},
            "9": {"images": [{"filename": "a b_00001_.mp4", "subfolder": "video", "type": "output"}], "animated": [true]}}}})
        }
        "fal" => match (stage, failed) {
            (2, true) => json!({"status": "COMPLETED", "error": "too wild", "error_type": "content_policy"}),
            _ => {
                let status = ["IN_QUEUE", "IN_PROGRESS", "COMPLETED"][stage];
                json!({"status": status, "request_id": "job-1"})
            }
        },
        "kling" => {
            let status = ["submitted", "processing", if failed { "failed" } else { "succeed" }][stage];
            let result = if stage == 2 && !failed { json!({"videos": [{"id": "v", "url": file}]}) } else { json!({}) };
            json!({"code": 0, "message": "SUCCEED", "data": {"task_id": "job-1", "task_status": status,
                "task_status_msg": if failed { "too wild" } else { "" }, "task_result": result}})
        }
        _ => {
            let status = ["starting", "processing", if failed { "failed" } else { "succeeded" }][stage];
            let output = if stage == 2 && !failed { json!([file]) } else { Value::Null };
            json!({"id": "job-1", "status": status, "output": output, "error": if failed { json!("too wild") } else { Value::Null }})
        }
    }
}

/// A short MP4.
fn movie() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.mp4");
    write_mp4(&path, &mut support::disc(64, 48, 5).into_iter(), 24.0).unwrap();
    std::fs::read(path).unwrap()
}

/// A folder with a still, and what is asked.
fn order(url: &str) -> (tempfile::TempDir, Ask, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("still.png");
    write_png(&picture, &support::disc_frame(64, 48, 0)).unwrap();
    let workflow = json!({"1": {"class_type": "LoadImage", "inputs": {"image": "{image}"}},
        "2": {"class_type": "CLIPTextEncode", "inputs": {"text": "{prompt}, sharp", "seed": "{seed}"}}});
    let ask = Ask {
        picture,
        prompt: "it \"jumps\"".into(),
        url: Some(url.to_owned()),
        options: [("seed".to_owned(), json!(5))].into_iter().collect(),
        workflow: Some(workflow),
        ..Ask::default()
    };
    let out = folder.path().join("motion.mp4");
    (folder, ask, out)
}

const PATIENCE: Patience =
    Patience { first_secs: 2.0, longest_secs: 15.0, job_secs: 600, request_secs: 20, attempts: 4 };

fn run(name: &str, ask: &Ask, out: &Path, world: &mut World) -> Result<Generated, VideoError> {
    let made = generate(provider(name).unwrap(), ask, out, false, &PATIENCE, world);
    let folder = out.parent().unwrap();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let bytes = std::fs::read(entry.path()).unwrap();
        assert_no_secret(&String::from_utf8_lossy(&bytes), &entry.path().display().to_string());
    }
    if let Err(e) = &made {
        println!("{name}: {e}");
        assert_no_secret(&format!("{e} {e:?}"), name);
        assert!(e.to_string().lines().count() == 1);
    }
    made
}

fn assert_no_secret(text: &str, place: &str) {
    assert!(!SECRETS.iter().any(|s| text.contains(s)), "a key is in {place}: {text}");
    assert!(!text.contains("eyJhbGciOiJIUzI1NiI"), "a token is in {place}: {text}");
}

fn orders(server: &Server) -> Vec<Request> {
    server.seen().into_iter().filter(|r| r.method == "POST" && r.path != "/upload/image").collect()
}

#[test]
fn every_service_is_asked_once_waited_for_and_its_video_arrives_whole() {
    for name in SERVICES {
        let server = service(name, End::Video, vec![]);
        let (_folder, ask, out) = order(&server.url);
        let mut world = world();
        let made = run(name, &ask, &out, &mut world).unwrap();
        println!("{name}: {made:?}, waited {:?}, {:?}", world.waited, world.news);
        assert_eq!((made.id.as_str(), made.resumed, made.frames, made.size), ("job-1", false, 5, (64, 48)));
        assert_eq!(std::fs::read(&out).unwrap(), movie());
        assert_eq!(world.waited, [2.0, 3.0]);
        assert_eq!(orders(&server).len(), 1);
        check_order(name, &orders(&server)[0], &server, &std::fs::read(&ask.picture).unwrap());
        // Once more: nothing is asked.
        let before = server.seen().len();
        assert!(run(name, &ask, &out, &mut world).unwrap().resumed);
        assert_eq!(server.seen().len(), before, "{name}");
    }
}

/// Whether the order is what the service's documentation wants.
fn check_order(name: &str, request: &Request, server: &Server, picture: &[u8]) {
    use base64::Engine;
    let body = request.json();
    let encoded = base64::engine::general_purpose::STANDARD.encode(picture);
    let uri = format!("data:image/png;base64,{encoded}");
    match name {
        "comfyui" => {
            assert_eq!(request.path, "/prompt");
            assert_eq!(body["prompt"]["1"]["inputs"]["image"], "animimic (1).png", "the name that the server gave");
            assert_eq!(body["prompt"]["2"]["inputs"]["text"], "it \"jumps\", sharp");
            assert_eq!(body["prompt"]["2"]["inputs"]["seed"], 5);
            let upload = &server.seen()[0];
            assert!(upload.header("content-type").starts_with("multipart/form-data; boundary="));
            assert!(upload.body.windows(picture.len()).any(|w| w == picture));
            let view = server.seen().into_iter().find(|r| r.path.starts_with("/view")).unwrap();
            assert_eq!(view.path, "/view?filename=a%20b_00001_.mp4&subfolder=video&type=output");
        }
        "fal" => {
            assert_eq!(request.path, "/fal-ai/kling-video/v2.1/standard/image-to-video");
            assert_eq!(request.header("authorization"), format!("Key {}", SECRETS[0]));
            assert_eq!(body, json!({"prompt": "it \"jumps\"", "image_url": uri, "seed": 5}));
        }
        "kling" => {
            assert_eq!(request.path, "/v1/videos/image2video");
            assert_eq!(
                body,
                json!({"model_name": "kling-v2-1", "image": encoded, "prompt": "it \"jumps\"",
                "duration": "5", "mode": "std", "seed": 5})
            );
            let token = request.header("authorization").strip_prefix("Bearer ").unwrap().to_owned();
            let claims = token.split('.').nth(1).unwrap();
            let claims = base64::engine::general_purpose::URL_SAFE_NO_PAD.decode(claims).unwrap();
            let claims: Value = serde_json::from_slice(&claims).unwrap();
            assert_eq!(claims, json!({"iss": SECRETS[0], "exp": START + 1800, "nbf": START - 5}));
        }
        _ => {
            assert_eq!(request.path, "/v1/models/wan-video/wan-2.2-i2v-fast/predictions");
            assert_eq!(request.header("authorization"), format!("Bearer {}", SECRETS[0]));
            assert_eq!(body, json!({"input": {"prompt": "it \"jumps\"", "image": uri, "seed": 5}}));
        }
    }
    // The file may lie with a third party, which gets no key.
    for fetched in server.seen().iter().filter(|r| r.path.starts_with("/files/")) {
        assert_eq!(fetched.header("authorization"), "");
    }
}

#[test]
fn a_failure_is_told_with_the_services_reason_and_the_next_run_asks_anew() {
    for name in SERVICES {
        let server = service(name, End::Failure, vec![]);
        let (_folder, ask, out) = order(&server.url);
        let error = run(name, &ask, &out, &mut world()).unwrap_err().to_string();
        assert!(error.contains("job-1") && error.contains("too wild"), "{error}");
        assert!(!out.exists() && !job_path(&out).exists());
    }
}

#[test]
fn a_job_that_takes_too_long_is_kept_and_the_next_run_goes_on_with_it() {
    for name in SERVICES {
        let server = service(name, End::Never, vec![]);
        let (_folder, ask, out) = order(&server.url);
        let mut slow = world();
        let error = run(name, &ask, &out, &mut slow).unwrap_err().to_string();
        let waited: f64 = slow.waited.iter().sum();
        println!("{name} waited {waited} s in {} pauses, longest {:?}", slow.waited.len(), slow.waited.last());
        assert!(error.contains("600 s") && error.contains("again") && (600.0..620.0).contains(&waited));
        assert!(!out.exists() && slow.waited.last() == Some(&15.0));
        assert!(run(name, &ask, &out, &mut world()).is_err());
        assert_eq!(orders(&server).len(), 1, "{name}");
    }
}

#[test]
fn answers_that_make_no_sense_are_errors_that_show_them() {
    for name in SERVICES {
        for end in [End::NonsenseToOrder, End::NonsenseToPoll, End::Page, End::NoVideo] {
            let server = service(name, end, vec![]);
            let (_folder, ask, out) = order(&server.url);
            let error = run(name, &ask, &out, &mut world()).unwrap_err();
            assert!(matches!(error, VideoError::Provider { .. }), "{error:?}");
            assert!(!out.exists());
            let kept = matches!(end, End::NonsenseToPoll | End::NoVideo);
            assert_eq!(job_path(&out).exists(), kept, "{name} {end:?}: only an accepted job is remembered");
        }
    }
}

#[test]
fn a_service_that_is_busy_or_broken_is_asked_again_as_it_wishes_and_given_up_in_the_end() {
    for name in SERVICES {
        let server = service(name, End::Video, vec![429, 500, 503]);
        let (_folder, ask, out) = order(&server.url);
        let mut patient = world();
        run(name, &ask, &out, &mut patient).unwrap();
        assert_eq!(patient.waited, [7.0, 7.0, 7.0, 2.0, 3.0], "{name}: Retry-After, then polls");
        let server = service(name, End::Video, vec![503; 99]);
        let (_folder, ask, out) = order(&server.url);
        let error = run(name, &ask, &out, &mut world()).unwrap_err().to_string();
        assert!(error.contains("503") && error.contains("4 attempts"), "{error}");
        assert_eq!(server.seen().len(), 4);
        let server = service(name, End::Video, vec![401]);
        let (_folder, ask, out) = order(&server.url);
        let error = run(name, &ask, &out, &mut world()).unwrap_err().to_string();
        assert!(error.contains("401") && server.seen().len() == 1, "{error}");
        assert_eq!(error.contains("check the key"), !keys_of(name).is_empty());
    }
}

#[test]
fn a_run_that_was_stopped_goes_on_with_its_job_and_asks_for_no_second_one() {
    for name in SERVICES {
        let server = service(name, End::Video, vec![]);
        let (_folder, ask, out) = order(&server.url);
        let mut stopped = World { stop_at: 0, ..world() };
        assert!(matches!(run(name, &ask, &out, &mut stopped), Err(VideoError::Stopped)));
        let job = JobFile::read(&out).unwrap().unwrap();
        println!("{job:?}");
        assert!(job.ticket.id == "job-1" && !job.done && !out.exists());
        // Another order does not throw the open job away.
        let other = Ask { prompt: "it sleeps".into(), ..ask.clone() };
        let error = run(name, &other, &out, &mut world()).unwrap_err().to_string();
        assert!(error.contains("job-1") && error.contains("--again"), "{error}");
        let made = run(name, &ask, &out, &mut world()).unwrap();
        assert!(made.resumed && JobFile::read(&out).unwrap().unwrap().done);
        assert_eq!(orders(&server).len(), 1, "{name}");
        generate(provider(name).unwrap(), &ask, &out, true, &PATIENCE, &mut world()).unwrap();
        assert_eq!(orders(&server).len(), 2, "{name}: asked anew on request");
    }
}

#[test]
fn an_order_whose_answer_does_not_come_is_not_sent_twice() {
    let server = Server::start(|_, own| Reply { delay_ms: 2500, ..Reply::json(&accepted("fal", own)) });
    let (_folder, ask, out) = order(&server.url);
    let patience = Patience { request_secs: 1, ..PATIENCE };
    let mut world = world();
    let error = generate(provider("fal").unwrap(), &ask, &out, false, &patience, &mut world).unwrap_err();
    println!("{error}");
    assert_eq!((server.seen().len(), world.waited.len()), (1, 0));
}

#[test]
fn a_dry_run_shows_the_request_without_key_and_sends_nothing() {
    for name in SERVICES {
        let server = service(name, End::Video, vec![]);
        let (_folder, ask, _) = order(&server.url);
        for keys in [true, false] {
            let shown = plan(provider(name).unwrap(), &ask, &World { keys, ..world() }).unwrap().to_string();
            println!("{shown}");
            assert_no_secret(&shown, name);
            assert!(shown.contains("jumps") && shown.contains(&server.url));
        }
        assert!(server.seen().is_empty());
    }
}

#[test]
fn missing_keys_bad_addresses_and_bad_orders_are_refused_before_anything_is_sent() {
    let (folder, ask, out) = order("http://127.0.0.1:9");
    let refuse = |name: &str, ask: &Ask, world: &mut World, words: &str| {
        let error = run(name, ask, &out, world).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    let no_keys = || World { keys: false, ..world() };
    refuse("fal", &ask, &mut no_keys(), "ANIMIMIC_FAL_KEY or FAL_KEY");
    refuse("kling", &ask, &mut no_keys(), "KLING_SECRET_KEY");
    refuse("replicate", &ask, &mut no_keys(), "REPLICATE_API_TOKEN");
    refuse("fal", &Ask { url: Some("https://me:pw@a.b".into()), ..ask.clone() }, &mut world(), "no password");
    refuse("fal", &Ask { url: Some("ftp://a.b".into()), ..ask.clone() }, &mut world(), "https://");
    refuse("fal", &Ask { prompt: " ".into(), ..ask.clone() }, &mut world(), "prompt");
    refuse("comfyui", &Ask { workflow: None, ..ask.clone() }, &mut world(), "--workflow");
    refuse("comfyui", &Ask { workflow: Some(json!({"1": 2})), ..ask.clone() }, &mut world(), "{image}");
    refuse("command", &ask, &mut world(), "{out}");
    refuse("replicate", &ask, &mut world(), "cannot be reached");
    std::fs::write(folder.path().join("words.png"), b"words").unwrap();
    refuse("fal", &Ask { picture: folder.path().join("words.png"), ..ask.clone() }, &mut world(), "PNG or JPEG");
    std::fs::write(job_path(&out), b"{\"half\":").unwrap();
    refuse("fal", &ask, &mut world(), "delete it");
    assert!(!out.exists());
}

#[cfg(unix)]
#[test]
fn a_program_makes_the_video_is_told_apart_from_a_shell_and_its_failures_are_told() {
    let (folder, ask, out) = order("");
    let source = folder.path().join("source.mp4");
    std::fs::write(&source, movie()).unwrap();
    let run_program = |command: &[&str], world: &mut World| {
        let command = command.iter().map(|s| (*s).to_owned()).collect();
        run(
            "command",
            &Ask { command, url: None, prompt: "it $(touch x); \"jumps\"".into(), ..ask.clone() },
            &out,
            world,
        )
    };
    let fails = |command: &[&str], words: &str| {
        let error = run_program(command, &mut world()).unwrap_err().to_string();
        assert!(error.contains(words) && !out.exists(), "{error}");
    };
    let source = source.display().to_string();
    fails(&["sh", "-c", "echo first >&2; echo no film >&2; exit 3", "{out}"], "no film");
    fails(&["true", "{out}"], "wrote no {out}");
    fails(&["no-such-program-anywhere", "{out}"], "cannot be started");
    fails(&["cp", "{image}", "{out}"], "cannot be used");
    let mut impatient = World { stop_at: 3, ..world() };
    assert!(matches!(run_program(&["sh", "-c", "exec sleep 60", "{out}"], &mut impatient), Err(VideoError::Stopped)));
    // $1 is the prompt as it is: no shell has looked at it.
    let script = "test \"$1\" = 'it $(touch x); \"jumps\"' && test -f \"$2\" && cp \"$3\" \"$4\"";
    let made = run_program(&["sh", "-c", script, "sh", "{prompt}", "{image}", &source, "{out}"], &mut world()).unwrap();
    assert_eq!((made.frames, std::fs::read(&out).unwrap()), (5, movie()));
}

#[test]
fn a_video_that_is_there_already_is_replaced_only_on_request() {
    let (folder, ask, out) = order("");
    let source = folder.path().join("source.mp4");
    std::fs::write(&source, movie()).unwrap();
    let command = vec!["cp".into(), source.display().to_string(), "{out}".into()];
    let asked = |prompt: &str, again: bool| {
        let ask = Ask { command: command.clone(), url: None, prompt: prompt.into(), ..ask.clone() };
        generate(provider("command").unwrap(), &ask, &out, again, &Patience::default(), &mut world())
    };
    let kept = |bytes: &[u8]| {
        let error = asked("it runs", false).unwrap_err().to_string();
        assert!(error.contains("is there already") && error.contains("--again"), "{error}");
        assert_eq!(std::fs::read(&out).unwrap(), bytes);
    };
    std::fs::write(&out, b"somebody's own").unwrap();
    kept(b"somebody's own");
    asked("it jumps", true).unwrap();
    kept(&movie());
    assert!(asked("it jumps", false).unwrap().resumed, "what was asked for is there");
    assert!(!asked("it runs", true).unwrap().resumed);
}

#[test]
fn a_video_of_another_kind_becomes_an_mp4() {
    let (folder, ask, out) = order("");
    let gif = folder.path().join("g.gif");
    write_gif(&gif, &mut support::disc(64, 48, 6).into_iter(), 10.0).unwrap();
    let bytes = std::fs::read(&gif).unwrap();
    let server = Server::start(move |request, own| match request.path.as_str() {
        "/files/v.mp4" => Reply::new(200, bytes.clone()),
        _ if request.method == "POST" => Reply::json(&accepted("replicate", own)),
        _ => Reply::json(&standing("replicate", own, 2, End::Video)),
    });
    let made = run("replicate", &Ask { url: Some(server.url.clone()), ..ask }, &out, &mut world()).unwrap();
    assert_eq!((made.frames, made.fps), (6, 10.0));
    assert_eq!(&std::fs::read(&out).unwrap()[4..8], b"ftyp");
}
