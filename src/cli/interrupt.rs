//! Ctrl-C.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::say;

/// Set by the first Ctrl-C or termination signal; a second one, or one that finds it set, ends the process at once. If no handler can be
/// set, the first signal ends `what`.
pub(super) fn stop_on_interrupt(what: &str) -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // In this order, so that the second signal finds set what the first one sets.
        let registered = flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .and_then(|_| flag::register(signal, Arc::clone(&stop)));
        if registered.is_err() {
            say(&format!("an interrupt will end {what} at once: its handler could not be installed"));
        }
    }
    stop
}
