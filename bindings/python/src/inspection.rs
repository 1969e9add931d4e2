//! Inspection of parts against a golden part, and what good parts teach.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use parfocal::export::{InspectReport, InspectedPart, to_json};
use parfocal::metric::inspect::golden::{disagreement, golden, least_tolerances, suggestion};
use parfocal::metric::inspect::{Heights, Limits};
use parfocal::transform::Similarity;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::field;
use crate::exception;

/// A height map: `parfocal.inspection.Part`, or the golden part.
#[derive(FromPyObject)]
pub(crate) struct Map<'py> {
    values: PyReadonlyArray2<'py, f32>,
    deviation: PyReadonlyArray2<'py, f32>,
    part_deviation: PyReadonlyArray2<'py, f32>,
    evidence: PyReadonlyArray2<'py, f32>,
    spread: f32,
}

/// `parfocal.inspection.Limits`.
#[derive(FromPyObject)]
pub(crate) struct Bounds {
    sigmas: f64,
    min_area: usize,
    max_unjudged: f64,
    max_tilt: Option<f64>,
}

impl Map<'_> {
    /// Copies the map, so that other Python threads may run meanwhile.
    fn heights(&self) -> PyResult<Heights> {
        let side = |n: usize| u32::try_from(n).map_err(|_| PyValueError::new_err("the map is too large"));
        let size = [side(self.values.shape()[1])?, side(self.values.shape()[0])?];
        let copied = |field: &PyReadonlyArray2<'_, f32>| field.as_array().iter().copied().collect::<Vec<_>>();
        let heights = Heights::new(size, &copied(&self.values), &copied(&self.deviation)).map_err(exception)?;
        let heights = heights.with_part_deviation(copied(&self.part_deviation)).map_err(exception)?;
        let heights = heights.with_evidence(copied(&self.evidence)).map_err(exception)?;
        Ok(Heights { spread: self.spread, ..heights })
    }
}

impl Bounds {
    fn limits(&self, tolerance: f64) -> Limits {
        let default = Limits::new(tolerance);
        let max_tilt = self.max_tilt.unwrap_or(default.max_tilt);
        let Self { sigmas, min_area: min_area_px, max_unjudged, .. } = *self;
        Limits { sigmas, min_area_px, max_unjudged, max_tilt, ..default }
    }
}

/// Returns the evidence for heights, from a grey picture and the residual.
#[pyfunction]
pub(crate) fn evidence(
    py: Python<'_>,
    picture: PyReadonlyArray2<'_, f32>,
    residual: PyReadonlyArray2<'_, f32>,
) -> PyResult<Py<PyAny>> {
    let copied = |field: &PyReadonlyArray2<'_, f32>| field.as_array().iter().copied().collect::<Vec<_>>();
    let (width, height) = (picture.shape()[1] as u32, picture.shape()[0] as u32);
    let (picture, residual) = (copied(&picture), copied(&residual));
    let found = py.detach(|| Heights::new([width, height], &residual, &residual)?.with_picture(&picture, &residual));
    field(py, found.map_err(exception)?.evidence, [width, height])
}

/// The fields of a golden part, its spread, its tolerance, the least tolerance of each part, and the part that disagrees
/// with the others: its index, the place and the extreme.
type Taught = ([Py<PyAny>; 4], f32, f64, Vec<f64>, Option<(usize, [f64; 2], f64)>);

/// Teaches a golden part from good parts. Without a tolerance the suggested one is taken.
#[pyfunction]
pub(crate) fn teach(py: Python<'_>, parts: Vec<Map<'_>>, bounds: Bounds, tolerance: Option<f64>) -> PyResult<Taught> {
    let maps = parts.iter().map(Map::heights).collect::<PyResult<Vec<_>>>()?;
    let found = py.detach(|| {
        let least = least_tolerances(&maps, &bounds.limits(0.0))?;
        let suggested = suggestion(&least);
        let least: Vec<f64> = least.iter().map(|least| least.tolerance).collect();
        let doubtful = suggested.doubtful.filter(|_| tolerance.is_none());
        let tolerance = tolerance.unwrap_or(suggested.tolerance);
        let limits = |tolerance: f64| Limits { max_tilt: f64::INFINITY, ..bounds.limits(tolerance) };
        let mut disagreeing = None;
        for at in doubtful.into_iter().chain([tolerance]).filter(|at| at.is_finite()) {
            disagreeing = disagreeing.or(disagreement(&maps, &limits(at))?);
        }
        Ok::<_, parfocal::Error>((golden(&maps, &limits(tolerance))?, tolerance, least, disagreeing))
    });
    let (golden, tolerance, least, disagreeing) = found.map_err(exception)?;
    let (size, spread) = ([golden.width, golden.height], golden.spread);
    let array = |values: Vec<f32>| field(py, values, size);
    let fields =
        [array(golden.values)?, array(golden.deviation)?, array(golden.part_deviation)?, array(golden.evidence)?];
    let disagreeing = disagreeing.map(|found| (found.part, found.deviation.centroid_px, found.deviation.extreme));
    Ok((fields, spread, tolerance, least, disagreeing))
}

/// Inspects a part. Returns the report as JSON and the differences. With `faults` the part cannot be judged.
#[pyfunction]
pub(crate) fn inspect(
    py: Python<'_>,
    maps: [Map<'_>; 2],
    bounds: Bounds,
    tolerance: f64,
    label: [String; 2],
    faults: Vec<String>,
) -> PyResult<(String, Py<PyAny>)> {
    let ([part, golden], [serial, time]) = (maps, label);
    let (part, golden, limits) = (part.heights()?, golden.heights()?, bounds.limits(tolerance));
    let size = [golden.width, golden.height];
    let found = py.detach(|| parfocal::metric::inspect::inspect(&part, &golden, &limits)).map_err(exception)?;
    let label = InspectedPart { part: String::new(), serial, time };
    let report = InspectReport::new(
        (label, &[]),
        ("heights", ""),
        (limits, Similarity::IDENTITY, &[]),
        (&found, size),
        [faults, Vec::new()],
    );
    let json = to_json(&report).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok((json, field(py, found.difference, size)?))
}
