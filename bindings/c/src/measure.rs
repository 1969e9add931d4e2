//! Step heights and profiles of a field.

use parfocal::metric::measure::{Line, Values};

use crate::fault::{Fault, call, parfocal_status};
use crate::handle::{slice, slice_mut};
use crate::solution::check_count;
use crate::solver::parfocal_region;

/// A number and its standard error, both NaN where too few pixels are valid.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_estimate {
    /// The number, in the unit of the field.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// How far a region of a field, width x height values, lies above another: the difference of their levels, medians without
/// the tilt. For px² or mm.
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
        // SAFETY: the contract is the same.
        let (values, out) = unsafe { (field(values, width, height)?, slice_mut(estimate, 1, "estimate")?) };
        let step = values.step(from.into(), to.into())?;
        let (value, standard_error) = step.map_or((f64::NAN, f64::NAN), |step| (step.value, step.standard_error));
        out[0] = parfocal_estimate { value, standard_error };
        Ok(())
    })
}

/// How many values a profile has: places 1 px apart at most, from end to end; 0 of a line without a length.
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_profile_length(x1: f64, y1: f64, x2: f64, y2: f64) -> usize {
    let length = (x2 - x1).hypot(y2 - y1);
    // No image is wider.
    if (1.0..1e7).contains(&length) { length.ceil() as usize + 1 } else { 0 }
}

/// The values of a field along a line, px, each the mean over so many px across; NaN where none is valid. count is
/// parfocal_profile_length of the line.
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
        // SAFETY: the contract is the same.
        let values = unsafe { field(values, width, height) }?;
        let found = values.profile(&Line { from: [x1, y1], to: [x2, y2], width: across })?;
        check_count("profile", count, found.len())?;
        // SAFETY: the header asks for so many doubles.
        unsafe { slice_mut(profile, count, "profile") }?.copy_from_slice(&found);
        Ok(())
    })
}

/// # Safety
/// `values` is NULL, or of width x height floats.
unsafe fn field<'a>(values: *const f32, width: u32, height: u32) -> Result<Values<'a>, Fault> {
    let count = (width as usize).checked_mul(height as usize).filter(|&count| count > 0);
    let count = count.ok_or_else(|| Fault::argument(format!("{width}x{height} values are none, or too many")))?;
    // SAFETY: the contract is the same.
    Ok(Values { width, values: unsafe { slice(values, count, "values") }? })
}
