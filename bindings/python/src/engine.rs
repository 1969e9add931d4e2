//! The class Engine, and the functions on results. Solves run without the interpreter's lock.

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

use crate::convert::{self, array_of, field, frame, homography, image, matrix, row};
use crate::settings::settings as read_settings;
use crate::watch::{CancellationToken, Report, Watch};
use crate::{DeviceError, exception};

/// Interval at which a waiting call tries to lock the engine.
const RETRY: Duration = Duration::from_millis(1);

/// A Vulkan device. Calls from several threads run one after another.
///
/// device: index, part of the name, UUID, "cpu" or "vulkan"; None selects the most capable device.
/// timeout: time limit of one solve, seconds.
#[pyclass(frozen, module = "parfocal")]
pub(crate) struct Engine {
    /// Not used in a forked process, which does not have the driver's threads.
    inner: Option<Mutex<Inner>>,
    name: String,
    process: u32,
}

/// A device as Python names it.
#[derive(FromPyObject)]
pub(crate) enum DeviceName {
    Index(u32),
    Text(String),
}

impl DeviceName {
    pub(crate) fn text(self) -> String {
        match self {
            Self::Index(index) => index.to_string(),
            Self::Text(text) => text,
        }
    }
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
    fn new(py: Python<'_>, device: Option<DeviceName>, timeout: f64, validation: bool) -> PyResult<Self> {
        let device = device.map(DeviceName::text);
        let options = EngineOptions { device, validation, timeout: time_limit(timeout)?, ..EngineOptions::default() };
        let engine = py.detach(|| parfocal::Engine::new(&options)).map_err(exception)?;
        let name = engine.info().name.clone();
        let inner = Some(Mutex::new(Inner { engine, solver: None }));
        Ok(Self { inner, name, process: process::id() })
    }

    /// The name of the device.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// The messages of the validation layer so far.
    #[getter]
    fn messages(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |inner| Ok(inner.engine.validation_messages()))
    }

    fn __repr__(&self) -> String {
        format!("<parfocal.Engine on {}>", self.name)
    }

    /// Solves a pair. Returns a dictionary of the result.
    #[allow(clippy::too_many_arguments, reason = "they are keyword arguments of Python")]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        settings: &Bound<'py, PyDict>,
        region: Option<[u32; 4]>,
        mask: Option<&Bound<'py, PyAny>>,
        crop_valid: bool,
        progress: Option<Bound<'py, PyAny>>,
        cancel: Option<PyRef<'_, CancellationToken>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (i1, i2) = (frame(i1, "i1")?, frame(i2, "i2")?);
        let settings = read_settings(settings, &[&i1, &i2])?;
        let watch = Watch::new(progress, cancel);
        let (mask, cancel) = (mask.map(convert::mask).transpose()?, watch.cancel.clone());
        let options =
            SolveOptions { region: region.map(convert::region), mask, crop_valid, cancel, ..SolveOptions::default() };
        let solved = self.run(py, &watch, |inner, report| {
            let options = SolveOptions { progress: Some(report), ..options };
            inner.solver(&settings)?.solve([&i1, &i2], &options)
        })?;
        of_solution(py, solved, &settings)
    }

    /// Registers a pair. Returns a dictionary of the result.
    fn register<'py>(
        &self,
        py: Python<'py>,
        i1: &Bound<'py, PyAny>,
        i2: &Bound<'py, PyAny>,
        settings: &Bound<'py, PyDict>,
        progress: Option<Bound<'py, PyAny>>,
        cancel: Option<PyRef<'_, CancellationToken>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (i1, i2) = (frame(i1, "i1")?, frame(i2, "i2")?);
        let settings = read_settings(settings, &[&i1, &i2])?;
        let watch = Watch::new(progress, cancel);
        let cancel = watch.cancel.clone();
        let registered = self.run(py, &watch, |inner, report| {
            let options = SolveOptions { cancel, progress: Some(report), ..SolveOptions::default() };
            inner.solver(&settings)?.register([&i1, &i2], &options)
        })?;
        of_registration(py, &registered, &settings)
    }

    /// Solves a focus sweep. Returns a dictionary of the result.
    #[allow(clippy::too_many_arguments, reason = "they are keyword arguments of Python")]
    fn stack<'py>(
        &self,
        py: Python<'py>,
        frames: Vec<Bound<'py, PyAny>>,
        settings: &Bound<'py, PyDict>,
        positions: Option<Vec<f64>>,
        unit: &str,
        reference: Option<usize>,
        region: Option<[u32; 4]>,
        mask: Option<&Bound<'py, PyAny>>,
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
            _ => return Err(PyValueError::new_err(format!("unit='{unit}': give settings, distances or stage"))),
        };
        let settings = read_settings(settings, &frames.iter().collect::<Vec<_>>())?;
        let watch = Watch::new(progress, cancel);
        let (mask, cancel) = (mask.map(convert::mask).transpose()?, watch.cancel.clone());
        let options = SolveOptions { region: region.map(convert::region), mask, cancel, ..SolveOptions::default() };
        let sweep = self.run(py, &watch, |inner, report| {
            let options = SolveOptions { progress: Some(report), ..options };
            SweepSolver::new(&inner.engine, &SweepOptions { settings, positions, reference })?.solve(&frames, &options)
        })?;
        of_sweep(py, sweep)
    }
}

impl Engine {
    /// Runs a function on the engine without the interpreter's lock.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        run: impl FnOnce(&mut Inner) -> Result<T, parfocal::Error> + Send,
    ) -> PyResult<T> {
        let inner = self.inner.as_ref().filter(|_| self.process == process::id()).ok_or_else(forked)?;
        py.detach(|| run(&mut inner.lock().unwrap_or_else(PoisonError::into_inner))).map_err(exception)
    }

    /// Runs a solve with progress and cancellation, without the interpreter's lock.
    fn run<'py, T: Send>(
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
                    // Another thread solves. This call may be cancelled while it waits.
                    Err(TryLockError::WouldBlock) if cancel.is_cancelled() => return Err(parfocal::Error::Cancelled),
                    Err(TryLockError::WouldBlock) => thread::sleep(RETRY),
                }
            };
            run(&mut inner, report)
        })
    }
}

impl Inner {
    /// Returns the solver with these settings, made on the first call.
    fn solver(&mut self, settings: &Settings) -> Result<&mut PairSolver, parfocal::Error> {
        let mut solver = match self.solver.take() {
            Some(solver) => solver,
            None => PairSolver::new(&self.engine, settings)?,
        };
        solver.set_settings(settings)?;
        Ok(self.solver.insert(solver))
    }
}

/// Converts the time limit of a solve.
pub(crate) fn time_limit(seconds: f64) -> PyResult<Duration> {
    let timeout = Duration::try_from_secs_f64(seconds).ok().filter(|timeout| !timeout.is_zero());
    timeout.ok_or_else(|| PyValueError::new_err("timeout: give a number of seconds above 0"))
}

/// The error of a call in a forked process.
pub(crate) fn forked() -> PyErr {
    DeviceError::new_err(
        "this process was forked after the engine was opened, and cannot use the device: use multiprocessing's start \
         method 'spawn' or 'forkserver', or open the first engine in the child",
    )
}

/// Lists the devices: name, and the reason if the device is unusable.
#[pyfunction]
pub(crate) fn devices(py: Python<'_>) -> PyResult<Vec<(String, Option<String>)>> {
    let devices = py.detach(parfocal::Engine::devices).map_err(exception)?;
    Ok(devices.into_iter().map(|device| (device.name, device.unusable)).collect())
}

/// Resamples another photograph onto the pixels of results.
///
/// brightness: gain, offset, shading coefficients, and the region of the shading. region: the part to return.
#[pyfunction]
pub(crate) fn apply(
    py: Python<'_>,
    image: &Bound<'_, PyAny>,
    transform: [[f64; 3]; 3],
    brightness: Option<(f64, f64, Vec<f64>, [u32; 4])>,
    decode: &str,
    region: [u32; 4],
) -> PyResult<Py<PyAny>> {
    let (frame, transform) = (frame(image, "image")?, homography(transform)?);
    let brightness = match brightness {
        None => Brightness::identity([frame.width(), frame.height()]),
        Some((gain, offset, coefficients, shading_region)) => {
            let coefficients = <[f64; Shading::TERMS]>::try_from(coefficients).map_err(|c| {
                PyValueError::new_err(format!("shading has {} coefficients: give {}", c.len(), Shading::TERMS))
            })?;
            Brightness {
                photometric: Photometric { gain, offset },
                shading: Shading { coefficients },
                part: convert::region(shading_region),
            }
        }
    };
    let decode = if decode == "srgb" { Decode::Srgb } else { Decode::None };
    let part = convert::region(region);
    let resampled = py.detach(|| resample::registered(&frame, &transform, &brightness, decode).cropped(part));
    array_of(py, &resampled.map_err(PyValueError::new_err)?)
}

/// The optics of a lens: focal length in mm, f-number, pixel pitch in mm.
type Optics = (f64, f64, f64);

/// Raises ValueError for a lens that cannot exist.
#[pyfunction]
pub(crate) fn check_lens(optics: Optics, focus: [f64; 2], kappa: f64, telecentric: bool) -> PyResult<()> {
    lens(optics, focus, kappa, telecentric).map(drop)
}

fn lens(
    (focal_length, f_number, pixel_pitch): Optics,
    focus: [f64; 2],
    kappa: f64,
    telecentric: bool,
) -> PyResult<Lens> {
    let lens = Lens { focal_length, f_number, pixel_pitch, focus, kappa, telecentric, field: None };
    lens.check().map(|()| lens).map_err(exception)
}

/// Depth and its standard deviation, mm; number of pixels out of range; a warning about the lens.
type Depth = (Py<PyAny>, Py<PyAny>, usize, Option<String>);

/// Computes depth, mm, through a lens.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "they are keyword arguments of Python")]
pub(crate) fn depth(
    py: Python<'_>,
    blur: PyReadonlyArray2<'_, f32>,
    uncertainty: PyReadonlyArray2<'_, f32>,
    scale: f64,
    limit: f64,
    optics: Optics,
    focus: [f64; 2],
    kappa: f64,
    telecentric: bool,
) -> PyResult<Depth> {
    let lens = lens(optics, focus, kappa, telecentric)?;
    let [blur, sigma] = [blur, uncertainty].map(|field| field.as_array().to_owned());
    if blur.dim() != sigma.dim() {
        return Err(PyValueError::new_err("relative blur and uncertainty differ in shape"));
    }
    let size = [blur.ncols() as u32, blur.nrows() as u32];
    let (blur, sigma): (Vec<f32>, Vec<f32>) = (blur.into_iter().collect(), sigma.into_iter().collect());
    let (metric, warning) = py.detach(|| {
        let metric = MetricDepth::new(&lens, scale, limit, size[0], &blur, &sigma);
        let warning = metric.doubt(scale, limit, &blur);
        (metric, warning)
    });
    Ok((field(py, metric.depth, size)?, field(py, metric.deviation, size)?, metric.out_of_range, warning))
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
    let (result, size, channels) = (PyDict::new(py), [s.width, s.height], s.fused_channels);
    result.set_item("relative_blur", field(py, s.relative_blur, size)?)?;
    result.set_item("uncertainty", field(py, s.uncertainty, size)?)?;
    result.set_item("confidence", field(py, s.confidence, size)?)?;
    result.set_item("residual", field(py, s.residual, size)?)?;
    let fused = settings.fused.then(|| image(py, s.fused, size, channels)).transpose()?;
    result.set_item("fused", fused)?;
    let s = s.findings;
    brightness(py, &s.brightness(), &result)?;
    result.set_item("region", <[u32; 4]>::from(s.region()))?;
    result.set_item("transform", matrix(py, &s.transform)?)?;
    result.set_item("scale", s.transform.scale())?;
    result.set_item("photograph", s.photograph)?;
    result.set_item("regularization", s.regularization)?;
    result.set_item("kernel_shape", s.kernel_shape)?;
    result.set_item("separation", s.separation)?;
    result.set_item("parallax", s.parallax.numbers())?;
    result.set_item("parallax_deviation", s.parallax_deviation.numbers())?;
    result.set_item("scale_deviation", s.scale_deviation)?;
    let deviation = s.transform_deviation.map(|deviation| (deviation.corner_px, deviation.direction_deg));
    result.set_item("transform_deviation", deviation)?;
    result.set_item("other_motion", s.other_motion.map(|other| other.to_string()))?;
    result.set_item("levels", levels(py, &s.levels)?)?;
    result.set_item("clipped_fractions", s.clipped_fractions)?;
    result.set_item("converged", s.converged)?;
    result.set_item("warnings", s.warnings)?;
    result.set_item("valid_fraction", s.valid_fraction)?;
    result.set_item("mean_confidence", s.mean_confidence)?;
    result.set_item("saturated_fraction", s.saturated_fraction)?;
    result.set_item("unsettled_fraction", s.unsettled_fraction)?;
    result.set_item("unexplained_fraction", s.unexplained_fraction)?;
    result.set_item("noise", s.noise)?;
    result.set_item("max_relative_blur", s.max_relative_blur)?;
    result.set_item("decode", decode_name(settings.decode))?;
    result.set_item("total_ms", s.timings.total_ms)?;
    result.set_item("gpu_ms", s.timings.gpu_ms)?;
    Ok(result)
}

fn of_registration<'py>(py: Python<'py>, r: &Registered, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
    let result = PyDict::new(py);
    brightness(py, &r.brightness(), &result)?;
    result.set_item("region", [0, 0, r.width, r.height])?;
    result.set_item("photograph", [r.width, r.height])?;
    result.set_item("transform", matrix(py, &r.transform)?)?;
    result.set_item("other_motion", r.other_motion.map(|other| other.to_string()))?;
    result.set_item("levels", levels(py, &r.levels)?)?;
    result.set_item("clipped_fractions", r.clipped_fractions)?;
    result.set_item("converged", r.converged)?;
    result.set_item("warnings", r.warnings.clone())?;
    result.set_item("decode", decode_name(settings.decode))?;
    result.set_item("total_ms", r.timings.total_ms)?;
    result.set_item("gpu_ms", r.timings.gpu_ms)?;
    Ok(result)
}

fn of_sweep(py: Python<'_>, s: Sweep) -> PyResult<Bound<'_, PyDict>> {
    let (result, size) = (PyDict::new(py), [s.width, s.height]);
    let bright = s.brightness.iter().map(|of| {
        let one = PyDict::new(py);
        brightness(py, of, &one).map(|()| one)
    });
    result.set_item("brightness", bright.collect::<PyResult<Vec<_>>>()?)?;
    let transforms = s.transforms.iter().map(|t| matrix(py, t)).collect::<PyResult<Vec<_>>>()?;
    result.set_item("transforms", transforms)?;
    result.set_item("parallax", s.parallax.clone())?;
    result.set_item("region", <[u32; 4]>::from(s.region))?;
    result.set_item("photograph", s.photograph)?;
    result.set_item("focus", field(py, s.focus, size)?)?;
    result.set_item("uncertainty", field(py, s.uncertainty, size)?)?;
    result.set_item("beyond", field(py, s.beyond, size)?)?;
    let (depth, deviation) = s.depth.map(|depth| (depth.depth, depth.deviation)).unzip();
    result.set_item("depth", depth.map(|depth| field(py, depth, size)).transpose()?)?;
    result.set_item("deviation", deviation.map(|deviation| field(py, deviation, size)).transpose()?)?;
    result.set_item("fused", image(py, s.fused, size, s.fused_channels)?)?;
    result.set_item("frame", field(py, s.frames, size)?)?;
    result.set_item("unit", s.unit)?;
    let registration = s.registration;
    result.set_item("reference", registration.reference)?;
    result.set_item("positions", row(py, registration.positions))?;
    result.set_item("blur_rate", registration.blur_rate)?;
    result.set_item("clipped_fractions", registration.clipped_fractions.clone())?;
    result.set_item("order", registration.order)?;
    result.set_item("decode", decode_name(registration.decode))?;
    result.set_item("warnings", registration.warnings)?;
    Ok(result)
}
