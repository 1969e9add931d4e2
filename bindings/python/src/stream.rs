//! Many pairs one after the other. Waits are in steps, without the interpreter's lock, between which Ctrl-C is heard.

use std::process;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use parfocal::{EngineOptions, Error, Frame, QueueFull, Settings, Solution, settings::DeviceInfo};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::frame;
use crate::engine::{forked, of_solution, patience};
use crate::raised;
use crate::settings::settings;
use crate::watch::STEP;

/// Devices, and a stream over them from the first pair on, which says of what size and format pairs are.
#[pyclass(frozen, module = "parfocal")]
pub(crate) struct Stream {
    /// Not touched in a process that was forked: neither threads nor the driver's are there.
    inner: Option<Inner>,
    slots: usize,
    process: u32,
}

struct Inner {
    engines: Vec<parfocal::Engine>,
    state: Mutex<State>,
}

/// Those who wait share what they wait for.
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
    /// devices: as of an engine, one each; None takes the most capable, ["all"] every one that works.
    #[new]
    fn new(
        py: Python<'_>,
        devices: Option<Vec<String>>,
        slots: usize,
        timeout: f64,
        validation: bool,
    ) -> PyResult<Self> {
        let timeout = patience(timeout)?;
        if slots == 0 || devices.as_ref().is_some_and(Vec::is_empty) {
            return Err(PyValueError::new_err("a stream has one device at least, and one slot"));
        }
        let open =
            |device| parfocal::Engine::new(&EngineOptions { device, validation, timeout, ..EngineOptions::default() });
        let engines = py.detach(|| named(devices)?.into_iter().map(open).collect::<Result<Vec<_>, _>>());
        let inner = Some(Inner { engines: engines.map_err(raised)?, state: Mutex::default() });
        Ok(Self { inner, slots, process: process::id() })
    }

    /// The names of the devices.
    #[getter]
    fn names(&self) -> PyResult<Vec<String>> {
        Ok(self.inner()?.engines.iter().map(|engine| engine.info().name.clone()).collect())
    }

    /// What validation has said so far.
    #[getter]
    fn messages(&self) -> PyResult<Vec<String>> {
        Ok(self.inner()?.engines.iter().flat_map(parfocal::Engine::validation_messages).collect())
    }

    /// How many pairs may be pushed and not yet read.
    #[getter]
    fn capacity(&self) -> PyResult<usize> {
        Ok(self.slots.saturating_mul(2).saturating_mul(self.inner()?.engines.len()))
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        let inner = self.inner()?;
        Ok(py.detach(|| inner.lock().prepared.as_ref().map_or(0, |prepared| prepared.stream.len())))
    }

    /// Whether there was room for a pair by then; None waits for ever.
    fn push<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        named: &Bound<'py, PyDict>,
        timeout: Option<f64>,
    ) -> PyResult<bool> {
        let (inner, pair) = (self.inner()?, [frame(i1, "i1")?, frame(i2, "i2")?]);
        let settings = settings(named, &[&pair[0], &pair[1]])?;
        let prepared = py.detach(|| inner.prepare(self.slots, &pair, settings)).map_err(raised)?;
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

    /// The next result, by name, if it is there by then.
    fn next<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let inner = self.inner()?;
        let Some(Some((solved, prepared))) = in_steps(py, timeout, |step| inner.next(step))? else { return Ok(None) };
        of_solution(py, solved.map_err(raised)?, &prepared.settings).map(Some)
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

    /// Waits for what the devices have, and forgets the rest.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let inner = self.inner()?;
        py.detach(|| {
            let mut state = inner.lock();
            state.is_closed = true;
            let prepared = state.prepared.take();
            // Whoever waits is to see it meanwhile.
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

/// What came of a pair, and by which settings; `None` where all has been read and no more comes.
type Next = Option<(Result<Solution, Error>, Arc<Prepared>)>;

impl Inner {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The stream, made for pairs like this one if it is the first; `None` once it is closed.
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

    /// `None` where nothing is there by then.
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

/// The devices to open.
fn named(devices: Option<Vec<String>>) -> Result<Vec<Option<String>>, Error> {
    match devices {
        None => Ok(vec![None]),
        Some(devices) if devices == ["all"] => {
            let found = parfocal::Engine::devices()?;
            let every = DeviceInfo::usable(&found).into_iter().map(|device| Some(device.index.to_string()));
            let every: Vec<_> = every.collect();
            // Without any, the error says why.
            Ok(if every.is_empty() { vec![None] } else { every })
        }
        Some(devices) => Ok(devices.into_iter().map(Some).collect()),
    }
}

/// Tries again until it is done or so many seconds are over; `None` for ever.
fn in_steps<T: Send>(
    py: Python<'_>,
    timeout: Option<f64>,
    mut attempt: impl FnMut(Duration) -> Option<T> + Send,
) -> PyResult<Option<T>> {
    let wrong = |_| PyValueError::new_err("timeout: give seconds, 0 or more, or None");
    let timeout = timeout.map(Duration::try_from_secs_f64).transpose().map_err(wrong)?;
    // Past what a clock can hold, there is no deadline.
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
