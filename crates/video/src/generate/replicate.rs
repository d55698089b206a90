use super::{About, Call, Key, Link, Order, Provider, State, Ticket, http, malformed, text};
use crate::error::Result;
use serde_json::{Value, json};

/// Replicate: <https://replicate.com/docs/reference/http>.
pub struct Replicate;

const ABOUT: About = About {
    name: "replicate",
    summary: "Replicate: many models by name (--model owner/name or owner/name:version)",
    keys: &[Key { variables: &["ANIMIMIC_REPLICATE_API_TOKEN", "REPLICATE_API_TOKEN"] }],
    url: "https://api.replicate.com",
    model: "wan-video/wan-2.2-i2v-fast",
};

fn authorization(order: &Order) -> String {
    format!("Bearer {}", order.keys[0])
}

impl Provider for Replicate {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn request(&self, order: &Order, _now_unix_secs: u64) -> Result<Call> {
        let input = order.with_options(json!({"prompt": order.ask.prompt, "image": order.data_uri()}));
        let (url, body) = match order.model.split_once(':') {
            Some((_, version)) => {
                (format!("{}/v1/predictions", order.base), json!({"version": version, "input": input}))
            }
            None => (format!("{}/v1/models/{}/predictions", order.base, order.model), json!({"input": input})),
        };
        Ok(Call::post(url, body).authorized(authorization(order)))
    }

    fn submit(&self, order: &Order, link: &mut Link) -> Result<Ticket> {
        let answer = link.send(&self.request(order, link.now())?)?;
        let get = text(&answer, "/urls/get", ABOUT.name)?;
        Ok(Ticket { id: text(&answer, "/id", ABOUT.name)?, urls: [("get".to_owned(), get)].into() })
    }

    fn poll(&self, order: &Order, ticket: &Ticket, link: &mut Link) -> Result<State> {
        let made_up = || format!("{}/v1/predictions/{}", order.base, http::percent_encoded(&ticket.id));
        let url = ticket.urls.get("get").cloned().unwrap_or_else(made_up);
        let answer = link.send(&Call::get(url).authorized(authorization(order)))?;
        match text(&answer, "/status", ABOUT.name)?.as_str() {
            "starting" | "queued" => Ok(State::Queued),
            "processing" => Ok(State::Running),
            "succeeded" => {
                let whole = text(&answer, "/output", ABOUT.name);
                Ok(State::At(whole.or_else(|_| text(&answer, "/output/0", ABOUT.name))?))
            }
            end @ ("failed" | "canceled" | "aborted") => {
                let why = answer.get("error").and_then(Value::as_str).unwrap_or("no reason given");
                Ok(State::Failed(format!("{end}: {why}")))
            }
            _ => Err(malformed(ABOUT.name, &answer, "/status")),
        }
    }
}
