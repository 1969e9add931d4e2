//! Photographs in files to arrays, by the reader of the program.

use std::path::PathBuf;

use parfocal::image_io;
use pyo3::prelude::*;

use crate::convert::array_of;
use crate::raised;

/// A photograph as an array.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf) -> PyResult<Py<PyAny>> {
    let frame = py.detach(|| image_io::read(&path)).map_err(raised)?;
    array_of(py, &frame)
}
