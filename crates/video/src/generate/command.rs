use super::{About, Call, Link, Order, Provider, State, Ticket};
use crate::error::{Result, VideoError};
use serde_json::{Map, Value, json};
use std::io::Read;
use std::process::{Child, Stdio};

/// A program of one's own: its arguments name the still, the prompt and the file to write.
pub struct Command;

const ABOUT: About = About {
    name: "command",
    summary: "a program of yours: -- PROGRAM ARGUMENTS..., with {image}, {prompt} and {out} in them",
    keys: &[],
    url: "",
    model: "",
};

/// Pause between two looks at the running program [s].
const LOOK_SECS: f64 = 0.1;
/// What is kept of what the program says [bytes].
const KEPT: u64 = 4096;

/// The text with every `{name}` replaced in one pass, so that braces in a value stay as they are.
pub(super) fn filled(text: &str, values: &Map<String, Value>) -> String {
    let (mut out, mut rest) = (String::new(), text);
    while let Some(at) = rest.find('{') {
        let value = rest[at + 1..].find('}').and_then(|end| Some((end, values.get(&rest[at + 1..at + 1 + end])?)));
        out += &rest[..at];
        rest = &rest[at..];
        match value {
            Some((end, value)) => {
                out += &value.as_str().map_or_else(|| value.to_string(), str::to_owned);
                rest = &rest[end + 2..];
            }
            None => {
                out.push('{');
                rest = &rest[1..];
            }
        }
    }
    out + rest
}

fn arguments(order: &Order, out: &str) -> Result<Vec<String>> {
    let command = &order.ask.command;
    if command.is_empty() || !command.iter().any(|a| a.contains("{out}")) {
        return Err(VideoError::Caller(
            "the provider command needs a program with {out} among its arguments: -- PROGRAM {image} {prompt} {out}"
                .into(),
        ));
    }
    let mut values = order.ask.options.clone();
    values.insert("image".into(), json!(order.ask.picture.display().to_string()));
    values.insert("prompt".into(), json!(order.ask.prompt));
    values.insert("out".into(), json!(out));
    Ok(command.iter().map(|a| filled(a, &values)).collect())
}

/// Waits for the program; ends it where time is up or the user stops.
fn run(child: &mut Child, link: &mut Link) -> Result<std::process::ExitStatus> {
    let start = link.now();
    loop {
        if let Some(status) = child.try_wait().map_err(|e| link.error(format!("the program is lost: {e}")))? {
            return Ok(status);
        }
        let late = link.now().saturating_sub(start) >= link.patience().job_secs;
        let waited = if late { Ok(()) } else { link.wait(LOOK_SECS) };
        if late || waited.is_err() {
            // It may have ended by itself meanwhile; either way it is gone then.
            let _ = child.kill();
            let _ = child.wait();
            waited?;
            return Err(link.error(format!("the program did not end within {} s", link.patience().job_secs)));
        }
    }
}

impl Provider for Command {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn request(&self, order: &Order, _now_unix_secs: u64) -> Result<Call> {
        Ok(Call::post("", json!({"run": arguments(order, "result.mp4")?})))
    }

    fn submit(&self, order: &Order, _link: &mut Link) -> Result<Ticket> {
        arguments(order, "")?;
        Ok(Ticket { id: "local".into(), ..Ticket::default() })
    }

    /// Runs the program to its end: a program that was killed with us starts anew.
    fn poll(&self, order: &Order, _ticket: &Ticket, link: &mut Link) -> Result<State> {
        let folder = tempfile::tempdir().map_err(VideoError::io(std::env::temp_dir()))?;
        let out = folder.path().join("result.mp4");
        let said = folder.path().join("said.txt");
        let log = std::fs::File::create(&said).map_err(VideoError::io(&said))?;
        let arguments = arguments(order, &out.display().to_string())?;
        let mut child = std::process::Command::new(&arguments[0])
            .args(&arguments[1..])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .map_err(|e| link.error(format!("{:?} cannot be started: {e}", arguments[0])))?;
        link.host.news("the program makes the video");
        let status = run(&mut child, link)?;
        if !status.success() {
            let mut words = String::new();
            let file = std::fs::File::open(&said).map_err(VideoError::io(&said))?;
            // What is no UTF-8 is left out of the message.
            let _ = file.take(KEPT).read_to_string(&mut words);
            let last = words.lines().rfind(|l| !l.trim().is_empty()).unwrap_or("it gave no reason").trim().to_owned();
            return Ok(State::Failed(format!("{:?} ended with {status}: {last}", arguments[0])));
        }
        match std::fs::read(&out) {
            Ok(bytes) => Ok(State::Made(bytes)),
            Err(_) => Ok(State::Failed(format!("{:?} ended well but wrote no {{out}}", arguments[0]))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_braces_are_replaced_once_and_other_braces_stay() {
        let Value::Object(values) = json!({"prompt": "a {out} in {braces}", "out": "o.mp4", "n": 5}) else { panic!() };
        assert_eq!(filled("--p={prompt} {out} {n} {x} {", &values), "--p=a {out} in {braces} o.mp4 5 {x} {");
    }
}
