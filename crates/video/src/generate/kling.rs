use super::{About, Call, Key, Link, Order, Provider, State, Ticket, http, jwt, malformed, text};
use crate::error::Result;
use serde_json::{Value, json};

/// Kling's own service: <https://app.klingai.com/global/dev/document-api/apiReference/model/imageToVideo>.
pub struct Kling;

const ABOUT: About = About {
    name: "kling",
    summary: "Kling's own service (--option duration=5|10, mode=std|pro)",
    keys: &[
        Key { variables: &["ANIMIMIC_KLING_ACCESS_KEY", "KLING_ACCESS_KEY"] },
        Key { variables: &["ANIMIMIC_KLING_SECRET_KEY", "KLING_SECRET_KEY"] },
    ],
    url: "https://api-singapore.klingai.com",
    model: "kling-v2-1",
};

/// How long a token holds [s], as the service's documentation has it.
const TOKEN_SECS: u64 = 1800;
/// How far the service's clock may be behind ours [s].
const CLOCK_SLACK_SECS: u64 = 5;

fn authorization(order: &Order, now_unix_secs: u64) -> String {
    let (from, until) = (now_unix_secs.saturating_sub(CLOCK_SLACK_SECS), now_unix_secs + TOKEN_SECS);
    let claims = json!({"iss": order.keys[0], "exp": until, "nbf": from});
    format!("Bearer {}", jwt::hs256(&claims, order.keys[1].as_bytes()))
}

fn address(order: &Order) -> String {
    format!("{}/v1/videos/image2video", order.base)
}

/// The answer's `data`; Kling reports errors as a code in an answer that HTTP calls a success.
fn data(answer: Value, link: &Link) -> Result<Value> {
    if answer.get("code").and_then(Value::as_i64) == Some(0) && answer.get("data").is_some() {
        return Ok(answer["data"].clone());
    }
    match answer.get("message").and_then(Value::as_str) {
        Some(words) => Err(link.error(format!("refused with code {}: {words}", answer["code"]))),
        None => Err(malformed(ABOUT.name, &answer, "/data")),
    }
}

impl Provider for Kling {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn request(&self, order: &Order, now_unix_secs: u64) -> Result<Call> {
        let body = json!({
            "model_name": order.model, "image": order.base64(), "prompt": order.ask.prompt, "duration": "5", "mode": "std",
        });
        Ok(Call::post(address(order), order.with_options(body)).authorized(authorization(order, now_unix_secs)))
    }

    fn submit(&self, order: &Order, link: &mut Link) -> Result<Ticket> {
        let answer = link.send(&self.request(order, link.now())?)?;
        let data = data(answer, link)?;
        Ok(Ticket { id: text(&data, "/task_id", ABOUT.name)?, ..Ticket::default() })
    }

    fn poll(&self, order: &Order, ticket: &Ticket, link: &mut Link) -> Result<State> {
        let url = format!("{}/{}", address(order), http::percent_encoded(&ticket.id));
        let answer = link.send(&Call::get(url).authorized(authorization(order, link.now())))?;
        let data = data(answer, link)?;
        match text(&data, "/task_status", ABOUT.name)?.as_str() {
            "submitted" => Ok(State::Queued),
            "processing" => Ok(State::Running),
            "succeed" => Ok(State::At(text(&data, "/task_result/videos/0/url", ABOUT.name)?)),
            "failed" => {
                let why = data.get("task_status_msg").and_then(Value::as_str).unwrap_or("no reason given");
                Ok(State::Failed(why.to_owned()))
            }
            _ => Err(malformed(ABOUT.name, &data, "/task_status")),
        }
    }
}
