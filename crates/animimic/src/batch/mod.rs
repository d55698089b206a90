//! Many jobs: independent of each other, several at a time, and none done twice.
//!
//! Every job is an [`crate::animate()`] into a folder of its own, resumed: what finished before with the same inputs and options is
//! kept as it is. So a batch may be killed and started again, and shared out between machines by any engine that runs commands.

mod summary;

pub use summary::{Row, State, Summary};

use crate::animate::animated;
use crate::{Error, Event, Job};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::Instant;

/// A job with its name.
#[derive(Clone, Debug)]
pub struct Named {
    /// Its name in the summary, no other job's.
    pub name: String,
    /// The job.
    pub job: Job,
}

/// What a batch tells while it runs.
#[derive(Clone, Debug)]
pub enum News {
    /// A job begins.
    Began(String),
    /// A job tells something.
    Told(String, Event),
    /// A job is over.
    Ended(Row),
}

/// Which jobs of a list are meant: part `part` of `parts`, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    part: usize,
    parts: usize,
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        match numbers {
            Some((part, parts)) if (1..=parts).contains(&part) => Ok(Self { part, parts }),
            _ => Err("write I/N with I from 1 to N, for example 2/4".into()),
        }
    }
}

impl Shard {
    /// Whether the job at a place in the list, counted from 0, is of this part: jobs are dealt out in turn.
    pub fn has(&self, place: usize) -> bool {
        place % self.parts == self.part - 1
    }
}

/// Does all jobs, `at_once` at a time with an equal share of `threads` each (0: of all processors). A job that fails is told in the
/// summary and stops no other; `news` may ask all to stop, and each keeps what it has done.
///
/// # Errors
/// Two jobs of one name or folder; no threads to be had.
pub fn batch(
    jobs: &[Named],
    at_once: usize,
    threads: usize,
    news: &mut dyn FnMut(&News) -> ControlFlow<()>,
) -> Result<Summary, Error> {
    check(jobs)?;
    let at_once = at_once.clamp(1, jobs.len().max(1));
    let all = if threads == 0 { std::thread::available_parallelism().map_or(1, usize::from) } else { threads };
    let pool = || rayon::ThreadPoolBuilder::new().num_threads((all / at_once).max(1)).build();
    let pools: Vec<rayon::ThreadPool> = (0..at_once)
        .map(|_| pool())
        .collect::<Result<_, _>>()
        .map_err(|e| Error::Input(format!("no threads to work with: {e}; lower --jobs")))?;
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let (tell, told) = channel();
    let mut rows = Vec::new();
    std::thread::scope(|scope| {
        for pool in &pools {
            let (tell, next, stop) = (tell.clone(), &next, &stop);
            scope.spawn(move || {
                while let Some(named) = jobs.get(next.fetch_add(1, Ordering::SeqCst)) {
                    if !stop.load(Ordering::SeqCst) {
                        let row = pool.install(|| one(named, &tell, stop));
                        // The other end lives until all are done.
                        let _ = tell.send(News::Ended(row));
                    }
                }
            });
        }
        drop(tell);
        for piece in told {
            if news(&piece).is_break() {
                stop.store(true, Ordering::SeqCst);
            }
            if let News::Ended(row) = piece {
                rows.push(row);
            }
        }
    });
    let place = |row: &Row| jobs.iter().position(|j| j.name == row.name);
    rows.sort_by_key(place);
    Ok(Summary { rows, stopped: stop.load(Ordering::SeqCst) })
}

fn check(jobs: &[Named]) -> Result<(), Error> {
    for (k, a) in jobs.iter().enumerate() {
        if let Some(b) = jobs[..k].iter().find(|b| b.name == a.name) {
            return Err(Error::Input(format!("two jobs are called {}: give each a name of its own", b.name)));
        }
        if let Some(b) = jobs[..k].iter().find(|b| b.job.out == a.job.out) {
            let out = a.job.out.display();
            return Err(Error::Input(format!(
                "jobs {} and {} both write to {out}: give each a folder",
                b.name, a.name
            )));
        }
    }
    Ok(())
}

/// Does one job, whatever becomes of it.
fn one(named: &Named, tell: &Sender<News>, stop: &AtomicBool) -> Row {
    let start = Instant::now();
    let send = |news: News| {
        // The other end lives until all are done.
        let _ = tell.send(news);
    };
    send(News::Began(named.name.clone()));
    let mut progress = |event: Event| {
        send(News::Told(named.name.clone(), event));
        if stop.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let ended = catch_unwind(AssertUnwindSafe(|| animated(&named.job, &mut progress)));
    let broken = || Error::Input("the program broke: this is a fault of its own, please report it".into());
    Row::new(named, ended.unwrap_or_else(|_| Err(broken())), start.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str, out: &str) -> Named {
        Named { name: name.into(), job: Job::new("nowhere.glb", vec!["nowhere.mp4".into()], out) }
    }

    #[test]
    fn shards_share_out_every_job_once() {
        let shards: Vec<Shard> = (1..=3).map(|i| format!("{i}/3").parse().expect("a shard")).collect();
        for place in 0..10 {
            assert_eq!(shards.iter().filter(|s| s.has(place)).count(), 1, "job {place}");
        }
        for bad in ["0/3", "4/3", "1", "a/b", "1/0"] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
    }

    #[test]
    fn failures_stop_no_other_job_and_are_told_in_the_order_of_the_list() {
        let folder = tempfile::tempdir().expect("made");
        let jobs: Vec<Named> =
            (0..5).map(|k| named(&k.to_string(), &folder.path().join(k.to_string()).display().to_string())).collect();
        let mut began = 0;
        let summary = batch(&jobs, 2, 2, &mut |news| {
            began += usize::from(matches!(news, News::Began(_)));
            ControlFlow::Continue(())
        })
        .expect("runs");
        assert_eq!(began, 5);
        let names: Vec<&str> = summary.rows.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["0", "1", "2", "3", "4"]);
        assert!(
            summary
                .rows
                .iter()
                .all(|r| r.state == State::Failed && r.error.as_deref().unwrap_or("").contains("nowhere.glb"))
        );
        println!("{}", summary.table());
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0);
    }

    #[test]
    fn two_jobs_of_one_name_or_folder_are_refused() {
        let run = |a: Named, b: Named| {
            batch(&[a, b], 1, 1, &mut |_| ControlFlow::Continue(())).expect_err("refused").to_string()
        };
        assert!(run(named("a", "x"), named("a", "y")).contains("called a"));
        assert!(run(named("a", "x"), named("b", "x")).contains("both write to x"));
    }
}
