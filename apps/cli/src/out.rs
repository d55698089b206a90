//! Results on standard output, for people or for machines.

use crate::Common;
use serde_json::Value;
use std::io::Write;

/// Prints JSON if it was asked for, else what `text` gives. A closed pipe is no error.
pub fn print(common: &Common, json: &Value, text: impl FnOnce() -> String) -> anyhow::Result<()> {
    let body = if common.json { serde_json::to_string(json)? } else { text() };
    match writeln!(std::io::stdout(), "{}", body.trim_end_matches('\n')) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e.into()),
        _ => Ok(()),
    }
}

/// Members of a flat object as aligned lines.
pub fn lines(object: &Value) -> String {
    let mut out = String::new();
    for (key, value) in object.as_object().into_iter().flatten() {
        match value {
            Value::Number(n) if !n.is_u64() => out += &format!("{key:28} {:.4}\n", n.as_f64().unwrap_or(f64::NAN)),
            Value::Object(inner) => {
                for (name, why) in inner {
                    out += &format!("{name:28} not available: {}\n", why.as_str().unwrap_or_default());
                }
            }
            Value::String(s) => out += &format!("{key:28} {s}\n"),
            Value::Array(list) if list.iter().all(Value::is_string) => {
                list.iter().for_each(|s| out += &format!("{key:28} {}\n", s.as_str().unwrap_or_default()));
            }
            other => out += &format!("{key:28} {other}\n"),
        }
    }
    out
}
