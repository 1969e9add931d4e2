//! Calls that are called off, and that say how far they are.

use std::ffi::c_void;
use std::sync::Arc;

use parfocal::{CancellationToken, Progress, SolveOptions};

use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, give};

/// Calls solves off, from any thread: what is being solved with it ends soon, with PARFOCAL_CANCELLED, and so does all that begins with it
/// afterwards. What was used is good for the next call.
pub struct parfocal_cancel {
    pub(crate) cancel: CancellationToken,
}

/// Makes one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancel_new(cancel: *mut *mut parfocal_cancel) -> parfocal_status {
    // SAFETY: the contract is the same.
    call(|| unsafe { give(cancel, || Ok(parfocal_cancel { cancel: CancellationToken::default() })) })
}

/// Calls off what is being solved with it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancel_now(cancel: *const parfocal_cancel) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        unsafe { get(cancel, "cancel") }?.cancel.cancel();
        Ok(())
    })
}

/// Frees it; calls that have it go on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancel_free(cancel: *mut parfocal_cancel) {
    // SAFETY: the contract is the same.
    unsafe { free(cancel) };
}

/// Is told by the thread that solves which share of a solve is done, 0 to 1, after each level, and calls it off by what is not 0. It calls no
/// function of parfocal with a handle of the same call but parfocal_cancel_now, and returns: no exception or longjmp leaves it.
pub type parfocal_progress = Option<unsafe extern "C" fn(context: *mut c_void, done: f64) -> i32>;

/// The progress function of a call, with its context.
struct Report {
    progress: unsafe extern "C" fn(*mut c_void, f64) -> i32,
    context: *mut c_void,
    cancel: CancellationToken,
}

// SAFETY: only the thread of the call that it belongs to calls it, and while that lasts.
unsafe impl Send for Report {}
// SAFETY: likewise.
unsafe impl Sync for Report {}

impl Report {
    /// Passes the share that is done, and cancels the call by what is not 0.
    fn call(&self, progress: Progress) {
        // SAFETY: it may be called so, by the contract of `control`.
        if unsafe { (self.progress)(self.context, progress.share) } != 0 {
            self.cancel.cancel();
        }
    }
}

/// Options by which a call reports its progress and is cancelled.
///
/// # Safety
/// `cancel` is NULL or a handle; `progress` may be called with `context` for as long as the options live.
pub(crate) unsafe fn control(
    progress: parfocal_progress,
    context: *mut c_void,
    cancel: *const parfocal_cancel,
) -> Result<SolveOptions, Fault> {
    let cancel = match cancel.is_null() {
        true => CancellationToken::default(),
        // SAFETY: the contract is the same.
        false => unsafe { get(cancel, "cancel") }?.cancel.clone(),
    };
    let report = progress.map(|progress| Report { progress, context, cancel: cancel.clone() });
    let progress = report.map(|report| Arc::new(move |progress| report.call(progress)) as Arc<_>);
    Ok(SolveOptions { cancel, progress, ..SolveOptions::default() })
}
