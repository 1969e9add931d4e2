//! Photographs in files and buffers to arrays, by the reader of the program.

use std::path::PathBuf;

use parfocal::PixelFormat;
use parfocal::image_io::{self, RawFormat};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::array_of;
use crate::raised;

/// A photograph as an array.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf) -> PyResult<Py<PyAny>> {
    let frame = py.detach(|| image_io::read(&path)).map_err(raised)?;
    array_of(py, &frame)
}

/// A frame of a camera as an array; the format with the size, as in `Mono12p:2448x2048`.
#[pyfunction]
pub(crate) fn unpack(py: Python<'_>, data: &[u8], format: &str) -> PyResult<Py<PyAny>> {
    let unpacked = py.detach(|| format.parse().and_then(|format: RawFormat| format.frame(data)));
    array_of(py, &unpacked.map_err(|problem| PyValueError::new_err(format!("the frame: {problem}")))?)
}

/// The name of a number of GenICam's Pixel Format Naming Convention.
#[pyfunction]
pub(crate) fn format_name(code: u32) -> Option<String> {
    PixelFormat::from_code(code).map(|format| format.to_string())
}
