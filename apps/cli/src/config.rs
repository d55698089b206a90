//! Options from TOML files: every key is an option of the command line, by the same name.
//!
//! A table is turned into the words of a command line and read by the command itself, so that a file and a command line cannot
//! drift apart: `height = 256` is `--height 256`, a list repeats its option, `true` is the bare option. What `clap` knows of an
//! option tells which values are paths: those are taken from the file's own folder.

use animimic::cues::SCHEME;
use anyhow::{Context, bail};
use clap::builder::ValueHint;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use std::ffi::OsString;
use std::path::Path;
use toml::{Table, Value};

/// Largest file that is read [bytes].
const MAX_BYTES: u64 = 16 << 20;

/// Reads a TOML file.
pub fn read(path: &Path) -> anyhow::Result<Table> {
    let shown = path.display().to_string();
    let size = std::fs::metadata(path).with_context(|| shown.clone())?.len();
    if size > MAX_BYTES {
        bail!("{shown}: {size} bytes are no file of options");
    }
    let text = std::fs::read_to_string(path).with_context(|| shown.clone())?;
    text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map(|s| 1 + text[..s.start.min(text.len())].matches('\n').count());
        let place = line.map_or_else(String::new, |l| format!(" line {l}:"));
        anyhow::anyhow!("{shown}:{place} {}", e.message())
    })
}

/// The words of a command line `program command …` that says what a table says, after what `given` had on its own command line.
///
/// `command` is a built subcommand; keys of the table that are none of its options are an error.
pub fn words(
    command: &Command,
    table: &Table,
    folder: &Path,
    given: Option<&ArgMatches>,
) -> anyhow::Result<Vec<OsString>> {
    let options: Vec<&Arg> = command.get_arguments().filter(|a| !is_about_itself(a)).collect();
    if let Some(key) = table.keys().find(|k| !options.iter().any(|a| name(a) == *k)) {
        let known: Vec<&str> = options.iter().map(|a| name(a)).collect();
        bail!("{key} is no option of {}; there are {}", command.get_name(), known.join(", "));
    }
    let mut words = vec![OsString::from("animimic"), command.get_name().into()];
    let mut positional = Vec::new();
    for option in options {
        let key = name(option);
        let on_line = given.filter(|g| g.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine));
        let is_flag = !option.get_action().takes_values();
        let values: Vec<OsString> = match (on_line, table.get(key)) {
            (Some(_), _) if is_flag => vec![OsString::new()],
            (Some(given), _) => given.get_raw(option.get_id().as_str()).into_iter().flatten().map(Into::into).collect(),
            (None, Some(Value::Boolean(set))) if is_flag => vec![OsString::new(); usize::from(*set)],
            (None, Some(_)) if is_flag => bail!("{key}: write true or false"),
            (None, Some(value)) => texts(option, value, folder)?,
            (None, None) => Vec::new(),
        };
        for value in values {
            if option.is_positional() {
                positional.push(value);
            } else {
                words.push(format!("--{key}").into());
                if !is_flag {
                    // As one word: a value may begin with a dash.
                    let option = words.last_mut().expect("just pushed");
                    option.push("=");
                    option.push(value);
                }
            }
        }
    }
    words.push("--".into());
    words.extend(positional);
    Ok(words)
}

/// Options about the command line itself.
fn is_about_itself(option: &Arg) -> bool {
    matches!(option.get_id().as_str(), "help" | "version" | "config")
        || matches!(option.get_action(), ArgAction::Help | ArgAction::Version)
}

/// The key of an option: its long name, or what it is called in the usage.
fn name(option: &Arg) -> &str {
    option.get_long().unwrap_or(option.get_id().as_str())
}

/// A value as text; a list gives several.
fn texts(option: &Arg, value: &Value, folder: &Path) -> anyhow::Result<Vec<OsString>> {
    let key = name(option);
    Ok(match value {
        Value::String(text) if is_path(option, text) => vec![in_folder(folder, text)],
        Value::String(text) => vec![text.into()],
        Value::Integer(number) => vec![number.to_string().into()],
        Value::Float(number) => vec![number.to_string().into()],
        Value::Array(_) if !matches!(option.get_action(), ArgAction::Append) => {
            bail!("{key} takes one value, not a list")
        }
        Value::Array(values) if values.iter().any(Value::is_array) => bail!("{key}: a list in a list"),
        Value::Array(values) => {
            values.iter().map(|v| texts(option, v, folder)).collect::<anyhow::Result<Vec<_>>>()?.concat()
        }
        other => bail!("{key}: a {} is no value of an option", other.type_str()),
    })
}

/// A path from the folder of the file that names it; `onnx:` before a path stays before it.
fn in_folder(folder: &Path, text: &str) -> OsString {
    let (kind, path) = text.split_at(text.strip_prefix(SCHEME).map_or(0, |_| SCHEME.len()));
    let mut out = OsString::from(kind);
    out.push(folder.join(path));
    out
}

/// Whether a value is a path: the option takes paths and the text is none of the words that its help names beside them
/// (`auto|keep|FILE`, `preset:NAME`).
fn is_path(option: &Arg, text: &str) -> bool {
    let takes_paths = !matches!(option.get_value_hint(), ValueHint::Unknown | ValueHint::Other);
    let help = option.get_value_names().into_iter().flatten().map(|n| n.as_str());
    let word = |w: &str| match w.split_once(':') {
        Some((kind, _)) => !w.starts_with(SCHEME) && text.split_once(':').is_some_and(|t| t.0 == kind),
        None => w == text,
    };
    takes_paths && !help.flat_map(|n| n.split('|')).any(word)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cli;
    use clap::CommandFactory;

    /// The words of `animate` for a table in the folder `/jobs`.
    fn of(text: &str) -> Result<Vec<String>, String> {
        let mut cli = Cli::command();
        cli.build();
        let animate = cli.find_subcommand("animate").expect("there is one");
        let table: Table = text.parse().expect("TOML");
        let words = words(animate, &table, Path::new("/jobs"), None).map_err(|e| e.to_string())?;
        Ok(words.into_iter().skip(2).map(|w| w.into_string().expect("text")).collect())
    }

    #[test]
    fn keys_are_options_lists_repeat_them_and_paths_are_the_files_own() {
        let words = of(r#"
            model = "fox.glb"
            videos = ["walk.mp4", "/films/run.mp4"]
            out = "results"
            camera = "fox.json"
            mask = ["masks", "onnx:nets/u2net.onnx:u2net"]
            rig = "auto"
            clip = ["walk", "-run-"]
            height = 256
            frames = "0..9"
            resume = true
        "#);
        let words = words.expect("options");
        for word in [
            "--camera=/jobs/fox.json",
            "--mask=/jobs/masks",
            "--mask=onnx:/jobs/nets/u2net.onnx:u2net",
            "--rig=auto",
            "--clip=walk",
            "--clip=-run-",
            "--height=256",
            "--frames=0..9",
            "--resume",
            "--out=/jobs/results",
        ] {
            assert!(words.contains(&word.to_owned()), "{word} is not in {words:?}");
        }
        assert_eq!(words[words.len() - 4..], ["--", "/jobs/fox.glb", "/jobs/walk.mp4", "/films/run.mp4"]);
        assert!(
            of("camera = \"preset:puppeteer\"").expect("options").contains(&"--camera=preset:puppeteer".to_owned())
        );
        assert!(!of("resume = false").expect("options").contains(&"--resume".to_owned()));
    }

    #[test]
    fn what_is_no_option_or_no_value_of_one_is_told() {
        for (text, told) in [
            ("hight = 3", "hight is no option of animate"),
            ("config = \"a.toml\"", "config is no option"),
            ("height = [1, 2]", "takes one value"),
            ("clip = [[1]]", "a list in a list"),
            ("clip = { a = 1 }", "a table is no value"),
            ("resume = 3", "true or false"),
        ] {
            let error = of(text).expect_err(text);
            assert!(error.contains(told), "{error}");
        }
    }
}
