use super::Command;
use crate::bar::Bar;
use crate::{Cli, Common, config, out};
use animimic::batch::{Named, News, Shard, State, Summary, batch};
use animimic::Event;
use anyhow::{Context, bail};
use clap::{CommandFactory, Parser};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

#[derive(clap::Args)]
pub struct Batch {
    /// The list: TOML with one [[job]] each (name, model, videos and options as of `animimic animate`), and [defaults] for all
    jobs_file: PathBuf,
    /// Folder for the results, one folder per job in it [default: beside the list, with its name]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Jobs at a time; each has an equal share of the threads
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Do only the job of that name; several may be given
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Do only part I of N of the jobs, dealt out in turn
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Do all anew, finished jobs too
    #[arg(long)]
    again: bool,
}

impl Batch {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let folder = self.out.clone().unwrap_or_else(|| self.jobs_file.with_extension(""));
        let all = self.read(&folder, common).with_context(|| self.jobs_file.display().to_string())?;
        let jobs = self.chosen(&all)?;
        let mut bar = Bar::new(common);
        let mut over = 0;
        let summary = batch(&jobs, self.jobs, common.threads, &mut |news| {
            if let News::Ended(_) = news {
                over += 1;
            }
            bar.on_event(shown(news, over, jobs.len()))
        })?;
        drop(bar);
        self.tell(&summary, &folder, jobs.len() == all.len(), common)
    }

    /// All jobs of the list.
    fn read(&self, folder: &Path, common: &Common) -> anyhow::Result<Vec<Named>> {
        let mut list = config::read(&self.jobs_file)?;
        let defaults = match list.remove("defaults") {
            None => Table::new(),
            Some(Value::Table(table)) => table,
            Some(_) => bail!("defaults is a table: write [defaults]"),
        };
        let jobs = match list.remove("job") {
            Some(Value::Array(jobs)) if !jobs.is_empty() => jobs,
            _ => bail!("there is no job in it: write [[job]] with name, model and videos"),
        };
        if let Some(key) = list.keys().next() {
            bail!("{key} is neither [defaults] nor [[job]]");
        }
        let base = self.jobs_file.parent().unwrap_or(Path::new(""));
        jobs.into_iter()
            .enumerate()
            .map(|(k, job)| {
                let Value::Table(job) = job else { bail!("job {} is no table: write [[job]]", k + 1) };
                let table: Table = defaults.clone().into_iter().chain(job).collect();
                self.job(table, base, folder, common).with_context(|| format!("job {}", k + 1))
            })
            .collect()
    }

    /// One job: its table is read as the command line of `animate`.
    fn job(&self, mut table: Table, base: &Path, folder: &Path, common: &Common) -> anyhow::Result<Named> {
        let name = match table.remove("name") {
            Some(Value::String(name)) if is_folder_name(&name) => name,
            Some(_) => bail!("its name is no name of a folder: use letters, digits, - and _"),
            None => bail!("it has no name"),
        };
        let own_out = table.contains_key("out");
        // Stands in for the folder that is chosen below.
        table.entry("out").or_insert_with(|| Value::String(".".into()));
        table.entry("seed").or_insert_with(|| Value::Integer(common.seed as i64));
        if let Some(key) = ["threads", "quiet", "json", "resume"].iter().find(|k| table.contains_key(**k)) {
            bail!("{name}: {key} is of the whole batch: give it on the command line");
        }
        let mut cli = Cli::command();
        cli.build();
        let animate = cli.find_subcommand("animate").context("the program has no animate")?;
        let words = config::words(animate, &table, base, None).with_context(|| name.clone())?;
        let parsed = Cli::try_parse_from(words).map_err(|e| {
            let text = e.to_string();
            anyhow::anyhow!("{name}: {}", text.lines().next().unwrap_or_default().trim_start_matches("error: "))
        })?;
        let Command::Animate(animate) = parsed.command else { bail!("{name}: it is no job of animate") };
        let mut job = animate.job(&parsed.common);
        if !own_out {
            job.out = folder.join(&name);
        }
        job.resume = !self.again;
        Ok(Named { name, job })
    }

    /// The jobs that were asked for.
    fn chosen(&self, all: &[Named]) -> anyhow::Result<Vec<Named>> {
        if let Some(name) = self.only.iter().find(|n| !all.iter().any(|j| j.name == **n)) {
            let known: Vec<&str> = all.iter().map(|j| j.name.as_str()).collect();
            bail!("{}: no job is called {name}; there are {}", self.jobs_file.display(), known.join(", "));
        }
        let meant = |(place, job): &(usize, &Named)| {
            self.shard.is_none_or(|s| s.has(*place)) && (self.only.is_empty() || self.only.contains(&job.name))
        };
        Ok(all.iter().enumerate().filter(meant).map(|(_, job)| job.clone()).collect())
    }

    /// Prints the summary, and writes it where it is of the whole list.
    fn tell(&self, summary: &Summary, folder: &Path, whole: bool, common: &Common) -> anyhow::Result<()> {
        let json = summary.to_json();
        if whole && !summary.stopped && folder.is_dir() {
            let text = serde_json::to_string_pretty(&json)? + "\n";
            let write = |w: &mut std::io::BufWriter<std::fs::File>| std::io::Write::write_all(w, text.as_bytes());
            animimic::scene::io::write_atomically(folder.join("summary.json"), write)?;
        }
        out::print(common, &json, || summary.table())?;
        if summary.stopped {
            bail!("stopped on request, and what is done is kept; the same command goes on");
        }
        let failed = summary.failed();
        if !failed.is_empty() {
            bail!("{} of {} jobs failed: {}", failed.len(), summary.rows.len(), failed.join(", "));
        }
        Ok(())
    }
}

/// A batch's news for the bar, which shows the whole batch; warnings are named after their job.
fn shown(news: &News, over: usize, of: usize) -> Event {
    match news {
        News::Told(name, Event::Warning(text)) => Event::Warning(format!("{name}: {text}")),
        News::Ended(row) if row.state == State::Failed => {
            Event::Warning(format!("{} failed: {}", row.name, row.error.as_deref().unwrap_or_default()))
        }
        _ => Event::Step { done: over as f64 / of.max(1) as f64, loss: None },
    }
}

fn is_folder_name(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || "-_.".contains(c)) && !name.starts_with('.')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mutate;

    #[test]
    fn a_list_is_found_by_its_bare_name_too() {
        let table: Table = toml::from_str("name = \"fox\"\nmodel = \"fox.glb\"\nvideos = [\"walk.mp4\"]").expect("a job");
        let common = crate::Common { json: false, quiet: true, seed: 0, threads: 1 };
        let jobs_file = PathBuf::from("jobs.toml");
        let base = jobs_file.parent().expect("a bare name has an empty folder").to_owned();
        let list = Batch { jobs_file, out: None, jobs: 1, only: Vec::new(), shard: None, again: false };
        let Named { job, .. } = list.job(table, &base, Path::new("jobs"), &common).expect("a job");
        assert_eq!((job.out, job.model), (PathBuf::from("jobs/fox"), PathBuf::from("fox.glb")));
    }

    /// Every mutation is options or an error of one line, here and where `clap` takes the words.
    #[test]
    fn mutated_files_of_options_and_lists_of_jobs_never_panic_or_hang() {
        if !mutate::in_a_small_child("commands::batch::tests::mutated_files_of_options_and_lists_of_jobs_never_panic_or_hang", 60) {
            return;
        }
        let options = "model = \"fox.glb\"\nvideos = [\"walk.mp4\", \"run.mp4\"]\nout = \"o\"\ncamera = \"preset:puppeteer\"\n\
                       clip = [\"walk\"]\nmask = \"onnx:a/u2net.onnx:u2net\"\nheight = 256\nsize-m = 1.5\nframes = \"0..9\"\nresume = true\n";
        let jobs = "[defaults]\nheight = 512\n\n[[job]]\nname = \"fox\"\nmodel = \"fox.glb\"\nvideos = [\"walk.mp4\"]\n\n\
                    [[job]]\nname = \"wolf\"\nmodel = \"wolf.glb\"\nvideos = [\"gallop.mp4\"]\n";
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a.toml");
        let mut cli = Cli::command();
        cli.build();
        let taken = |table: anyhow::Result<Table>| -> anyhow::Result<()> {
            let animate = cli.find_subcommand("animate").expect("there is one");
            let words = config::words(animate, &table?, Path::new("/jobs"), None)?;
            cli.clone().try_get_matches_from(words).map(drop).map_err(anyhow::Error::from)
        };
        mutate::hammer("options as TOML", &[options.into()], 2000, |bytes| {
            std::fs::write(&path, bytes).expect("written");
            taken(config::read(&path)).is_ok()
        });
        let common = crate::Common { json: false, quiet: true, seed: 0, threads: 1 };
        let list = Batch { jobs_file: path.clone(), out: None, jobs: 1, only: Vec::new(), shard: None, again: false };
        mutate::hammer("jobs as TOML", &[jobs.into()], 2000, |bytes| {
            std::fs::write(&path, bytes).expect("written");
            list.read(Path::new("results"), &common).is_ok()
        });
    }
}
