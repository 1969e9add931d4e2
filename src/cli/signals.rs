//! How the program ends where it is told to: by Ctrl-C, or by SIGTERM.

use std::thread;

/// Status of a program that Ctrl-C ended.
pub(crate) const INTERRUPTED: i32 = 130;
/// Status of one that SIGTERM ended.
const TERMINATED: i32 = 143;

/// From now on `end` is called, with the status, whenever the program is told to end. Where there is no thread left to listen,
/// it ends as programs do, and the next run removes what it leaves. SIGHUP is not listened to, for nohup's sake.
pub(crate) fn listen(end: impl Fn(i32) + Clone + Send + 'static) {
    // The crate takes the signal away before it finds that it has no thread to wait for it.
    if thread::Builder::new().spawn(|| ()).is_err() {
        return;
    }
    #[cfg(unix)]
    listen_for_term(end.clone());
    // Where the signal is ignored, as for jobs in the background of a script, it stays so.
    let _ = ctrlc::try_set_handler(move || end(INTERRUPTED));
}

/// SIGTERM is kept from all threads, which inherit that, but for one that waits for it.
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
    if thread::Builder::new().name("ending".to_string()).spawn(wait).is_err() {
        let _ = term.thread_unblock();
    }
}
