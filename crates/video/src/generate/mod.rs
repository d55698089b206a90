//! Still → video: the family of services and programs that make a picture move.
//!
//! A job goes submit → id → poll → video. The id is written down before the first poll, so that a run that was killed
//! asks again for the job that may already be paid. A new provider is one file here and one word in [`PROVIDERS`].
//!
//! Keys come from the environment, are sent to the service's own host alone and are struck out of every message.

mod comfyui;
mod command;
mod fal;
mod http;
mod job;
mod jwt;
mod kling;
mod replicate;
mod run;

pub use comfyui::Comfyui;
pub use command::Command;
pub use fal::Fal;
pub use http::{Body, Call, Link};
pub use job::{JobFile, job_path};
pub use kling::Kling;
pub use replicate::Replicate;
pub use run::{Generated, generate, keys_set, plan};

use crate::error::{Result, VideoError};
use serde_json::{Map, Value};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Ask {
    /// The still: a PNG or JPEG file.
    pub picture: PathBuf,
    /// What is to happen.
    pub prompt: String,
    /// The service's model; the provider's own choice where absent.
    pub model: Option<String>,
    /// The service's address; the provider's own where absent.
    pub url: Option<String>,
    /// Further members of the request, as the service's documentation names them.
    pub options: Map<String, Value>,
    /// Program and arguments of the provider `command`.
    pub command: Vec<String>,
    /// Workflow of the provider `comfyui`, in API format.
    pub workflow: Option<Value>,
}

/// An [`Ask`] with everything read and chosen.
#[derive(Debug)]
pub struct Order<'a> {
    /// What was asked for.
    pub ask: &'a Ask,
    /// The still's bytes.
    pub picture: &'a [u8],
    /// Their MIME type.
    pub mime: &'static str,
    /// The service's address, without a slash at its end.
    pub base: &'a str,
    /// The service's model.
    pub model: &'a str,
    /// The keys, in the order of [`About::keys`].
    pub keys: &'a [String],
}

impl Order<'_> {
    /// The still in base64.
    pub fn base64(&self) -> String {
        use base64::Engine;
        base64::engine::general_purpose::STANDARD.encode(self.picture)
    }

    /// The still as a data URI.
    pub fn data_uri(&self) -> String {
        format!("data:{};base64,{}", self.mime, self.base64())
    }

    /// `members` with the caller's further ones put in (and over them).
    fn with_options(&self, members: Value) -> Value {
        let Value::Object(mut body) = members else { return members };
        body.extend(self.ask.options.clone());
        Value::Object(body)
    }
}

/// A key that a provider needs.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Environment variables that may hold it, the first that is set counts.
    pub variables: &'static [&'static str],
}

/// What there is to know about a provider.
#[derive(Clone, Copy, Debug)]
pub struct About {
    /// Name, as `--provider` takes it.
    pub name: &'static str,
    /// One line on what it is.
    pub summary: &'static str,
    /// Keys that it needs.
    pub keys: &'static [Key],
    /// Its address where the caller gives none.
    pub url: &'static str,
    /// Its model where the caller names none.
    pub model: &'static str,
}

/// A job that a provider has accepted. Holds no key.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Ticket {
    /// The provider's name of the job.
    pub id: String,
    /// Addresses that the provider told to ask at, by their names in its answer.
    #[serde(default)]
    pub urls: std::collections::BTreeMap<String, String>,
}

/// Where a job stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Waits for its turn.
    Queued,
    /// Is being worked on.
    Running,
    /// The video lies at this address.
    At(String),
    /// The video itself.
    Made(Vec<u8>),
    /// Will not be done, and why.
    Failed(String),
}

/// One way to make a still move.
pub trait Provider: Sync {
    /// Name, keys, address.
    fn about(&self) -> &'static About;
    /// The request that asks for the video, as it is sent.
    ///
    /// # Errors
    /// [`VideoError::Caller`] when the order lacks something that the provider needs.
    fn request(&self, order: &Order, now_unix_secs: u64) -> Result<Call>;
    /// Asks for the video. Exactly one job is made where this succeeds.
    ///
    /// # Errors
    /// [`VideoError::Provider`] for refusals and answers that make no sense.
    fn submit(&self, order: &Order, link: &mut Link) -> Result<Ticket>;
    /// Asks where the job stands.
    ///
    /// # Errors
    /// As [`Provider::submit`].
    fn poll(&self, order: &Order, ticket: &Ticket, link: &mut Link) -> Result<State>;
}

/// All providers, in the order in which they are listed.
pub const PROVIDERS: &[&dyn Provider] = &[&Command, &Comfyui, &Fal, &Kling, &Replicate];

/// The provider of that name.
///
/// # Errors
/// [`VideoError::Caller`] naming all that there are.
pub fn provider(name: &str) -> Result<&'static dyn Provider> {
    PROVIDERS.iter().copied().find(|p| p.about().name == name).ok_or_else(|| {
        let names: Vec<&str> = PROVIDERS.iter().map(|p| p.about().name).collect();
        VideoError::Caller(format!("there is no provider {name:?}; there are {}", names.join(", ")))
    })
}

/// The world outside, which a library does not touch by itself: time, waiting, news and the environment.
pub trait Host {
    /// Seconds since 1970.
    fn unix_secs(&self) -> u64;
    /// Waits so long [s], or breaks when the user wants to stop.
    fn wait(&mut self, secs: f64) -> ControlFlow<()>;
    /// The environment variable of that name.
    fn variable(&self, name: &str) -> Option<String>;
    /// Something to show while waiting.
    fn news(&mut self, _words: &'static str) {}
}

/// How long to wait, and how often to ask.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// Pause before the second poll, and after the first refusal [s].
    pub first_secs: f64,
    /// Longest pause [s].
    pub longest_secs: f64,
    /// Time for the whole job [s].
    pub job_secs: u64,
    /// Time for one request [s].
    pub request_secs: u64,
    /// Times that one request is sent where the service is busy (429) or broken (5xx).
    pub attempts: u32,
}

impl Default for Patience {
    fn default() -> Self {
        Self { first_secs: 2.0, longest_secs: 15.0, job_secs: 1800, request_secs: 120, attempts: 5 }
    }
}

impl Patience {
    /// The pause after `n` others [s].
    pub fn pause(&self, n: u32) -> f64 {
        const GROWTH: f64 = 1.5;
        (self.first_secs * GROWTH.powi(n.min(64) as i32)).min(self.longest_secs)
    }
}

/// A member of an answer that must be text.
fn text(answer: &Value, pointer: &str, name: &'static str) -> Result<String> {
    let found = answer.pointer(pointer).and_then(Value::as_str).filter(|s| !s.is_empty());
    found.map(str::to_owned).ok_or_else(|| malformed(name, answer, pointer))
}

/// The error for an answer in which something is missing or of the wrong kind.
fn malformed(provider: &'static str, answer: &Value, pointer: &str) -> VideoError {
    VideoError::Provider { provider, reason: format!("the answer makes no sense at {pointer}: {answer}") }
}

/// The error for a picture that no provider takes, else its MIME type.
fn mime(picture: &Path, bytes: &[u8]) -> Result<&'static str> {
    match image::guess_format(bytes) {
        Ok(image::ImageFormat::Png) => Ok("image/png"),
        Ok(image::ImageFormat::Jpeg) => Ok("image/jpeg"),
        _ => Err(VideoError::invalid(picture, "the still must be a PNG or JPEG")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_provider_has_its_own_name_and_tells_what_it_needs() {
        for p in PROVIDERS {
            let about = p.about();
            assert_eq!(PROVIDERS.iter().filter(|q| q.about().name == about.name).count(), 1);
            assert!(!about.summary.is_empty() && provider(about.name).expect("found").about().name == about.name);
            for key in about.keys {
                assert!(key.variables[0].starts_with("ANIMIMIC_") && key.variables.len() > 1, "{}", about.name);
            }
        }
        assert!(provider("dream").err().expect("refused").to_string().contains("comfyui"));
    }

    #[test]
    fn pauses_grow_from_two_to_fifteen_seconds() {
        let patience = Patience::default();
        let pauses: Vec<f64> = (0..8).map(|n| patience.pause(n)).collect();
        println!("{pauses:?}");
        assert_eq!((pauses[0], pauses[7]), (2.0, 15.0));
        assert!(pauses.windows(2).all(|w| w[1] >= w[0]) && patience.pause(u32::MAX) == 15.0);
    }
}
