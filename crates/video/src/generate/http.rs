//! Requests to a service: sent again where it is busy, keys kept to its own host and out of every message.

use super::{About, Host, Patience};
use crate::error::{Result, VideoError};
use serde_json::{Value, json};
use std::time::Duration;
use ureq::http::Uri;

/// Largest answer that is no video [bytes].
const MAX_ANSWER: u64 = 16 << 20;
/// Largest video [bytes].
const MAX_VIDEO: u64 = 1 << 30;
/// Longest pause that a service may ask for [s].
const MAX_RETRY_AFTER_SECS: f64 = 120.0;
/// What of an answer is looked at for a message [bytes], and shown in it [characters].
const READ_FOR_MESSAGE: usize = 1 << 16;
const SHOWN: usize = 200;
/// Stands where a key stood.
const STRUCK_OUT: &str = "***";

/// What is sent with a request.
#[derive(Clone, Debug)]
pub enum Body {
    /// Nothing: a GET.
    None,
    /// JSON: a POST.
    Json(Value),
    /// Bytes of some content type: a POST.
    Bytes(String, Vec<u8>),
}

/// One request.
#[derive(Clone, Debug)]
pub struct Call {
    /// Address.
    pub url: String,
    /// The `Authorization` header; sent to the service's own host only.
    pub authorization: Option<String>,
    /// What is sent.
    pub body: Body,
}

impl Call {
    /// A GET without a key.
    pub fn get(url: impl Into<String>) -> Self {
        Self { url: url.into(), authorization: None, body: Body::None }
    }

    /// A POST of JSON without a key.
    pub fn post(url: impl Into<String>, body: Value) -> Self {
        Self { url: url.into(), authorization: None, body: Body::Json(body) }
    }

    /// The same with an `Authorization` header.
    pub fn authorized(self, authorization: String) -> Self {
        Self { authorization: Some(authorization), ..self }
    }

    /// The request for people to look at: no key, and long text as its length.
    pub fn shown(&self) -> Value {
        let scheme = |a: &String| format!("{} {STRUCK_OUT}", a.split(' ').next().unwrap_or_default());
        let (method, body) = match &self.body {
            Body::None => ("GET", Value::Null),
            Body::Json(body) => ("POST", abridged(body)),
            Body::Bytes(kind, bytes) => ("POST", json!(format!("<{} bytes of {kind}>", bytes.len()))),
        };
        if self.url.is_empty() {
            return body;
        }
        json!({"method": method, "url": self.url, "authorization": self.authorization.as_ref().map(scheme), "body": body})
    }
}

fn abridged(value: &Value) -> Value {
    const LONGEST: usize = 2000;
    match value {
        Value::String(s) if s.len() > LONGEST => {
            let head: String = s.chars().take(24).collect();
            json!(format!("{head}… <{} characters>", s.len()))
        }
        Value::Array(all) => all.iter().map(abridged).collect(),
        Value::Object(all) => {
            all.iter().map(|(k, v)| (k.clone(), abridged(v))).collect::<serde_json::Map<_, _>>().into()
        }
        other => other.clone(),
    }
}

/// The way to one service.
pub struct Link<'a> {
    agent: ureq::Agent,
    about: &'static About,
    base: &'a str,
    keys: &'a [String],
    patience: &'a Patience,
    /// Time and waiting.
    pub host: &'a mut dyn Host,
}

/// What came of one attempt.
enum Attempt {
    Answer(Vec<u8>),
    Later(Option<f64>, String),
    No(String),
    Broken(String),
}

impl<'a> Link<'a> {
    /// A way to the service at `base`.
    pub fn new(
        about: &'static About,
        base: &'a str,
        keys: &'a [String],
        patience: &'a Patience,
        host: &'a mut dyn Host,
    ) -> Self {
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(patience.request_secs)))
            .user_agent(concat!("animimic/", env!("CARGO_PKG_VERSION")))
            .build();
        Self { agent: config.new_agent(), about, base, keys, patience, host }
    }

    /// Seconds since 1970.
    pub fn now(&self) -> u64 {
        self.host.unix_secs()
    }

    /// How long to wait.
    pub fn patience(&self) -> &Patience {
        self.patience
    }

    /// Sends a request; JSON that comes back, or why the service says no for good (4xx, but for keys and haste).
    ///
    /// # Errors
    /// As [`Link::send`], but for such a no.
    pub fn ask(&mut self, call: &Call) -> Result<std::result::Result<Value, String>> {
        match self.bytes(call, MAX_ANSWER)? {
            Ok(bytes) => self.json(call, &bytes).map(Ok),
            Err(no) => Ok(Err(no)),
        }
    }

    /// Sends a request and reads the JSON that comes back.
    ///
    /// # Errors
    /// [`VideoError::Provider`] when the service refuses, stays busy, cannot be reached or answers no JSON;
    /// [`VideoError::Stopped`] when the user wants to stop.
    pub fn send(&mut self, call: &Call) -> Result<Value> {
        self.ask(call)?.map_err(|no| self.error(no))
    }

    fn json(&self, call: &Call, bytes: &[u8]) -> Result<Value> {
        serde_json::from_slice(bytes).map_err(|_| {
            let head = self.head(bytes, call);
            self.error(format!("{} answers no JSON but {head:?}", host_of(&call.url)))
        })
    }

    /// Downloads a video.
    ///
    /// # Errors
    /// As [`Link::send`].
    pub fn download(&mut self, url: &str) -> Result<Vec<u8>> {
        self.bytes(&Call::get(url), MAX_VIDEO)?.map_err(|no| self.error(no))
    }

    /// An error of this provider, with every key struck out.
    pub fn error(&self, reason: impl Into<String>) -> VideoError {
        VideoError::Provider { provider: self.about.name, reason: struck_out(&reason.into(), self.keys) }
    }

    /// Waits so long [s].
    ///
    /// # Errors
    /// [`VideoError::Stopped`] when the user wants to stop.
    pub fn wait(&mut self, secs: f64) -> Result<()> {
        if self.host.wait(secs).is_break() { Err(VideoError::Stopped) } else { Ok(()) }
    }

    fn bytes(&mut self, call: &Call, limit: u64) -> Result<std::result::Result<Vec<u8>, String>> {
        let mut last = String::new();
        for n in 0..self.patience.attempts.max(1) {
            match self.attempt(call, limit) {
                Attempt::Answer(bytes) => return Ok(Ok(bytes)),
                Attempt::No(reason) => return Ok(Err(without_token(&reason, call))),
                Attempt::Broken(reason) => return Err(self.error(without_token(&reason, call))),
                Attempt::Later(after, reason) => {
                    last = without_token(&reason, call);
                    if n + 1 < self.patience.attempts {
                        self.wait(after.unwrap_or_else(|| self.patience.pause(n)))?;
                    }
                }
            }
        }
        Err(self.error(format!("{last} ({} attempts); try again later", self.patience.attempts.max(1))))
    }

    /// The beginning of an answer, fit for a message. Keys go before it is cut, or half a key could be left.
    fn head(&self, bytes: &[u8], call: &Call) -> String {
        let text = String::from_utf8_lossy(&bytes[..bytes.len().min(READ_FOR_MESSAGE)]);
        let text = without_token(&struck_out(&text, self.keys), call);
        text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(SHOWN).collect()
    }

    fn attempt(&self, call: &Call, limit: u64) -> Attempt {
        let own = same_origin(&call.url, self.base);
        let key = call.authorization.as_ref().filter(|_| own);
        let sent = match &call.body {
            Body::None => {
                // A video may take as long as the job.
                let secs = if limit > MAX_ANSWER { self.patience.job_secs } else { self.patience.request_secs };
                let timeout = Some(Duration::from_secs(secs));
                let request = self.agent.get(&call.url).config().timeout_global(timeout).build();
                key.into_iter().fold(request, |r, k| r.header("Authorization", k)).call()
            }
            Body::Json(body) => {
                let request = self.agent.post(&call.url).content_type("application/json");
                key.into_iter().fold(request, |r, k| r.header("Authorization", k)).send(body.to_string())
            }
            Body::Bytes(kind, bytes) => {
                let request = self.agent.post(&call.url).content_type(kind);
                key.into_iter().fold(request, |r, k| r.header("Authorization", k)).send(&bytes[..])
            }
        };
        let host = host_of(&call.url);
        let mut answer = match sent {
            Ok(answer) => answer,
            Err(e) => {
                let reason = format!("{host} cannot be reached: {e}");
                // A POST that broke off may have been heard: sending it again could make, and cost, a second job.
                let heard = !matches!(call.body, Body::None) && !never_sent(&e);
                return if heard { Attempt::Broken(reason) } else { Attempt::Later(None, reason) };
            }
        };
        let status = answer.status();
        let after = answer.headers().get("retry-after").and_then(|v| v.to_str().ok()?.parse::<f64>().ok());
        let body = answer.body_mut().with_config().limit(limit).read_to_vec();
        match body {
            Ok(body) if status.is_success() => Attempt::Answer(body),
            Err(e) if status.is_success() => {
                let reason = format!("the answer of {host} breaks off: {e}");
                if matches!(call.body, Body::None) { Attempt::Later(None, reason) } else { Attempt::Broken(reason) }
            }
            body => {
                let words = self.head(&body.unwrap_or_default(), call);
                let reason = format!("{host} answers {status}: {words}");
                match status.as_u16() {
                    429 | 500..=599 => {
                        let after = after.filter(|s| s.is_finite() && *s >= 0.0).map(|s| s.min(MAX_RETRY_AFTER_SECS));
                        Attempt::Later(after, reason)
                    }
                    401 | 403 if !self.about.keys.is_empty() => {
                        Attempt::Broken(format!("{reason}; check the key in {}", variables(self.about)))
                    }
                    _ => Attempt::No(reason),
                }
            }
        }
    }
}

/// Whether the request surely never reached the service.
fn never_sent(error: &ureq::Error) -> bool {
    let refused = |e: &std::io::Error| e.kind() == std::io::ErrorKind::ConnectionRefused;
    match error {
        ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => true,
        ureq::Error::Io(e) => refused(e),
        _ => false,
    }
}

/// The variables that may hold a provider's keys, in words.
pub(super) fn variables(about: &About) -> String {
    let each: Vec<String> = about.keys.iter().map(|k| k.variables.join(" or ")).collect();
    each.join(" and ")
}

/// The text without the keys.
pub(super) fn struck_out(text: &str, keys: &[String]) -> String {
    keys.iter().filter(|k| !k.is_empty()).fold(text.to_owned(), |t, k| t.replace(k.as_str(), STRUCK_OUT))
}

/// The text without what the request was authorised by, which may be made of a key.
fn without_token(text: &str, call: &Call) -> String {
    let token = call.authorization.as_ref().and_then(|a| a.split_once(' ')).map(|(_, token)| token.to_owned());
    struck_out(text, token.as_slice())
}

fn host_of(url: &str) -> String {
    let uri = url.parse::<Uri>().ok();
    uri.and_then(|u| u.authority().map(ToString::to_string)).unwrap_or_else(|| "the address".to_owned())
}

fn same_origin(a: &str, b: &str) -> bool {
    let origin = |url: &str| {
        let uri = url.parse::<Uri>().ok()?;
        Some((uri.scheme_str()?.to_owned(), uri.authority()?.as_str().to_lowercase()))
    };
    origin(a).is_some() && origin(a) == origin(b)
}

/// Bytes of a path or query that stand for themselves; all others are written as %XX (RFC 3986, 2.1).
pub(super) fn percent_encoded(text: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~".contains(&b);
    text.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_go_to_the_same_scheme_host_and_port_only() {
        assert!(same_origin("https://queue.fal.run/a/b", "https://queue.fal.run"));
        for other in ["https://queue.fal.run.evil.org/a", "http://queue.fal.run/a", "https://queue.fal.run:444/a", "/a"]
        {
            assert!(!same_origin(other, "https://queue.fal.run"), "{other}");
        }
    }

    #[test]
    fn a_request_is_shown_without_its_key_and_without_the_picture() {
        let call = Call::post("https://a.b/c", json!({"prompt": "jump", "image": "x".repeat(9000)}));
        let shown = call.authorized("Key verysecret".into()).shown().to_string();
        println!("{shown}");
        assert!(
            !shown.contains("verysecret") && shown.contains("Key ***") && shown.contains("jump") && shown.len() < 300
        );
    }

    #[test]
    fn a_path_is_encoded_byte_by_byte() {
        assert_eq!(percent_encoded("a b/ü?.mp4"), "a%20b%2F%C3%BC%3F.mp4");
    }
}
