//! Reading photographs from files and camera frames, with the program's reader.

use std::path::{Path, PathBuf};

use parfocal::PixelFormat;
use parfocal::image_io::{self, RawFormat};
use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;

use crate::convert::array_of;
use crate::exception;

/// Reads a photograph as an array.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf) -> PyResult<Py<PyAny>> {
    let frame = py.detach(|| image_io::read(&path)).map_err(|error| {
        // What follows # names a page or a format.
        let is_absent = |path: &Path| path.try_exists().is_ok_and(|exists| !exists);
        let is_missing = is_absent(&path) && is_absent(&image_io::split_page(&path).0);
        if is_missing { PyFileNotFoundError::new_err(error.to_string()) } else { exception(error) }
    })?;
    array_of(py, &frame)
}

/// Unpacks a camera frame. The format includes the size, as in `Mono12p:2448x2048`.
#[pyfunction]
pub(crate) fn unpack(py: Python<'_>, data: &[u8], format: &str) -> PyResult<Py<PyAny>> {
    let unpacked = py.detach(|| format.parse().and_then(|format: RawFormat| format.frame(data)));
    array_of(py, &unpacked.map_err(|problem| PyValueError::new_err(format!("the frame: {problem}")))?)
}

/// Returns the name of a code of the GenICam Pixel Format Naming Convention.
#[pyfunction]
pub(crate) fn format_name(code: u32) -> Option<String> {
    PixelFormat::from_code(code).map(|format| format.to_string())
}
