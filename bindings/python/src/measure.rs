//! Levels, steps and profiles of a field.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use parfocal::metric::Estimate;
use parfocal::metric::measure::{Line, Values};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::{region, row};
use crate::raised;

type Field<'py> = PyReadonlyArray2<'py, f32>;

/// Its width, and the values, copied so that the interpreter may go on meanwhile.
fn copied(values: &Field<'_>) -> PyResult<(u32, Vec<f32>)> {
    let width = u32::try_from(values.shape()[1]).map_err(|_| PyValueError::new_err("the field is too wide"))?;
    Ok((width, values.as_array().iter().copied().collect()))
}

fn pair(estimate: Option<Estimate>) -> Option<(f64, f64)> {
    estimate.map(|estimate| (estimate.value, estimate.standard_error))
}

/// Value and standard error of a region's level.
#[pyfunction]
pub(crate) fn level(py: Python<'_>, values: Field<'_>, of: [u32; 4]) -> PyResult<Option<(f64, f64)>> {
    let (width, values) = copied(&values)?;
    py.detach(|| Values { width, values: &values }.level(region(of))).map(pair).map_err(raised)
}

/// Value and standard error of a step from one region to another.
#[pyfunction]
pub(crate) fn step(py: Python<'_>, values: Field<'_>, from: [u32; 4], to: [u32; 4]) -> PyResult<Option<(f64, f64)>> {
    let (width, values) = copied(&values)?;
    py.detach(|| Values { width, values: &values }.step(region(from), region(to))).map(pair).map_err(raised)
}

/// Values along a line.
#[pyfunction]
pub(crate) fn profile(
    py: Python<'_>,
    values: Field<'_>,
    start: [f64; 2],
    end: [f64; 2],
    across: f64,
) -> PyResult<Py<PyAny>> {
    let (width, values) = copied(&values)?;
    let line = Line { from: start, to: end, width: across };
    py.detach(|| Values { width, values: &values }.profile(&line)).map(|found| row(py, found)).map_err(raised)
}
