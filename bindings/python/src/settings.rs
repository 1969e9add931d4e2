//! Settings by their names in `docs/method.md`, section 8.

use std::fmt::Display;

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use parfocal::{
    Frame, Settings,
    metric::Aperture,
    settings::{Decode, Kernel, Method, Motion, Photometric, RegistrationStep},
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::homography;
use crate::raised;

/// The names of the settings.
#[pyfunction]
pub(crate) fn setting_names() -> Vec<&'static str> {
    Settings::TABLE.iter().map(|setting| setting.name).collect()
}

/// The settings that a call names, for these photographs.
pub(crate) fn settings(named: &Bound<'_, PyDict>, frames: &[&Frame]) -> PyResult<Settings> {
    let mut settings = Settings::default();
    for (name, value) in named {
        let name: String = name.extract()?;
        set(&mut settings, &name, &value).map_err(|e| of_setting(&value, &name, e))?;
    }
    settings.check().map_err(raised)?;
    // Results state how values were read.
    settings.decode = settings.decode.resolved(frames.iter().map(|frame| frame.format().depth));
    Ok(settings)
}

fn set(s: &mut Settings, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    match name {
        "method" => s.method = one_of(value, &[Method::Unified, Method::Aligned, Method::Appearance], |m| m.name())?,
        "levels" => s.levels = auto(value)?,
        "outer_iterations" => s.outer_iterations = value.extract()?,
        "relaxation_sweeps" => s.relaxation_sweeps = value.extract()?,
        "over_relaxation" => s.over_relaxation = value.extract()?,
        "regularization" => s.regularization = auto(value)?,
        "continuation" => s.continuation = value.extract()?,
        "data_eta" => s.data_eta = value.extract()?,
        "smoothness_eta" => s.smoothness_eta = value.extract()?,
        "heaviside_epsilon" => s.heaviside_epsilon = value.extract()?,
        "max_relative_blur" => s.max_relative_blur = value.extract()?,
        "largest_step" => s.largest_step = value.extract()?,
        "kernel" => s.kernel = kernel(value)?,
        "motion" => s.motion = one_of(value, &Motion::ALL, |m| m.name())?,
        "registration_step" => s.registration_step = one_of(value, &RegistrationStep::ALL, |step| step.name())?,
        "photometric" => s.photometric = value.extract()?,
        "fused" => s.fused = value.extract()?,
        "decode" => {
            s.decode = one_of(value, &Decode::ALL, |decode| decode.name())?;
        }
        "black_level" => s.black_level = auto(value)?,
        "white_level" => s.white_level = auto(value)?,
        "start" => s.start = homography(value.extract()?)?,
        "start_photometric" => {
            let [gain, offset] = value.extract()?;
            s.start_photometric = Photometric { gain, offset };
        }
        _ => {
            return Err(PyTypeError::new_err(format!(
                "there is no such setting; there are {}",
                setting_names().join(", ")
            )));
        }
    }
    Ok(())
}

/// Names the setting.
fn of_setting(value: &Bound<'_, PyAny>, name: &str, error: PyErr) -> PyErr {
    let py = value.py();
    let message =
        format!("{name}={}: {}", value.repr().map_or_else(|_| "?".into(), |r| r.to_string()), error.value(py));
    if error.is_instance_of::<PyValueError>(py) {
        PyValueError::new_err(message)
    } else {
        PyTypeError::new_err(message)
    }
}

/// A value, or "auto" or None.
fn auto<'py, T: for<'a> FromPyObject<'a, 'py, Error = PyErr>>(value: &Bound<'py, PyAny>) -> PyResult<Option<T>> {
    let is_auto = value.is_none() || value.extract::<String>().is_ok_and(|word| word == "auto");
    if is_auto { Ok(None) } else { value.extract().map(Some) }
}

fn one_of<T: Clone>(value: &Bound<'_, PyAny>, all: &[T], name: impl Fn(&T) -> &str) -> PyResult<T> {
    let word: String = value.extract()?;
    let found = all.iter().find(|one| name(one) == word).cloned();
    found.ok_or_else(|| PyValueError::new_err(format!("give {}", listed(all.iter().map(name)))))
}

fn listed<'a>(names: impl Iterator<Item = &'a str>) -> impl Display {
    names.collect::<Vec<_>>().join(", ")
}

/// By name, or its values on a grid.
fn kernel(value: &Bound<'_, PyAny>) -> PyResult<Kernel> {
    if let Ok(grid) = value.extract::<PyReadonlyArray2<'_, f64>>() {
        let [height, width] = *grid.shape() else { return Err(PyValueError::new_err("give two dimensions")) };
        let densities: Vec<f64> = grid.as_array().iter().copied().collect();
        return Aperture::new("array", width, height, &densities).map(Kernel::Measured).map_err(raised);
    }
    one_of(value, &Kernel::NAMED, |kernel| kernel.name())
}
