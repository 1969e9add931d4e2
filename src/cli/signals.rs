//! Ctrl-C and SIGTERM.

use std::thread;

/// Exit status after Ctrl-C.
const INTERRUPTED: i32 = 130;
/// Exit status after SIGTERM.
#[cfg(unix)]
const TERMINATED: i32 = 143;

/// Calls `end` with the exit status on each Ctrl-C and SIGTERM. If no listening thread can be started, the signals end
/// the program as usual, and the next run removes temporary files. SIGHUP keeps its default action, so that nohup
/// works.
pub(crate) fn listen(end: impl Fn(i32) + Clone + Send + 'static) {
    // The crate `ctrlc` installs its handler before it fails to start its thread.
    if thread::Builder::new().spawn(|| ()).is_err() {
        return;
    }
    #[cfg(unix)]
    listen_for_term(end.clone());
    // A signal that is ignored, as for background jobs of a script, stays ignored.
    let _ = ctrlc::try_set_handler(move || end(INTERRUPTED));
}

/// Blocks SIGTERM in all threads except one, which waits for it.
#[cfg(unix)]
fn listen_for_term(end: impl Fn(i32) + Send + 'static) {
    use nix::sys::signal::{SigSet, Signal};

    let term = SigSet::from(Signal::SIGTERM);
    if term.thread_block().is_err() {
        return;
    }
    let wait = move || {
        while term.wait().is_ok() {
            end(TERMINATED);
        }
    };
    if thread::Builder::new().name("signals".to_string()).spawn(wait).is_err() {
        let _ = term.thread_unblock();
    }
}
