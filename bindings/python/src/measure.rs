//! Levels, steps and profiles of a field; surface texture; repeated measurements.

use std::fmt::Display;

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use parfocal::Region;
use parfocal::export::to_json;
use parfocal::metric::Estimate;
use parfocal::metric::inspect::Heights;
use parfocal::metric::measure::{Line, Values};
use parfocal::metric::repeat::{Repeatability, Study, TypeOne, repeated_maps};
use parfocal::metric::roughness::{Area, Evaluation, Form, Roughness, roughness};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::{mask, region, row};
use crate::exception;

type Field<'py> = PyReadonlyArray2<'py, f32>;

/// Copies a field, so that other Python threads may run meanwhile. Returns its width and values.
fn copied(values: &Field<'_>) -> PyResult<(u32, Vec<f32>)> {
    let width = u32::try_from(values.shape()[1]).map_err(|_| PyValueError::new_err("the field is too wide"))?;
    Ok((width, values.as_array().iter().copied().collect()))
}

fn pair(estimate: Option<Estimate>) -> Option<(f64, f64)> {
    estimate.map(|estimate| (estimate.value, estimate.standard_error))
}

/// Returns value and standard error of a region's level.
#[pyfunction]
pub(crate) fn level(py: Python<'_>, values: Field<'_>, of: [u32; 4]) -> PyResult<Option<(f64, f64)>> {
    let (width, values) = copied(&values)?;
    py.detach(|| Values { width, values: &values }.level(region(of))).map(pair).map_err(exception)
}

/// Returns value and standard error of a step from one region to another.
#[pyfunction]
pub(crate) fn step(py: Python<'_>, values: Field<'_>, from: [u32; 4], to: [u32; 4]) -> PyResult<Option<(f64, f64)>> {
    let (width, values) = copied(&values)?;
    py.detach(|| Values { width, values: &values }.step(region(from), region(to))).map(pair).map_err(exception)
}

/// Returns the values along a line.
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
    py.detach(|| Values { width, values: &values }.profile(&line)).map(|values| row(py, values)).map_err(exception)
}

/// Copies a height map.
fn heights(values: &Field<'_>, deviation: &Field<'_>) -> PyResult<Heights> {
    let ((width, values), (_, deviation)) = (copied(values)?, copied(deviation)?);
    let height = u32::try_from(values.len() / width.max(1) as usize);
    let height = height.map_err(|_| PyValueError::new_err("the field is too high"))?;
    Heights::new([width, height], &values, &deviation).map_err(exception)
}

/// The region that is evaluated, of a map of this size.
fn part(of: Option<[u32; 4]>, map: &Heights) -> Region {
    of.map_or(Region { x: 0, y: 0, width: map.width, height: map.height }, region)
}

fn form(name: &str) -> PyResult<Form> {
    Ok(match name {
        "none" => Form::None,
        "plane" => Form::Plane,
        "quadric" => Form::Quadric,
        "cylinder" => Form::Cylinder,
        _ => {
            let forms = "none, plane, quadric or cylinder";
            return Err(PyValueError::new_err(format!("form {name:?} is not known: give {forms}")));
        }
    })
}

fn text<E: Display>(json: Result<String, E>) -> PyResult<String> {
    json.map_err(|e| PyValueError::new_err(e.to_string()))
}

/// A parameter: its symbol, value, standard deviation, the parts of it by noise and by scale, and the bias by noise.
type ParameterRow = (&'static str, f64, f64, f64, Option<f64>, f64);

/// The counts of a texture (area, measured, profiles, sections), whether Str is a bound, and the parameters.
type Texture = ([usize; 4], bool, Vec<ParameterRow>);

/// Filters, the line of the profile parameters, and noise.
#[derive(FromPyObject)]
pub(crate) struct Options<'py> {
    form: String,
    s_filter: Option<f64>,
    l_filter: Option<f64>,
    robust: bool,
    region: Option<[u32; 4]>,
    mask: Option<Bound<'py, PyAny>>,
    line: Option<([f64; 2], [f64; 2], f64)>,
    pixel_size: Option<f64>,
    realizations: usize,
    noise_window: f64,
}

/// Returns the surface texture of a height map.
#[pyfunction]
pub(crate) fn texture(
    py: Python<'_>,
    values: Field<'_>,
    deviation: Field<'_>,
    common: Option<Field<'_>>,
    options: Options<'_>,
) -> PyResult<Texture> {
    let mut map = heights(&values, &deviation)?;
    let common = common.map(|common| Ok::<_, PyErr>(copied(&common)?.1)).transpose()?;
    if let Some(common) = &common {
        map = map.without_common(common).map_err(exception)?;
    }
    let mask = options.mask.as_ref().map(mask).transpose()?;
    let evaluation = Evaluation {
        form: form(&options.form)?,
        s_filter_px: options.s_filter,
        l_filter_px: options.l_filter,
        robust: options.robust,
        line: options.line.map(|(from, to, width)| Line { from, to, width }),
        realizations: options.realizations,
        noise_window_px: options.noise_window,
        pixel_size: options.pixel_size,
    };
    let region = part(options.region, &map);
    let found = py.detach(|| {
        let area = Area { region, mask: mask.as_ref() };
        roughness(&map, common.as_deref(), &area, &evaluation)
    });
    let Roughness { area_px, measured_px, profiles, sections, is_str_bound, parameters } = found.map_err(exception)?;
    let rows = parameters.iter().map(|p| (p.name, p.value, p.standard_deviation, p.by_noise, p.by_scale, p.noise_bias));
    Ok(([area_px, measured_px, profiles, sections], is_str_bound, rows.collect()))
}

/// Returns the comparison of repeated height maps, as JSON.
#[pyfunction]
pub(crate) fn repeated(
    py: Python<'_>,
    maps: Vec<(Field<'_>, Field<'_>)>,
    form_name: &str,
    region: Option<[u32; 4]>,
    within: Option<Bound<'_, PyAny>>,
) -> PyResult<String> {
    let maps = maps.iter().map(|(values, deviation)| heights(values, deviation)).collect::<PyResult<Vec<_>>>()?;
    let first = maps.first().ok_or_else(|| PyValueError::new_err("give two height maps or more"))?;
    let (region, form, mask) = (part(region, first), form(form_name)?, within.as_ref().map(mask).transpose()?);
    let found = py.detach(|| repeated_maps(&maps, &Area { region, mask: mask.as_ref() }, form));
    text(to_json(&found.map_err(exception)?))
}

/// Refuses a tolerance that has no width.
fn check_width(width: f64) -> PyResult<()> {
    if width.is_finite() && width > 0.0 {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("tolerance_width is {width}: give a number above 0")))
}

/// Returns the scatter of readings, and with a true value and the width of the tolerance their type-1 study, as JSON.
#[pyfunction]
pub(crate) fn readings(values: Vec<f64>, stated: Option<(f64, f64)>) -> PyResult<(String, Option<String>)> {
    stated.map_or(Ok(()), |(_, width)| check_width(width))?;
    let found = Repeatability::of(&values)
        .ok_or_else(|| PyValueError::new_err("give two readings or more, all of them finite"))?;
    let study =
        stated.map(|(true_value, width)| text(to_json(&TypeOne::new(&found, true_value, width)))).transpose()?;
    Ok((text(to_json(&found))?, study))
}

/// Returns a gauge study, as JSON.
#[pyfunction]
pub(crate) fn gauge(counts: [usize; 3], readings: Vec<f64>, tolerance_width: Option<f64>) -> PyResult<String> {
    tolerance_width.map_or(Ok(()), check_width)?;
    let [operators, parts, trials] = counts;
    let found = Study { operators, parts, trials, readings }.analyse(tolerance_width);
    text(to_json(&found.map_err(exception)?))
}
