//! A device, and what is done on it without the interpreter's lock.

use std::process;
use std::sync::{Mutex, PoisonError, TryLockError};
use std::thread;
use std::time::Duration;

use numpy::PyReadonlyArray2;
use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{
    EngineOptions, Frame, Lens, PairSolver, Settings, Solution, SolveOptions, SweepSolver,
    metric::MetricDepth,
    resample,
    results::{LevelHistory, Registered},
    settings::{Decode, Photometric},
    transform::{Brightness, Shading},
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::convert::{array_of, field, frame, homography, image, mask, matrix, region, row};
use crate::settings::settings;
use crate::watch::{CancellationToken, Report, Watch};
use crate::{DeviceError, raised};

/// How often a call looks whether it is its turn.
const TURN: Duration = Duration::from_millis(1);

/// A Vulkan device. Calls of several threads wait for each other.
///
/// device: index, part of the name, or UUID; None takes the most capable. timeout: the longest wait for one solve, seconds.
#[pyclass(frozen, module = "parfocal")]
pub(crate) struct Engine {
    /// Not touched in a process that was forked: the driver's threads are not there.
    inner: Option<Mutex<Inner>>,
    name: String,
    process: u32,
}

struct Inner {
    engine: parfocal::Engine,
    solver: Option<PairSolver>,
}

impl Drop for Engine {
    fn drop(&mut self) {
        if self.process != process::id() {
            std::mem::forget(self.inner.take());
        }
    }
}

#[pymethods]
impl Engine {
    #[new]
    #[pyo3(signature = (device=None, *, timeout=600.0, validation=false))]
    fn new(py: Python<'_>, device: Option<String>, timeout: f64, validation: bool) -> PyResult<Self> {
        let options = EngineOptions { device, validation, timeout: patience(timeout)?, ..EngineOptions::default() };
        let engine = py.detach(|| parfocal::Engine::new(&options)).map_err(raised)?;
        let name = engine.info().name.clone();
        let inner = Some(Mutex::new(Inner { engine, solver: None }));
        Ok(Self { inner, name, process: process::id() })
    }

    /// The name of the device.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// What validation has said so far.
    #[getter]
    fn messages(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |inner| Ok(inner.engine.validation_messages()))
    }

    fn __repr__(&self) -> String {
        format!("<parfocal.Engine on {}>", self.name)
    }

    /// What a solve of a pair finds, by name.
    #[allow(clippy::too_many_arguments, reason = "they are keywords of Python's")]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        named: &Bound<'py, PyDict>,
        part: Option<[u32; 4]>,
        counts: Option<&Bound<'py, PyAny>>,
        crop_valid: bool,
        progress: Option<Bound<'py, PyAny>>,
        cancel: Option<PyRef<'_, CancellationToken>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (i1, i2) = (frame(i1, "i1")?, frame(i2, "i2")?);
        let settings = settings(named, &[&i1, &i2])?;
        let watch = Watch::new(progress, cancel);
        let (mask, cancel) = (counts.map(mask).transpose()?, watch.cancel.clone());
        let scope = SolveOptions { region: part.map(region), mask, crop_valid, cancel, ..SolveOptions::default() };
        let solved = self.watched(py, &watch, |inner, report| {
            let options = SolveOptions { progress: Some(report), ..scope };
            inner.solver(&settings)?.solve([&i1, &i2], &options)
        })?;
        of_solution(py, solved, &settings)
    }

    /// What a registration of a pair finds, by name.
    fn register<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        named: &Bound<'py, PyDict>,
        progress: Option<Bound<'py, PyAny>>,
        cancel: Option<PyRef<'_, CancellationToken>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (i1, i2) = (frame(i1, "i1")?, frame(i2, "i2")?);
        let settings = settings(named, &[&i1, &i2])?;
        let watch = Watch::new(progress, cancel);
        let cancel = watch.cancel.clone();
        let registered = self.watched(py, &watch, |inner, report| {
            let options = SolveOptions { cancel, progress: Some(report), ..SolveOptions::default() };
            inner.solver(&settings)?.register([&i1, &i2], &options)
        })?;
        of_registration(py, &registered, &settings)
    }

    /// What a solve of a focus sweep finds, by name.
    #[allow(clippy::too_many_arguments, reason = "they are keywords of Python's")]
    fn stack<'py>(
        &self,
        py: Python<'py>,
        frames: Vec<Bound<'py, PyAny>>,
        named: &Bound<'py, PyDict>,
        positions: Option<Vec<f64>>,
        unit: &str,
        reference: Option<usize>,
        part: Option<[u32; 4]>,
        counts: Option<&Bound<'py, PyAny>>,
        progress: Option<Bound<'py, PyAny>>,
        cancel: Option<PyRef<'_, CancellationToken>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let frames: Vec<Frame> =
            frames.iter().enumerate().map(|(n, f)| frame(f, &format!("frames[{n}]"))).collect::<PyResult<_>>()?;
        let positions = match (positions, unit) {
            (None, _) => Positions::Counted,
            (Some(p), "settings") => Positions::Settings(p),
            (Some(p), "distances") => Positions::Distances(p),
            (Some(p), "stage") => Positions::Stage(p),
            _ => return Err(PyValueError::new_err(format!("unit={unit:?}: give settings, distances or stage"))),
        };
        let settings = settings(named, &frames.iter().collect::<Vec<_>>())?;
        let watch = Watch::new(progress, cancel);
        let (mask, cancel) = (counts.map(mask).transpose()?, watch.cancel.clone());
        let scope = SolveOptions { region: part.map(region), mask, cancel, ..SolveOptions::default() };
        let sweep = self.watched(py, &watch, |inner, report| {
            let scope = SolveOptions { progress: Some(report), ..scope };
            SweepSolver::new(&inner.engine, &SweepOptions { settings, positions, reference })?.solve(&frames, &scope)
        })?;
        of_sweep(py, sweep)
    }
}

impl Engine {
    /// Uses the device without the interpreter's lock.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        run: impl FnOnce(&mut Inner) -> Result<T, parfocal::Error> + Send,
    ) -> PyResult<T> {
        let inner = self.inner.as_ref().filter(|_| self.process == process::id()).ok_or_else(forked)?;
        py.detach(|| run(&mut inner.lock().unwrap_or_else(PoisonError::into_inner))).map_err(raised)
    }

    /// The same of what says how far it is, and may be called off.
    fn watched<'py, T: Send>(
        &self,
        py: Python<'py>,
        watch: &Watch<'py>,
        run: impl FnOnce(&mut Inner, Report) -> Result<T, parfocal::Error> + Send,
    ) -> PyResult<T> {
        let inner = self.inner.as_ref().filter(|_| self.process == process::id()).ok_or_else(forked)?;
        let cancel = watch.cancel.clone();
        watch.over(py, |report| {
            let mut inner = loop {
                match inner.try_lock() {
                    Ok(inner) => break inner,
                    Err(TryLockError::Poisoned(inner)) => break inner.into_inner(),
                    // Another thread solves, for which this one may be called off.
                    Err(TryLockError::WouldBlock) if cancel.is_cancelled() => return Err(parfocal::Error::Cancelled),
                    Err(TryLockError::WouldBlock) => thread::sleep(TURN),
                }
            };
            run(&mut inner, report)
        })
    }
}

impl Inner {
    /// The solver, with these settings.
    fn solver(&mut self, settings: &Settings) -> Result<&mut PairSolver, parfocal::Error> {
        let mut solver = match self.solver.take() {
            Some(solver) => solver,
            None => PairSolver::new(&self.engine, settings)?,
        };
        solver.set_settings(settings)?;
        Ok(self.solver.insert(solver))
    }
}

/// The longest wait for one solve.
pub(crate) fn patience(seconds: f64) -> PyResult<Duration> {
    let timeout = Duration::try_from_secs_f64(seconds).ok().filter(|timeout| !timeout.is_zero());
    timeout.ok_or_else(|| PyValueError::new_err("timeout: give seconds, more than 0"))
}

/// What is said in a process that was forked.
pub(crate) fn forked() -> PyErr {
    DeviceError::new_err(
        "this process was forked after the engine was opened, and the device is not in it: use multiprocessing's start \
         method 'spawn' or 'forkserver', or open the first engine in the child",
    )
}

/// The names of the devices, and why those that will not do will not.
#[pyfunction]
pub(crate) fn devices(py: Python<'_>) -> PyResult<Vec<(String, Option<String>)>> {
    let found = py.detach(parfocal::Engine::devices).map_err(raised)?;
    Ok(found.into_iter().map(|device| (device.name, device.unusable)).collect())
}

/// Other photographs on the pixels of results: the transform, gain, offset and shading, the part that it is of, how values are
/// decoded, and the part that is wanted.
#[pyfunction]
pub(crate) fn apply(
    py: Python<'_>,
    of: &Bound<'_, PyAny>,
    transform: [[f64; 3]; 3],
    brightness: Option<(f64, f64, Vec<f64>, [u32; 4])>,
    decode: &str,
    part: [u32; 4],
) -> PyResult<Py<PyAny>> {
    let (frame, transform) = (frame(of, "image")?, homography(transform)?);
    let brightness = match brightness {
        None => Brightness::identity([frame.width(), frame.height()]),
        Some((gain, offset, coefficients, part)) => {
            let coefficients = <[f64; Shading::TERMS]>::try_from(coefficients).map_err(|c| {
                PyValueError::new_err(format!("shading has {} coefficients, not {}", c.len(), Shading::TERMS))
            })?;
            Brightness {
                photometric: Photometric { gain, offset },
                shading: Shading { coefficients },
                part: region(part),
            }
        }
    };
    let decode = if decode == "srgb" { Decode::Srgb } else { Decode::None };
    let moved = py.detach(|| resample::registered(&frame, &transform, &brightness, decode).cropped(region(part)));
    array_of(py, &moved.map_err(PyValueError::new_err)?)
}

/// Depth and deviation, mm; pixels out of range; what speaks against the lens.
type Depth = (Py<PyAny>, Py<PyAny>, usize, Option<String>);

/// Depth in mm through a lens.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "they are keywords of Python's")]
pub(crate) fn depth(
    py: Python<'_>,
    blur: PyReadonlyArray2<'_, f32>,
    uncertainty: PyReadonlyArray2<'_, f32>,
    scale: f64,
    limit: f64,
    optics: (f64, f64, f64),
    focus: [f64; 2],
    kappa: f64,
    telecentric: bool,
) -> PyResult<Depth> {
    let (focal_length, f_number, pixel_pitch) = optics;
    let lens = Lens { focal_length, f_number, pixel_pitch, focus, kappa, telecentric };
    lens.check().map_err(raised)?;
    let [blur, sigma] = [blur, uncertainty].map(|field| field.as_array().to_owned());
    if blur.dim() != sigma.dim() {
        return Err(PyValueError::new_err("relative blur and uncertainty are of two shapes"));
    }
    let size = [blur.ncols() as u32, blur.nrows() as u32];
    let (blur, sigma): (Vec<f32>, Vec<f32>) = (blur.into_iter().collect(), sigma.into_iter().collect());
    let (found, doubt) = py.detach(|| {
        let found = MetricDepth::new(&lens, scale, limit, size[0], &blur, &sigma);
        let doubt = found.doubt(scale, limit, &blur);
        (found, doubt)
    });
    Ok((field(py, found.depth, size)?, field(py, found.deviation, size)?, found.out_of_range, doubt))
}

fn decode_name(decode: Decode) -> &'static str {
    if decode == Decode::Srgb { "srgb" } else { "none" }
}

fn levels<'py>(py: Python<'py>, levels: &[LevelHistory]) -> PyResult<Bound<'py, PyList>> {
    let level = |level: &LevelHistory| (level.width, level.height, row(py, level.energy.clone()));
    PyList::new(py, levels.iter().map(level))
}

fn brightness<'py>(py: Python<'py>, of: &Brightness, into: &Bound<'py, PyDict>) -> PyResult<()> {
    into.set_item("gain", of.photometric.gain)?;
    into.set_item("offset", of.photometric.offset)?;
    into.set_item("shading", row(py, of.shading.coefficients.to_vec()))?;
    into.set_item("shading_region", <[u32; 4]>::from(of.part))
}

pub(crate) fn of_solution<'py>(py: Python<'py>, s: Solution, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
    let (found, size, channels) = (PyDict::new(py), [s.width, s.height], s.fused_channels);
    found.set_item("relative_blur", field(py, s.relative_blur, size)?)?;
    found.set_item("uncertainty", field(py, s.uncertainty, size)?)?;
    found.set_item("confidence", field(py, s.confidence, size)?)?;
    found.set_item("residual", field(py, s.residual, size)?)?;
    let fused = settings.fused.then(|| image(py, s.fused, size, channels)).transpose()?;
    found.set_item("fused", fused)?;
    let s = s.findings;
    brightness(py, &s.brightness(), &found)?;
    found.set_item("region", <[u32; 4]>::from(s.region()))?;
    found.set_item("transform", matrix(py, &s.transform)?)?;
    found.set_item("scale", s.transform.scale())?;
    found.set_item("photograph", s.photograph)?;
    found.set_item("regularization", s.regularization)?;
    found.set_item("kernel_shape", s.kernel_shape)?;
    found.set_item("other_motion", s.other_motion.map(|other| other.to_string()))?;
    found.set_item("levels", levels(py, &s.levels)?)?;
    found.set_item("converged", s.converged)?;
    found.set_item("warnings", s.warnings)?;
    found.set_item("valid_fraction", s.valid_fraction)?;
    found.set_item("mean_confidence", s.mean_confidence)?;
    found.set_item("saturated_fraction", s.saturated_fraction)?;
    found.set_item("max_relative_blur", settings.max_relative_blur)?;
    found.set_item("decode", decode_name(settings.decode))?;
    found.set_item("total_ms", s.timings.total_ms)?;
    found.set_item("gpu_ms", s.timings.gpu_ms)?;
    Ok(found)
}

fn of_registration<'py>(py: Python<'py>, r: &Registered, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
    let found = PyDict::new(py);
    brightness(py, &r.brightness(), &found)?;
    found.set_item("region", [0, 0, r.width, r.height])?;
    found.set_item("photograph", [r.width, r.height])?;
    found.set_item("transform", matrix(py, &r.transform)?)?;
    found.set_item("other_motion", r.other_motion.map(|other| other.to_string()))?;
    found.set_item("levels", levels(py, &r.levels)?)?;
    found.set_item("converged", r.converged)?;
    found.set_item("warnings", r.warnings.clone())?;
    found.set_item("decode", decode_name(settings.decode))?;
    found.set_item("total_ms", r.timings.total_ms)?;
    found.set_item("gpu_ms", r.timings.gpu_ms)?;
    Ok(found)
}

fn of_sweep(py: Python<'_>, s: Sweep) -> PyResult<Bound<'_, PyDict>> {
    let (found, size) = (PyDict::new(py), [s.width, s.height]);
    let bright = s.brightness.iter().map(|of| {
        let one = PyDict::new(py);
        brightness(py, of, &one).map(|()| one)
    });
    found.set_item("brightness", bright.collect::<PyResult<Vec<_>>>()?)?;
    let transforms = s.transforms.iter().map(|t| matrix(py, t)).collect::<PyResult<Vec<_>>>()?;
    found.set_item("transforms", transforms)?;
    found.set_item("region", <[u32; 4]>::from(s.region))?;
    found.set_item("photograph", s.photograph)?;
    found.set_item("focus", field(py, s.focus, size)?)?;
    found.set_item("uncertainty", field(py, s.uncertainty, size)?)?;
    found.set_item("beyond", field(py, s.beyond, size)?)?;
    let (depth, deviation) = s.depth.map(|depth| (depth.depth, depth.deviation)).unzip();
    found.set_item("depth", depth.map(|depth| field(py, depth, size)).transpose()?)?;
    found.set_item("deviation", deviation.map(|deviation| field(py, deviation, size)).transpose()?)?;
    found.set_item("fused", image(py, s.fused, size, s.fused_channels)?)?;
    found.set_item("frame", field(py, s.frames, size)?)?;
    found.set_item("reference", s.reference)?;
    found.set_item("positions", row(py, s.positions))?;
    found.set_item("unit", s.unit)?;
    found.set_item("blur_rate", s.blur_rate)?;
    found.set_item("order", s.order)?;
    found.set_item("decode", decode_name(s.decode))?;
    found.set_item("warnings", s.warnings)?;
    Ok(found)
}
