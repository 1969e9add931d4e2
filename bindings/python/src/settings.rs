//! Settings from Python keywords, with the names of `docs/method.md`, section 8.

use std::fmt::Display;

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use parfocal::{
    Frame, Settings,
    metric::Aperture,
    settings::{Decode, Kernel, Method, Motion, ParallaxSearch, Photometric, RegistrationStep},
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::homography;
use crate::exception;

/// Name, default, unit and range, and description of each setting, for the documentation of the package.
#[pyfunction]
pub(crate) fn setting_table() -> Vec<(&'static str, String, String, &'static str)> {
    let rows = Settings::TABLE.iter().map(|setting| {
        let range = setting.range.map(|[low, high]| format!("{low} to {high}"));
        let unit = Some(setting.unit.to_string()).filter(|unit| !unit.is_empty());
        let limits: Vec<String> = unit.into_iter().chain(range).collect();
        (setting.name, (setting.default)(), limits.join(", "), setting.doc)
    });
    rows.collect()
}

/// Reads the settings of a call and resolves `decode` for these photographs.
pub(crate) fn settings(named: &Bound<'_, PyDict>, frames: &[&Frame]) -> PyResult<Settings> {
    let mut settings = Settings::default();
    for (name, value) in named {
        let name: String = name.extract()?;
        set(&mut settings, &name, &value).map_err(|e| with_setting(&value, &name, e))?;
    }
    settings.check().map_err(exception)?;
    // Results state how values were decoded.
    settings.decode = settings.decode.resolved(frames.iter().map(|frame| frame.format().depth));
    Ok(settings)
}

fn set(s: &mut Settings, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    match name {
        "method" => s.method = one_of(value, &[Method::Unified, Method::Aligned, Method::Appearance], |m| m.name())?,
        "kernel" => s.kernel = kernel(value)?,
        "motion" => s.motion = one_of(value, &Motion::ALL, |m| m.name())?,
        "parallax" => s.parallax = one_of(value, &ParallaxSearch::ALL, |search| search.name())?,
        "registration_step" => s.registration_step = one_of(value, &RegistrationStep::ALL, |step| step.name())?,
        "decode" => {
            s.decode = one_of(value, &Decode::ALL, |decode| decode.name())?;
        }
        "start" => s.start = homography(value.extract()?)?,
        "start_photometric" => {
            let [gain, offset] = value.extract()?;
            s.start_photometric = Photometric { gain, offset };
        }
        _ => set_plain(s, name, value)?,
    }
    Ok(())
}

/// Adds the setting's name and value to an error.
fn with_setting(value: &Bound<'_, PyAny>, name: &str, error: PyErr) -> PyErr {
    let py = value.py();
    let message =
        format!("{name}={}: {}", value.repr().map_or_else(|_| "?".into(), |r| r.to_string()), error.value(py));
    if error.is_instance_of::<PyValueError>(py) {
        PyValueError::new_err(message)
    } else {
        PyTypeError::new_err(message)
    }
}

/// Sets a number or a bool through the table of settings. None stands for "auto".
fn set_plain(s: &mut Settings, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let Some(setting) = Settings::TABLE.iter().find(|setting| setting.name == name) else {
        return Err(PyTypeError::new_err("there is no such setting"));
    };
    let text = match value.extract::<bool>() {
        Ok(flag) => flag.to_string(),
        Err(_) if value.is_none() => "auto".to_string(),
        Err(_) => value.str()?.to_string(),
    };
    if s.set(name, &text) {
        return Ok(());
    }
    Err(PyTypeError::new_err(match (setting.range, (setting.default)().as_str()) {
        (None, _) => "give True or False",
        (Some(_), "auto") => "give a number or auto",
        (Some(_), _) => "give a number, whole for a count",
    }))
}

fn one_of<T: Clone>(value: &Bound<'_, PyAny>, all: &[T], name: impl Fn(&T) -> &str) -> PyResult<T> {
    let word: String = value.extract()?;
    let value = all.iter().find(|one| name(one) == word).cloned();
    value.ok_or_else(|| PyValueError::new_err(format!("give {}", listed(all.iter().map(name)))))
}

fn listed<'a>(names: impl Iterator<Item = &'a str>) -> impl Display {
    names.collect::<Vec<_>>().join(", ")
}

/// Reads a kernel: a name, or its samples as an array.
fn kernel(value: &Bound<'_, PyAny>) -> PyResult<Kernel> {
    if let Ok(grid) = value.extract::<PyReadonlyArray2<'_, f64>>() {
        let [height, width] = *grid.shape() else {
            return Err(PyValueError::new_err("give an array of two dimensions"));
        };
        let densities: Vec<f64> = grid.as_array().iter().copied().collect();
        return Aperture::new("array", width, height, &densities).map(Kernel::Measured).map_err(exception);
    }
    one_of(value, &Kernel::NAMED, |kernel| kernel.name())
}
