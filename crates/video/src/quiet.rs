//! Catching panics of foreign parsers without the panic message on the terminal: libraries do not print.

use std::cell::Cell;
use std::panic::{UnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work`; a panic becomes `Err(())` and prints nothing. Other threads' panics are reported as before.
pub fn catch_quietly<T>(work: impl FnOnce() -> T + UnwindSafe) -> Result<T, ()> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = take_hook();
        set_hook(Box::new(move |info| {
            if !QUIET.get() {
                report(info);
            }
        }));
    });
    let before = QUIET.replace(true);
    let result = catch_unwind(work);
    QUIET.set(before);
    result.map_err(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_and_later_panics_still_report() {
        assert_eq!(catch_quietly(|| -> i32 { panic!("silent") }), Err(()));
        assert_eq!(catch_quietly(|| 7), Ok(7));
        assert!(!QUIET.get());
    }
}
