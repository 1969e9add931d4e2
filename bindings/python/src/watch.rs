//! Progress, Ctrl-C and cancellation of calls. The work runs in its own thread without the interpreter's lock.

use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use parfocal::Progress;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::exception;

/// Interval between checks for Ctrl-C.
pub(crate) const STEP: Duration = Duration::from_millis(50);

/// Cancels solves, from any thread: solves that use the token raise Cancelled soon, and so do later ones.
#[pyclass(frozen, module = "parfocal")]
#[derive(Default)]
pub(crate) struct CancellationToken {
    pub(crate) cancel: parfocal::CancellationToken,
}

#[pymethods]
impl CancellationToken {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Cancels all solves that use this token.
    fn cancel(&self) {
        self.cancel.cancel();
    }

    /// Whether `cancel` was called.
    #[getter]
    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }
}

/// The progress function of a solve.
pub(crate) type Report = Arc<dyn Fn(Progress) + Send + Sync>;

/// The progress function and the cancellation token of a call.
pub(crate) struct Watch<'py> {
    pub(crate) progress: Option<Bound<'py, PyAny>>,
    pub(crate) cancel: parfocal::CancellationToken,
}

impl<'py> Watch<'py> {
    pub(crate) fn new(progress: Option<Bound<'py, PyAny>>, cancel: Option<PyRef<'_, CancellationToken>>) -> Self {
        Self { progress, cancel: cancel.map(|cancel| cancel.cancel.clone()).unwrap_or_default() }
    }

    /// Runs `work` and passes its progress to Python. An exception of the progress function, and Ctrl-C, cancel it.
    pub(crate) fn over<T: Send>(
        &self,
        py: Python<'py>,
        work: impl FnOnce(Report) -> Result<T, parfocal::Error> + Send,
    ) -> PyResult<T> {
        let (sender, mut receiver) = mpsc::channel::<f64>();
        thread::scope(|scope| {
            let work = move || {
                work(Arc::new(move |progress: Progress| {
                    // Fails only once the call has ended and nothing receives any more.
                    let _ = sender.send(progress.share);
                }))
            };
            let worker = thread::Builder::new().spawn_scoped(scope, work)?;
            let mut raised = None;
            loop {
                let receiver = &mut receiver;
                let received = py.detach(move || receiver.recv_timeout(STEP));
                let called = match (received, &raised) {
                    (Err(RecvTimeoutError::Disconnected), _) => break,
                    (_, Some(_)) => continue,
                    (Ok(share), None) => self.report(share),
                    (Err(RecvTimeoutError::Timeout), None) => Ok(()),
                };
                raised = called.and_then(|()| py.check_signals()).err();
                if raised.is_some() {
                    self.cancel.cancel();
                }
            }
            let done = py.detach(|| worker.join());
            if let Some(raised) = raised {
                return Err(raised);
            }
            done.map_err(|_| PyRuntimeError::new_err("internal error of parfocal: please report it"))?
                .map_err(exception)
        })
    }

    fn report(&self, share: f64) -> PyResult<()> {
        self.progress.as_ref().map_or(Ok(()), |progress| progress.call1((share,)).map(drop))
    }
}
