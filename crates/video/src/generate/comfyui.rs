use super::{About, Body, Call, Link, Order, Provider, State, Ticket, http, malformed, text};
use crate::error::{Result, VideoError};
use serde_json::{Value, json};

/// A ComfyUI server of one's own: <https://docs.comfy.org/development/comfyui-server/comms_routes>.
pub struct Comfyui;

const ABOUT: About = About {
    name: "comfyui",
    summary: "a ComfyUI server and a workflow saved in API format, with {image} and {prompt} in it (--workflow FILE)",
    keys: &[],
    url: "http://127.0.0.1:8188",
    model: "",
};

/// Endings of what a workflow may save as a video.
const MOVING: [&str; 6] = [".mp4", ".mov", ".webm", ".mkv", ".webp", ".gif"];
/// Between the parts of an upload; stands in no PNG by its length.
const BOUNDARY: &str = "animimic-7b1f0d7c4e0f4d5f9b6a2c8e3d1a5f60";

/// The workflow with the still's name, the prompt and further inputs put in.
fn workflow(order: &Order, image: &str) -> Result<Value> {
    let Some(workflow) = &order.ask.workflow else {
        return Err(VideoError::Caller(
            "comfyui needs --workflow FILE.json, saved in ComfyUI with \"Export (API)\", with {image} and {prompt} in it"
                .into(),
        ));
    };
    let text = workflow.to_string();
    if !text.contains("{image}") {
        return Err(VideoError::Caller(
            "the workflow has no {image}: put it where LoadImage names its file, and {prompt} where the text goes"
                .into(),
        ));
    }
    let mut values = order.ask.options.clone();
    values.insert("image".into(), json!(image));
    values.insert("prompt".into(), json!(order.ask.prompt));
    Ok(filled(workflow, &values))
}

/// The value with every `{name}` replaced; text that is nothing else takes the value's own kind.
fn filled(value: &Value, values: &serde_json::Map<String, Value>) -> Value {
    match value {
        Value::String(s) => {
            let whole = s.strip_prefix('{').and_then(|s| s.strip_suffix('}')).and_then(|name| values.get(name));
            whole.cloned().unwrap_or_else(|| json!(super::command::filled(s, values)))
        }
        Value::Array(all) => all.iter().map(|v| filled(v, values)).collect(),
        Value::Object(all) => {
            all.iter().map(|(k, v)| (k.clone(), filled(v, values))).collect::<serde_json::Map<_, _>>().into()
        }
        other => other.clone(),
    }
}

/// The upload of the still as multipart/form-data (RFC 7578).
fn upload(order: &Order) -> Call {
    let ending = if order.mime == "image/png" { "png" } else { "jpg" };
    let head = format!(
        "--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"image\"; filename=\"animimic.{ending}\"\r\n\
         Content-Type: {}\r\n\r\n",
        order.mime
    );
    let bytes = [head.as_bytes(), order.picture, format!("\r\n--{BOUNDARY}--\r\n").as_bytes()].concat();
    let body = Body::Bytes(format!("multipart/form-data; boundary={BOUNDARY}"), bytes);
    Call { url: format!("{}/upload/image", order.base), authorization: None, body }
}

fn prompt(order: &Order, image: &str) -> Result<Call> {
    let body = json!({"prompt": workflow(order, image)?, "client_id": "animimic"});
    Ok(Call::post(format!("{}/prompt", order.base), body))
}

/// The first file in the outputs that moves.
fn result(outputs: &Value) -> Option<&Value> {
    let lists = outputs.as_object()?.values().filter_map(Value::as_object).flat_map(|node| node.values());
    let mut files = lists.filter_map(Value::as_array).flatten().filter(|f| f.get("type") != Some(&json!("temp")));
    files.find(|f| {
        let name = f.get("filename").and_then(Value::as_str).unwrap_or_default().to_lowercase();
        MOVING.iter().any(|e| name.ends_with(e))
    })
}

/// Why a run ended in an error, from the last message that says so.
fn failure(status: &Value) -> String {
    let messages = status.get("messages").and_then(Value::as_array).into_iter().flatten();
    let words = messages.filter_map(|m| m.pointer("/1/exception_message").and_then(Value::as_str)).next_back();
    words.unwrap_or("no reason given").trim().to_owned()
}

impl Provider for Comfyui {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn request(&self, order: &Order, _now_unix_secs: u64) -> Result<Call> {
        prompt(order, "animimic.png")
    }

    fn submit(&self, order: &Order, link: &mut Link) -> Result<Ticket> {
        // Asked first: a workflow that cannot be used is not found out after the upload.
        workflow(order, "")?;
        let stored = link.send(&upload(order))?;
        let (name, folder) = (text(&stored, "/name", ABOUT.name)?, stored.get("subfolder").and_then(Value::as_str));
        let image = folder.filter(|f| !f.is_empty()).map_or(name.clone(), |f| format!("{f}/{name}"));
        let answer = link.send(&prompt(order, &image)?)?;
        Ok(Ticket { id: text(&answer, "/prompt_id", ABOUT.name)?, ..Ticket::default() })
    }

    fn poll(&self, order: &Order, ticket: &Ticket, link: &mut Link) -> Result<State> {
        let url = format!("{}/history/{}", order.base, http::percent_encoded(&ticket.id));
        let answer = link.send(&Call::get(url))?;
        let Some(history) = answer.as_object() else { return Err(malformed(ABOUT.name, &answer, "/")) };
        // What is queued or running is not in the history yet.
        let Some(entry) = history.get(&ticket.id) else { return Ok(State::Queued) };
        let status = entry.get("status").unwrap_or(&Value::Null);
        if status.get("status_str").and_then(Value::as_str) == Some("error") {
            return Ok(State::Failed(failure(status)));
        }
        if status.get("completed").and_then(Value::as_bool) == Some(false) {
            return Ok(State::Running);
        }
        let outputs = entry.get("outputs").ok_or_else(|| malformed(ABOUT.name, entry, "/outputs"))?;
        let Some(file) = result(outputs) else {
            return Ok(State::Failed("the workflow saved no video: end it with a node that saves one".into()));
        };
        let part = |name: &str| http::percent_encoded(file.get(name).and_then(Value::as_str).unwrap_or_default());
        let query = format!("filename={}&subfolder={}&type={}", part("filename"), part("subfolder"), part("type"));
        Ok(State::At(format!("{}/view?{query}", order.base)))
    }
}
