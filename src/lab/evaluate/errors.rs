//! How far apart two registrations, or two fields of V, are.

use serde::Serialize;

use crate::base::Similarity;
use crate::engine::Solution;

/// What was found less the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct TransformError {
    pub tx_px: f64,
    pub ty_px: f64,
    pub rotation_deg: f64,
    pub scale_percent: f64,
    /// The largest distance between where the two put a corner.
    pub corner_px: f64,
}

impl TransformError {
    pub(super) fn of(found: &Similarity, truth: &Similarity, [width, height]: [u32; 2]) -> Self {
        Self {
            tx_px: found.tx - truth.tx,
            ty_px: found.ty - truth.ty,
            rotation_deg: found.rotation_deg() - truth.rotation_deg(),
            scale_percent: 100.0 * (found.scale - truth.scale),
            corner_px: found.corner_distance(truth, width, height),
        }
    }
}

/// Pixels along the border that are left out of every rms.
pub(super) const BORDER: usize = 16;

/// The pixels of a frame that are so far from its border, by their index.
pub(super) fn inside(width: u32, height: u32, border: usize) -> impl Iterator<Item = usize> {
    let (width, height) = (width as usize, height as usize);
    let rows = border..height.saturating_sub(border);
    rows.flat_map(move |y| (border..width.saturating_sub(border)).map(move |x| y * width + x))
}

/// Root mean square of a field, `BORDER` px inside the frame, over what is finite; `None` where nothing is.
pub(super) fn rms(width: u32, height: u32, value: impl Fn(usize) -> f64) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for v in inside(width, height, BORDER).map(value).filter(|v| v.is_finite()) {
        sum += v * v;
        count += 1;
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}

/// V of a solution less another field.
pub(super) fn rms_error(solution: &Solution, truth: &[f32]) -> Option<f64> {
    rms(solution.width, solution.height, |i| f64::from(solution.relative_blur[i]) - f64::from(truth[i]))
}

/// E of the finest level after its last iteration.
pub(super) fn energy(solution: &Solution) -> Option<f64> {
    solution.levels.last()?.energy.last().copied()
}

/// Median, least and greatest. What failed counts as worse than any number; infinity stands for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    /// `null` in JSON where more than half failed.
    pub median: f64,
    pub low: f64,
    pub high: f64,
}

impl Spread {
    pub(super) fn of(values: &[Option<f64>]) -> Self {
        let mut sorted: Vec<f64> = values.iter().map(|v| v.unwrap_or(f64::INFINITY)).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |i: usize| sorted.get(i).copied().unwrap_or(f64::INFINITY);
        Self { median: at(sorted.len() / 2), low: at(0), high: at(sorted.len().saturating_sub(1)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_error_of_a_rotation_and_a_scale_is_in_closed_form() {
        let truth = Similarity::IDENTITY;
        // Half the diagonal of 301 x 401 px is 250 px: corners are at (±150, ±200).
        let size = [301, 401];
        let turned = TransformError::of(&Similarity::new(0.0, 0.0, 2.0, 1.0), &truth, size);
        assert!((turned.corner_px - 2.0 * 250.0 * 1f64.to_radians().sin()).abs() < 1e-9, "{turned:?}");
        let scaled = TransformError::of(&Similarity::new(0.0, 0.0, 0.0, 1.01), &truth, size);
        assert!((scaled.corner_px - 2.5).abs() < 1e-9 && (scaled.scale_percent - 1.0).abs() < 1e-9);
        // The corner that both move the same way: 3 + 1.5 and 4 + 2.
        let both = TransformError::of(&Similarity::new(3.0, 4.0, 0.0, 1.01), &truth, size);
        assert!((both.corner_px - 7.5).abs() < 1e-9, "{both:?}");
    }

    #[test]
    fn rms_leaves_out_the_border_and_what_is_not_valid() {
        let value = |i: usize| match (i % 40, i / 40) {
            (16, 16) => f64::NAN,
            (x, y) if (16..24).contains(&x) && (16..24).contains(&y) => 3.0,
            _ => 100.0,
        };
        assert_eq!(rms(40, 40, value), Some(3.0));
        assert_eq!(rms(32, 32, value), None);
        assert_eq!(rms(8, 8, value), None);
    }

    #[test]
    fn failures_are_worse_than_any_number() {
        let spread = Spread::of(&[Some(2.0), None, Some(1.0)]);
        assert_eq!((spread.low, spread.median, spread.high), (1.0, 2.0, f64::INFINITY));
        assert_eq!(Spread::of(&[None, None, Some(1.0)]).median, f64::INFINITY);
        assert_eq!(Spread::of(&[]).median, f64::INFINITY);
    }
}
