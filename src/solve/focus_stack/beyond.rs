//! What no frame of a sweep has in focus, since it lies before the first or beyond the last.

/// How far beyond the first or the last frame a pixel's focus must lie, px of blur. The solve follows it for half a px; what comes close to
/// that may lie anywhere further out, and what stays nearer is in focus in that frame for all that can be seen.
const NEVER: f64 = 0.4;

/// The side of each pixel: -1 before the first frame, 1 beyond the last, 0 between them or where nothing tells (NaN). Of focus in steps
/// from the first frame, 0, to the last; c in px² of variance by squared steps.
pub(super) fn sides(focus: &[f32], last: f64, rate: f64) -> Vec<i8> {
    let far = (NEVER / rate.sqrt()) as f32;
    let side = |u: &f32| i8::from(*u > last as f32 + far) - i8::from(*u < -far);
    focus.iter().map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_half_a_px_of_blur_outside_has_a_side() {
        // Blur of 2 px a step: 0.4 px are a fifth of a step.
        let focus = [f32::NAN, -0.25, -0.15, 0.0, 2.0, 3.15, 3.25];
        assert_eq!(sides(&focus, 3.0, 4.0), [0, -1, 0, 0, 0, 0, 1]);
    }
}
