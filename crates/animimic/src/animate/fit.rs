//! Stage 1 alone: model and videos in, one animated GLB out, nothing else.

use super::{Clock, Job, Report, Stage, deliver, solve};
use crate::Error;
use crate::event::{Event, Progress, tell};
use crate::run::Run;

/// Finds the motion in the job's videos and writes the animated model to the file `job.out`.
///
/// # Errors
/// Anything that is wrong with the inputs, before anything is written; [`Error::Cancelled`] when `progress` says stop.
pub fn fit(job: &Job, progress: &mut Progress) -> Result<Report, Error> {
    let mut clock = Clock::default();
    job.check()?;
    if job.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("glb")) {
        return Err(Error::Input(format!("{}: the result is a GLB: name a file that ends in .glb", job.out.display())));
    }
    let job = Job { stage: Stage::Pose, ..job.clone() };
    let (work, mut report) = solve(&job, &Run::default(), &mut clock, progress)?;
    tell(progress, Event::Stage { name: "writing" })?;
    deliver::glb(&job.out, job.physics, &work.asset, &deliver::skinned(&work.takes), &[], &mut report, &mut clock)?;
    report.timings = clock.to_json();
    Ok(report)
}
