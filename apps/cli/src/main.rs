//! `animimic`: the command line. Words for people; everything else is in the library.

mod bar;
mod commands;
mod config;
#[cfg(test)]
#[path = "../../../crates/scene/tests/common/mutate.rs"]
mod mutate;
mod out;

use anyhow::Context;
use clap::{CommandFactory, Parser};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Animate a still, textured 3D model from a short video of it moving.
#[derive(Parser)]
#[command(version, max_term_width = 100, subcommand_required = true, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: commands::Command,
    #[command(flatten)]
    common: Common,
}

/// Options of every command.
#[derive(clap::Args, Clone, Debug)]
pub struct Common {
    /// Print the result as JSON on standard output
    #[arg(long, global = true)]
    json: bool,
    /// Show no progress and no warnings
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Seed of everything random; equal seeds give equal bytes
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Number of threads; 0 takes all processors. Does not change the result
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Exit codes: 0 done, 1 failed, 2 wrong usage.
fn main() -> ExitCode {
    let arguments = match with_config(std::env::args_os().collect()) {
        Ok(arguments) => arguments,
        Err(e) => return failed(&e),
    };
    let cli = Cli::try_parse_from(arguments).unwrap_or_else(|e| e.exit());
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => failed(&e),
    }
}

fn failed(error: &anyhow::Error) -> ExitCode {
    eprintln!("animimic: {}", one_sentence(error));
    ExitCode::FAILURE
}

/// The command line with what the file of `--config` adds to it; what stands on the line itself counts.
fn with_config(arguments: Vec<OsString>) -> anyhow::Result<Vec<OsString>> {
    let asked = |a: &OsString| a.to_string_lossy().split('=').next() == Some("--config");
    if !arguments.iter().any(asked) {
        return Ok(arguments);
    }
    let mut whole = Cli::command();
    whole.build();
    let name = "animate";
    let lenient = Cli::command().mut_subcommand(name, |c| c.mut_args(|a| a.required(false)));
    // Wrong usage is told by the parser that reads the whole line.
    let Ok(matches) = lenient.try_get_matches_from(&arguments) else { return Ok(arguments) };
    let Some((command, given)) = matches.subcommand().filter(|s| s.0 == name) else { return Ok(arguments) };
    let (Some(file), Some(command)) = (given.get_one::<PathBuf>("config"), whole.find_subcommand(command)) else {
        return Ok(arguments);
    };
    let folder = file.parent().unwrap_or(Path::new(""));
    let table = config::read(file)?;
    config::words(command, &table, folder, Some(given)).with_context(|| file.display().to_string())
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(cli.common.threads).build_global()?;
    bar::catch_interrupts()?;
    cli.command.run(&cli.common)
}

/// The error and its causes on one line, no cause repeated.
fn one_sentence(error: &anyhow::Error) -> String {
    let mut out = String::new();
    for cause in error.chain().map(|c| c.to_string().replace('\n', " ")) {
        if !out.contains(&cause) {
            if !out.is_empty() {
                out += ": ";
            }
            out += &cause;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_option_of_a_command_has_its_own_help_line() {
        for command in Cli::command().get_subcommands_mut() {
            let name = command.get_name().to_owned();
            assert!(command.get_about().is_some(), "{name} does not say what it does");
            let mut seen = BTreeMap::new();
            for argument in command.get_arguments().filter(|a| !matches!(a.get_id().as_str(), "help" | "version")) {
                let help = argument.get_help().unwrap_or_else(|| panic!("{name} {} has no help", argument.get_id()));
                if let Some(other) = seen.insert(help.to_string(), argument.get_id().to_string()) {
                    panic!("{name}: {other} and {} have the same help", argument.get_id());
                }
            }
            assert!(!seen.is_empty() || ["help", "doctor"].contains(&name.as_str()), "{name} takes nothing");
        }
    }

    #[test]
    fn an_error_and_its_causes_become_one_line() {
        let e = anyhow::anyhow!("disk\nfull").context("out.glb: disk full").context("writing");
        assert_eq!(one_sentence(&e), "writing: out.glb: disk full");
    }
}
