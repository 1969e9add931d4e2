//! Step heights and profiles of a field.

use parfocal::metric::measure::{Line, Values};

use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{slice, slice_mut};
use crate::solution::check_count;
use crate::solver::parfocal_region;

/// A value and its standard error; both are NaN if too few pixels are valid.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_estimate {
    /// The value, in the unit of the field.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// Measures a step in a field of width x height values: the level of region `to` minus that of `from`, in the unit of the
/// field. A level is the median after removing the region's tilt.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_measure_step(
    values: *const f32,
    width: u32,
    height: u32,
    from: parfocal_region,
    to: parfocal_region,
    estimate: *mut parfocal_estimate,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (values, out) = unsafe { (field(values, width, height)?, slice_mut(estimate, 1, "estimate")?) };
        let step = values.step(from.into(), to.into())?;
        let (value, standard_error) = step.map_or((f64::NAN, f64::NAN), |step| (step.value, step.standard_error));
        out[0] = parfocal_estimate { value, standard_error };
        Ok(())
    })
}

/// Returns the number of values of a profile along a line, at most 1 px apart, both ends included. 0 if the line is shorter
/// than 1 px.
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_profile_length(x1: f64, y1: f64, x2: f64, y2: f64) -> usize {
    let length = (x2 - x1).hypot(y2 - y1);
    // No image is wider than 1e7 px.
    if (1.0..1e7).contains(&length) { length.ceil() as usize + 1 } else { 0 }
}

/// Samples a field along a line between two points in px. Each value is the mean over `across` px across the line; NaN if no
/// pixel is valid. count must be parfocal_profile_length of the line.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_measure_profile(
    values: *const f32,
    width: u32,
    height: u32,
    x1: f64,
    y1: f64,
    x2: f64,
    y2: f64,
    across: f64,
    profile: *mut f64,
    count: usize,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let values = unsafe { field(values, width, height) }?;
        let sampled = values.profile(&Line { from: [x1, y1], to: [x2, y2], width: across })?;
        check_count("profile", count, sampled.len())?;
        // SAFETY: by the C contract `profile` has room for `count` values.
        unsafe { slice_mut(profile, count, "profile") }?.copy_from_slice(&sampled);
        Ok(())
    })
}

/// Returns the number of pixels of a field.
pub(crate) fn pixels(width: u32, height: u32) -> Result<usize, Fault> {
    let count = (width as usize).checked_mul(height as usize).filter(|&count| count > 0);
    count.ok_or_else(|| Fault::argument(format!("a field of {width}x{height} values is empty or too large")))
}

/// # Safety
/// `values` is NULL, or points to width x height floats.
unsafe fn field<'a>(values: *const f32, width: u32, height: u32) -> Result<Values<'a>, Fault> {
    // SAFETY: by the C contract.
    Ok(Values { width, values: unsafe { slice(values, pixels(width, height)?, "values") }? })
}
