//! The class Stream. It waits in short steps without the interpreter's lock, and checks for Ctrl-C between them.

use std::process;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use parfocal::{EngineOptions, Error, Frame, QueueFull, Settings, Solution, settings::DeviceInfo};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::frame;
use crate::engine::{forked, of_solution, time_limit};
use crate::exception;
use crate::settings::settings as read_settings;
use crate::watch::STEP;

/// Devices, and a stream over them. The first pair determines size and format, and makes the stream.
#[pyclass(frozen, module = "parfocal")]
pub(crate) struct Stream {
    /// Not used in a forked process, which has neither the worker nor the driver threads.
    inner: Option<Inner>,
    slots: usize,
    process: u32,
}

struct Inner {
    engines: Vec<parfocal::Engine>,
    state: Mutex<State>,
}

/// The state that waiting calls share.
#[derive(Clone, Default)]
struct State {
    prepared: Option<Arc<Prepared>>,
    is_finished: bool,
    is_closed: bool,
}

struct Prepared {
    stream: parfocal::Stream,
    settings: Settings,
}

impl Drop for Stream {
    fn drop(&mut self) {
        if self.process != process::id() {
            std::mem::forget(self.inner.take());
        }
    }
}

#[pymethods]
impl Stream {
    /// devices: one engine's `device` each; None selects the most capable, ["all"] all usable ones.
    #[new]
    fn new(
        py: Python<'_>,
        devices: Option<Vec<String>>,
        slots: usize,
        timeout: f64,
        validation: bool,
    ) -> PyResult<Self> {
        let timeout = time_limit(timeout)?;
        if slots == 0 || devices.as_ref().is_some_and(Vec::is_empty) {
            return Err(PyValueError::new_err("give at least one device and one slot"));
        }
        let open =
            |device| parfocal::Engine::new(&EngineOptions { device, validation, timeout, ..EngineOptions::default() });
        let engines =
            py.detach(|| device_names(devices, validation)?.into_iter().map(open).collect::<Result<Vec<_>, _>>());
        let inner = Some(Inner { engines: engines.map_err(exception)?, state: Mutex::default() });
        Ok(Self { inner, slots, process: process::id() })
    }

    /// The names of the devices.
    #[getter]
    fn names(&self) -> PyResult<Vec<String>> {
        Ok(self.inner()?.engines.iter().map(|engine| engine.info().name.clone()).collect())
    }

    /// The messages of the validation layer so far.
    #[getter]
    fn messages(&self) -> PyResult<Vec<String>> {
        Ok(self.inner()?.engines.iter().flat_map(parfocal::Engine::validation_messages).collect())
    }

    /// The number of pairs that may be pushed and not yet read.
    #[getter]
    fn capacity(&self) -> PyResult<usize> {
        Ok(self.slots.saturating_mul(2).saturating_mul(self.inner()?.engines.len()))
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        let inner = self.inner()?;
        Ok(py.detach(|| inner.lock().prepared.as_ref().map_or(0, |prepared| prepared.stream.len())))
    }

    /// Pushes a pair. Returns whether there was room in time; a timeout of None waits without limit.
    fn push<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        settings: &Bound<'py, PyDict>,
        timeout: Option<f64>,
    ) -> PyResult<bool> {
        let (inner, pair) = (self.inner()?, [frame(i1, "i1")?, frame(i2, "i2")?]);
        let settings = read_settings(settings, &[&pair[0], &pair[1]])?;
        let prepared = py.detach(|| inner.prepare(self.slots, &pair, settings)).map_err(exception)?;
        let prepared = prepared.ok_or_else(|| PyValueError::new_err("the stream is closed"))?;
        let mut pair = Some(pair);
        let push = |step| {
            if inner.lock().is_closed {
                return Some(false);
            }
            match prepared.stream.push(pair.take()?, step) {
                Ok(()) => Some(true),
                Err(QueueFull(back)) => {
                    pair = Some(back);
                    None
                }
            }
        };
        match in_steps(py, timeout, push)? {
            Some(false) => Err(PyValueError::new_err("the stream is closed")),
            Some(true) => {
                py.detach(|| inner.lock().is_finished = false);
                Ok(true)
            }
            None => Ok(false),
        }
    }

    /// Returns the next result as a dictionary, if it is ready in time.
    fn next<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let inner = self.inner()?;
        let Some(Some((solved, prepared))) = in_steps(py, timeout, |step| inner.next(step))? else { return Ok(None) };
        of_solution(py, solved.map_err(exception)?, &prepared.settings).map(Some)
    }

    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        let inner = self.inner()?;
        py.detach(|| {
            let mut state = inner.lock();
            state.is_finished = true;
            state.prepared.iter().for_each(|prepared| prepared.stream.finish());
        });
        Ok(())
    }

    /// Waits for the pairs in flight and drops the rest.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let inner = self.inner()?;
        py.detach(|| {
            let mut state = inner.lock();
            state.is_closed = true;
            let prepared = state.prepared.take();
            // Unlocked first, so that waiting calls see that the stream is closed.
            drop(state);
            drop(prepared);
        });
        Ok(())
    }
}

impl Stream {
    fn inner(&self) -> PyResult<&Inner> {
        self.inner.as_ref().filter(|_| self.process == process::id()).ok_or_else(forked)
    }
}

/// The result of a pair and the stream it came from; `None` at the end of the stream.
type Next = Option<(Result<Solution, Error>, Arc<Prepared>)>;

impl Inner {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the stream, which the first pair makes; `None` once it is closed.
    fn prepare(&self, slots: usize, pair: &[Frame; 2], settings: Settings) -> Result<Option<Arc<Prepared>>, Error> {
        let mut state = self.lock();
        if state.is_closed {
            return Ok(None);
        }
        if state.prepared.is_none() {
            let engines: Vec<&parfocal::Engine> = self.engines.iter().collect();
            let (size, formats) = ([pair[0].width(), pair[0].height()], pair.each_ref().map(Frame::format));
            let stream = parfocal::Stream::new(&engines, slots, size, formats, &settings)?;
            state.prepared = Some(Arc::new(Prepared { stream, settings }));
        }
        Ok(state.prepared.clone())
    }

    /// Returns the next result; `None` if it is not ready in time.
    fn next(&self, limit: Duration) -> Option<Next> {
        let State { prepared, is_finished, is_closed } = self.lock().clone();
        let Some(prepared) = prepared else {
            if is_finished || is_closed {
                return Some(None);
            }
            thread::sleep(limit);
            return None;
        };
        let next = prepared.stream.next(limit).transpose();
        let is_end = next.is_none() && is_finished && prepared.stream.is_empty();
        if is_end { Some(None) } else { next.map(|next| Some((next, prepared))) }
    }
}

/// Returns the devices to open.
fn device_names(devices: Option<Vec<String>>, validation: bool) -> Result<Vec<Option<String>>, Error> {
    match devices {
        None => Ok(vec![None]),
        Some(devices) if devices == ["all"] => {
            let all = parfocal::Engine::devices()?;
            let usable = DeviceInfo::usable(&all, validation).into_iter().map(|device| Some(device.index.to_string()));
            let usable: Vec<_> = usable.collect();
            // Without a usable device, opening the default one gives the reason.
            Ok(if usable.is_empty() { vec![None] } else { usable })
        }
        Some(devices) => Ok(devices.into_iter().map(Some).collect()),
    }
}

/// Repeats an attempt until it succeeds or the timeout in seconds passes; `None` has no limit.
fn in_steps<T: Send>(
    py: Python<'_>,
    timeout: Option<f64>,
    mut attempt: impl FnMut(Duration) -> Option<T> + Send,
) -> PyResult<Option<T>> {
    let wrong = |_| PyValueError::new_err("timeout: give seconds of at least 0, or None");
    let timeout = timeout.map(Duration::try_from_secs_f64).transpose().map_err(wrong)?;
    // A deadline beyond the clock's range is none.
    let deadline = timeout.and_then(|timeout| Instant::now().checked_add(timeout));
    loop {
        let left = deadline.map_or(STEP, |deadline| deadline.saturating_duration_since(Instant::now()));
        let done = py.detach(|| attempt(left.min(STEP)));
        if done.is_some() || left.is_zero() {
            return Ok(done);
        }
        py.check_signals()?;
    }
}
