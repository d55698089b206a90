use super::{About, Call, Key, Link, Order, Provider, State, Ticket, http, malformed, text};
use crate::error::Result;
use serde_json::{Value, json};

/// The queue of fal.ai: <https://docs.fal.ai/model-apis/model-endpoints/queue>.
pub struct Fal;

const ABOUT: About = About {
    name: "fal",
    summary: "fal.ai: many models by name (--model fal-ai/…/image-to-video)",
    keys: &[Key { variables: &["ANIMIMIC_FAL_KEY", "FAL_KEY"] }],
    url: "https://queue.fal.run",
    model: "fal-ai/kling-video/v2.1/standard/image-to-video",
};

fn authorization(order: &Order) -> String {
    format!("Key {}", order.keys[0])
}

impl Provider for Fal {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn request(&self, order: &Order, _now_unix_secs: u64) -> Result<Call> {
        let body = order.with_options(json!({"prompt": order.ask.prompt, "image_url": order.data_uri()}));
        Ok(Call::post(format!("{}/{}", order.base, order.model), body).authorized(authorization(order)))
    }

    fn submit(&self, order: &Order, link: &mut Link) -> Result<Ticket> {
        let answer = link.send(&self.request(order, link.now())?)?;
        let member = |name: &str| text(&answer, &format!("/{name}"), ABOUT.name);
        // The addresses drop the model's sub-path, so they are taken as told and not made up.
        let urls = ["status_url", "response_url"].into_iter().map(|n| Ok((n.to_owned(), member(n)?)));
        Ok(Ticket { id: member("request_id")?, urls: urls.collect::<Result<_>>()? })
    }

    fn poll(&self, order: &Order, ticket: &Ticket, link: &mut Link) -> Result<State> {
        let at = |name: &str| {
            let url = ticket.urls.get(name).cloned();
            url.unwrap_or_else(|| format!("{}/requests/{}", order.base, http::percent_encoded(&ticket.id)))
        };
        let status = link.send(&Call::get(at("status_url")).authorized(authorization(order)))?;
        match text(&status, "/status", ABOUT.name)?.as_str() {
            "IN_QUEUE" => Ok(State::Queued),
            "IN_PROGRESS" => Ok(State::Running),
            "COMPLETED" => {
                if let Some(why) = status.get("error").and_then(Value::as_str) {
                    return Ok(State::Failed(why.to_owned()));
                }
                match link.ask(&Call::get(at("response_url")).authorized(authorization(order)))? {
                    Ok(answer) => Ok(State::At(text(&answer, "/video/url", ABOUT.name)?)),
                    Err(no) => Ok(State::Failed(no)),
                }
            }
            "FAILED" | "ERROR" | "CANCELLED" => Ok(State::Failed(status.to_string())),
            _ => Err(malformed(ABOUT.name, &status, "/status")),
        }
    }
}
