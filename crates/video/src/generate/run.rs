//! A job from the still to the video on disk.

use super::http::{struck_out, variables};
use super::job::{JobFile, job_path};
use super::{About, Ask, Host, Key, Link, Order, Patience, Provider, State, mime};
use crate::error::{Result, VideoError};
use crate::read::{ReadOptions, read};
use crate::write::{write_mp4, write_whole};
use animimic_scene::Video;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::path::Path;

/// What came of a job.
#[derive(Clone, Debug)]
pub struct Generated {
    /// The provider's name of the job.
    pub id: String,
    /// Whether an earlier run had asked for it.
    pub resumed: bool,
    /// Frames of the video.
    pub frames: usize,
    /// Frame rate \[1/s\].
    pub fps: f64,
    /// Width and height [px].
    pub size: (usize, usize),
}

/// The key, from the first variable that is set.
fn key_of(key: &Key, host: &dyn Host) -> Option<(&'static str, String)> {
    let set = |name: &&'static str| host.variable(name).map(|v| (*name, v.trim().to_owned()));
    key.variables.iter().filter_map(set).find(|(_, value)| !value.is_empty())
}

/// Names of the variables that hold the provider's keys; `None` where one is not set.
pub fn keys_set(about: &About, host: &dyn Host) -> Option<Vec<&'static str>> {
    about.keys.iter().map(|k| key_of(k, host).map(|(name, _)| name)).collect()
}

/// Everything that an [`Order`] borrows.
struct Prepared {
    picture: Vec<u8>,
    mime: &'static str,
    base: String,
    model: String,
    keys: Vec<String>,
}

impl Prepared {
    fn new(provider: &dyn Provider, ask: &Ask, keys: Vec<String>) -> Result<Self> {
        let about = provider.about();
        let picture = std::fs::read(&ask.picture).map_err(VideoError::io(&ask.picture))?;
        let mime = mime(&ask.picture, &picture)?;
        if ask.prompt.trim().is_empty() {
            return Err(VideoError::Caller("the prompt is empty: say what is to happen".into()));
        }
        let base = ask.url.as_deref().unwrap_or(about.url).trim_end_matches('/').to_owned();
        let web = base.starts_with("https://") || base.starts_with("http://");
        if (!web && !about.url.is_empty()) || base.contains('@') {
            let reason = "must begin with https:// or http:// and hold no password";
            return Err(VideoError::Caller(format!("the address of {} {reason}", about.name)));
        }
        let model = ask.model.clone().unwrap_or_else(|| about.model.to_owned());
        Ok(Self { picture, mime, base, model, keys })
    }

    fn order<'a>(&'a self, ask: &'a Ask) -> Order<'a> {
        Order { ask, picture: &self.picture, mime: self.mime, base: &self.base, model: &self.model, keys: &self.keys }
    }

    /// What makes two jobs the same.
    fn hash(&self, about: &About, ask: &Ask) -> String {
        let words =
            serde_json::json!([about.name, self.base, self.model, ask.prompt, ask.options, ask.command, ask.workflow]);
        let mut hash = Sha256::new();
        hash.update(words.to_string());
        hash.update([0]);
        hash.update(&self.picture);
        hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
    }
}

fn keys(about: &'static About, host: &dyn Host) -> Result<Vec<String>> {
    let found: Option<Vec<String>> = about.keys.iter().map(|k| key_of(k, host).map(|(_, value)| value)).collect();
    found.ok_or_else(|| {
        let reason = format!("no key; set {} in the environment", variables(about));
        VideoError::Provider { provider: about.name, reason }
    })
}

/// The request as it would be sent, without keys and without sending it. Needs no key.
///
/// # Errors
/// As [`generate`], as far as nothing was sent.
pub fn plan(provider: &dyn Provider, ask: &Ask, host: &dyn Host) -> Result<Value> {
    let about = provider.about();
    let unset = about.keys.iter().map(|_| "unset".to_owned()).collect();
    let prepared = Prepared::new(provider, ask, keys(about, host).unwrap_or(unset))?;
    Ok(provider.request(&prepared.order(ask), host.unix_secs())?.shown())
}

/// Asks the provider for a video of the still and writes it as `out`, an MP4.
///
/// The job is remembered in `NAME.job.json` beside it before it is asked after: called again with the same order, after
/// whatever end, it asks for that job and makes no new one; a video that is there already is left as it is.
/// `again` forgets what was remembered, and replaces a video of another order; else that is refused.
///
/// # Errors
/// A missing key, a refusal, a failure or an answer that makes no sense ([`VideoError::Provider`]); a job of another order
/// that is still open ([`VideoError::Caller`]); time is up or the user stops, with the job kept; a result that is no video.
pub fn generate(
    provider: &dyn Provider,
    ask: &Ask,
    out: &Path,
    again: bool,
    patience: &Patience,
    host: &mut dyn Host,
) -> Result<Generated> {
    let about = provider.about();
    if out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("mp4")) {
        return Err(VideoError::Caller(format!("{}: the video is an MP4: name a .mp4 file", out.display())));
    }
    let prepared = Prepared::new(provider, ask, keys(about, host)?)?;
    let order = prepared.order(ask);
    let asked = prepared.hash(about, ask);
    let earlier = if again { None } else { open_job(out, &asked)? };
    if earlier.as_ref().is_some_and(|job| job.done) && out.exists() {
        let video = read(out, &ReadOptions::default())?;
        return Ok(generated(&earlier.expect("just seen").ticket.id, true, &video));
    }
    if !again && earlier.is_none() && out.exists() {
        return Err(VideoError::Caller(format!(
            "{}: is there already, and is not what this asks for: name another file, or replace it with --again",
            out.display()
        )));
    }
    let start = host.unix_secs();
    let mut link = Link::new(about, &prepared.base, &prepared.keys, patience, host);
    let resumed = earlier.is_some();
    let job = match earlier {
        Some(job) => job,
        None => {
            link.host.news("asking for a video");
            let ticket = provider.submit(&order, &mut link).map_err(|e| clean(e, &prepared.keys))?;
            let (prompt, model) = (ask.prompt.clone(), prepared.model.clone());
            let job = JobFile { provider: about.name.into(), asked, prompt, model, ticket, done: false };
            let text = serde_json::to_string(&job).expect("text and flags become JSON");
            if struck_out(&text, &prepared.keys) != text {
                return Err(link.error("the answer repeats the key, which is not written down"));
            }
            job.write(out)?;
            job
        }
    };
    let bytes = wait_for(provider, &order, &job, out, start, &mut link).map_err(|e| clean(e, &prepared.keys))?;
    let video = store(&bytes, out, about.name)?;
    let id = job.ticket.id.clone();
    JobFile { done: true, ..job }.write(out)?;
    Ok(generated(&id, resumed, &video))
}

fn generated(id: &str, resumed: bool, video: &Video) -> Generated {
    Generated { id: id.into(), resumed, frames: video.frames.len(), fps: video.fps, size: video.native_size }
}

/// The remembered job, if it is the one that is asked for.
fn open_job(out: &Path, asked: &str) -> Result<Option<JobFile>> {
    let Some(job) = JobFile::read(out)? else { return Ok(None) };
    if job.asked == asked {
        return Ok(Some(job));
    }
    // A program that did not finish left nothing to fetch.
    if job.done || job.provider == super::Command.about().name {
        return Ok(None);
    }
    Err(VideoError::Caller(format!(
        "{} remembers job {} of {} for another request; repeat that request to fetch its video, or ask anew with --again",
        job_path(out).display(),
        job.ticket.id,
        job.provider
    )))
}

/// An error of a provider on one line without keys, cut where the service is wordy. Keys go first, or half of one could be left.
fn clean(error: VideoError, keys: &[String]) -> VideoError {
    const LONGEST: usize = 400;
    match error {
        VideoError::Provider { provider, reason } => {
            let words = struck_out(&reason, keys).split_whitespace().collect::<Vec<_>>().join(" ");
            VideoError::Provider { provider, reason: words.chars().take(LONGEST).collect() }
        }
        other => other,
    }
}

fn wait_for(
    provider: &dyn Provider,
    order: &Order,
    job: &JobFile,
    out: &Path,
    start: u64,
    link: &mut Link,
) -> Result<Vec<u8>> {
    let id = &job.ticket.id;
    for n in 0.. {
        match provider.poll(order, &job.ticket, link)? {
            State::At(url) => {
                link.host.news("fetching the video");
                return link.download(&url);
            }
            State::Made(bytes) => return Ok(bytes),
            State::Failed(why) => {
                JobFile::remove(out)?;
                return Err(link.error(format!("job {id} failed: {why}")));
            }
            State::Queued => link.host.news("waiting in the queue"),
            State::Running => link.host.news("the video is being made"),
        }
        if link.now().saturating_sub(start) >= link.patience().job_secs {
            let limit = link.patience().job_secs;
            return Err(
                link.error(format!("job {id} is not done after {limit} s; run the same command again to go on"))
            );
        }
        link.wait(link.patience().pause(n))?;
    }
    unreachable!("the loop ends by returning")
}

/// Checks that the bytes are a video, then writes them; other kinds than MP4 are encoded anew.
fn store(bytes: &[u8], out: &Path, provider: &'static str) -> Result<Video> {
    let folder = tempfile::tempdir().map_err(VideoError::io(std::env::temp_dir()))?;
    let path = folder.path().join("result.mp4");
    std::fs::write(&path, bytes).map_err(VideoError::io(&path))?;
    let options = ReadOptions { max_fps: 120.0, ..ReadOptions::default() };
    let video = read(&path, &options).map_err(|e| {
        let said = e.to_string();
        let reason = said.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&said).to_owned();
        VideoError::Provider { provider, reason: format!("the result cannot be used: {reason}") }
    })?;
    if bytes.get(4..8) == Some(b"ftyp") {
        write_whole(out, bytes)?;
    } else {
        write_mp4(out, &mut video.frames.iter().cloned(), video.fps)?;
    }
    Ok(video)
}
