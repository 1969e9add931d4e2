//! Calls that say how far they are, hear Ctrl-C, and are called off. The work goes on in a thread of its own, without the interpreter's lock.

use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use parfocal::Progress;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::raised;

/// How long a wait lasts before Ctrl-C is asked for.
pub(crate) const STEP: Duration = Duration::from_millis(50);

/// Calls solves off, from any thread: those that have it raise Cancelled soon, and so do all that begin with it afterwards.
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

    /// Calls off what is being solved with it.
    fn cancel(&self) {
        self.cancel.cancel();
    }

    /// Whether it was called off.
    #[getter]
    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }
}

/// The progress function of a solve.
pub(crate) type Report = Arc<dyn Fn(Progress) + Send + Sync>;

/// Who is told which share is done, if anyone, and what calls off.
pub(crate) struct Watch<'py> {
    pub(crate) progress: Option<Bound<'py, PyAny>>,
    pub(crate) cancel: parfocal::CancellationToken,
}

impl<'py> Watch<'py> {
    pub(crate) fn new(progress: Option<Bound<'py, PyAny>>, cancel: Option<PyRef<'_, CancellationToken>>) -> Self {
        Self { progress, cancel: cancel.map(|cancel| cancel.cancel.clone()).unwrap_or_default() }
    }

    /// Does work that tells which share of it is done. What progress raises, and Ctrl-C, calls it off.
    pub(crate) fn over<T: Send>(
        &self,
        py: Python<'py>,
        work: impl FnOnce(Report) -> Result<T, parfocal::Error> + Send,
    ) -> PyResult<T> {
        let (tell, mut told) = mpsc::channel::<f64>();
        thread::scope(|scope| {
            let work = move || {
                work(Arc::new(move |progress: Progress| {
                    // Nothing receives any more once the call has ended.
                    let _ = tell.send(progress.share);
                }))
            };
            let worker = thread::Builder::new().spawn_scoped(scope, work)?;
            let mut raising = None;
            loop {
                let heard = &mut told;
                let heard = py.detach(move || heard.recv_timeout(STEP));
                let said = match (heard, &raising) {
                    (Err(RecvTimeoutError::Disconnected), _) => break,
                    (_, Some(_)) => continue,
                    (Ok(share), None) => self.tell(share),
                    (Err(RecvTimeoutError::Timeout), None) => Ok(()),
                };
                raising = said.and_then(|()| py.check_signals()).err();
                if raising.is_some() {
                    self.cancel.cancel();
                }
            }
            let done = py.detach(|| worker.join());
            if let Some(raising) = raising {
                return Err(raising);
            }
            done.map_err(|_| PyRuntimeError::new_err("a fault of parfocal itself: report it"))?.map_err(raised)
        })
    }

    fn tell(&self, share: f64) -> PyResult<()> {
        self.progress.as_ref().map_or(Ok(()), |progress| progress.call1((share,)).map(drop))
    }
}
