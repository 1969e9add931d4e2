//! Cancellation and progress of calls.

use std::ffi::c_void;
use std::sync::Arc;

use parfocal::{CancellationToken, Progress, SolveOptions};

use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{free, get, give};

/// Cancels solves, from any thread. Running solves with the token end soon with PARFOCAL_ERROR_CANCELLED, later ones
/// at once. The other handles of a cancelled call stay usable.
pub struct parfocal_cancellation_token {
    pub(crate) cancel: CancellationToken,
}

/// Makes a token.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancellation_token_new(
    cancel: *mut *mut parfocal_cancellation_token,
) -> parfocal_status {
    // SAFETY: by the C contract.
    call(|| unsafe { give(cancel, || Ok(parfocal_cancellation_token { cancel: CancellationToken::default() })) })
}

/// Cancels all solves that use this token.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancellation_token_cancel(
    cancel: *const parfocal_cancellation_token,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        unsafe { get(cancel, "cancel") }?.cancel.cancel();
        Ok(())
    })
}

/// Frees a token. Calls that use it continue.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_cancellation_token_free(cancel: *mut parfocal_cancellation_token) {
    // SAFETY: by the C contract.
    unsafe { free(cancel) };
}

/// Called after every few iterations by the solving thread, with the share of the solve that is done, 0 to 1. A result other than 0
/// cancels the solve. With handles of the same call it may only call parfocal_cancellation_token_cancel. It must return: no
/// exception and no longjmp may leave it.
pub type parfocal_progress = Option<unsafe extern "C" fn(context: *mut c_void, done: f64) -> i32>;

/// The progress function of a call, with its context.
struct Report {
    progress: unsafe extern "C" fn(*mut c_void, f64) -> i32,
    context: *mut c_void,
    cancel: CancellationToken,
}

// SAFETY: only the thread of its call uses it, during that call.
unsafe impl Send for Report {}
// SAFETY: as for `Send`.
unsafe impl Sync for Report {}

impl Report {
    /// Passes the share done to the caller, and cancels if the result is not 0.
    fn call(&self, progress: Progress) {
        // SAFETY: `control` requires that `progress` may be called with `context`.
        if unsafe { (self.progress)(self.context, progress.share) } != 0 {
            self.cancel.cancel();
        }
    }
}

/// Solve options with the progress function and the token of a call.
///
/// # Safety
/// `cancel` is NULL or a handle; `progress` may be called with `context` for as long as the options live.
pub(crate) unsafe fn control(
    progress: parfocal_progress,
    context: *mut c_void,
    cancel: *const parfocal_cancellation_token,
) -> Result<SolveOptions, Fault> {
    let cancel = match cancel.is_null() {
        true => CancellationToken::default(),
        // SAFETY: the caller passes NULL or a handle.
        false => unsafe { get(cancel, "cancel") }?.cancel.clone(),
    };
    let report = progress.map(|progress| Report { progress, context, cancel: cancel.clone() });
    let progress = report.map(|report| Arc::new(move |progress| report.call(progress)) as Arc<_>);
    Ok(SolveOptions { cancel, progress, ..SolveOptions::default() })
}
