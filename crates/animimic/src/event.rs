//! What a long computation tells while it runs, and how it is stopped.

use std::ops::ControlFlow;

/// One piece of news.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A stage begins.
    Stage {
        /// Its name, fit for a progress bar.
        name: &'static str,
    },
    /// The running stage advances.
    Step {
        /// Share done, in \[0, 1\].
        done: f64,
        /// The loss, where there is one.
        loss: Option<f64>,
    },
    /// Something that the user should know.
    Warning(String),
}

/// Where news goes. Returning `Break` stops the computation with [`crate::Error::Cancelled`].
pub type Progress<'a> = dyn FnMut(Event) -> ControlFlow<()> + 'a;

/// Reports an event and turns a request to stop into an error.
pub(crate) fn tell(progress: &mut Progress, event: Event) -> Result<(), crate::Error> {
    match progress(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(crate::Error::Cancelled),
    }
}
