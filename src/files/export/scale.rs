//! From values to nearness, on one scale for as many fields as are to be compared.

use super::Nearer;
use super::ranks::Ranks;

/// The part of the valid pixels, at either end, that may leave the scale: a few wild pixels must not grey out the rest.
const TAIL: f64 = 0.01;

/// The least span of the scale, px²: less than that is rounding and noise, and must not look like relief.
const LEAST_SPAN: f32 = 0.5;

/// From V, px², to nearness; the scale of `depth.png` and of every other picture of V. Depth has one in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// V at one end, px².
    pub low: f32,
    /// V at the other end, px², above `low`.
    pub high: f32,
    /// Which image is focused nearer, which says whether `low` or `high` is near.
    pub nearer: Nearer,
}

impl Scale {
    /// From the 1st to the 99th percentile of the finite values, and over half a px² at least; around 0 where no value
    /// is finite.
    pub fn of(values: &[f32], nearer: Nearer) -> Self {
        Self::common([values], nearer)
    }

    /// One scale for several fields: from the lowest 1st to the highest 99th percentile of any.
    pub fn common<'a>(fields: impl IntoIterator<Item = &'a [f32]>, nearer: Nearer) -> Self {
        Self::spanning(fields, nearer, LEAST_SPAN)
    }

    /// The same for values of another unit, over `least_span` of it at least.
    pub(super) fn spanning<'a>(fields: impl IntoIterator<Item = &'a [f32]>, nearer: Nearer, least_span: f32) -> Self {
        let ends = fields.into_iter().filter_map(|values| {
            let mut ranks = Ranks::of(values);
            Some((ranks.quantile(TAIL)?, ranks.quantile(1.0 - TAIL)?))
        });
        let (low, high) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0.0, 0.0));
        let widen = (least_span - (high - low)).max(0.0) / 2.0;
        Self { low: low - widen, high: high + widen, nearer }
    }

    /// 0 at the far end and beyond, 1 at the near end and beyond; NaN where `v` is NaN.
    pub fn nearness(&self, v: f32) -> f64 {
        // In double precision no finite span overflows.
        let (v, low, high) = (f64::from(v), f64::from(self.low), f64::from(self.high));
        let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
        match self.nearer {
            Nearer::First => t,
            Nearer::Second => 1.0 - t,
        }
    }

    /// V at a nearness, px²: the inverse of [`nearness`](Self::nearness).
    pub fn value(&self, nearness: f64) -> f64 {
        let t = match self.nearer {
            Nearer::First => nearness,
            Nearer::Second => 1.0 - nearness,
        };
        f64::from(self.low) + t * (f64::from(self.high) - f64::from(self.low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_focused_nearer_decides_which_end_is_near() {
        let ramp: Vec<f32> = (0..101).map(|i| i as f32 - 50.0).collect();
        let (first, second) = (Scale::of(&ramp, Nearer::First), Scale::of(&ramp, Nearer::Second));
        assert_eq!((first.low, first.high), (-49.0, 49.0));
        assert_eq!((first.nearness(60.0), second.nearness(60.0)), (1.0, 0.0));
        assert_eq!(first.nearness(-50.0), second.nearness(50.0));
        for scale in [first, second] {
            assert!((scale.value(scale.nearness(12.0)) - 12.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_common_scale_holds_every_field() {
        let scale = Scale::common([&[0.0, 1.0][..], &[f32::NAN], &[-4.0, -3.0]], Nearer::First);
        assert!(scale.low < -3.9 && scale.high > 0.9, "{scale:?}");
        assert_eq!(Scale::common([], Nearer::First), Scale { low: -0.25, high: 0.25, nearer: Nearer::First });
    }

    #[test]
    fn the_widest_span_does_not_overflow() {
        let scale = Scale::of(&[f32::MIN, f32::MAX], Nearer::First);
        assert!(scale.nearness(0.0) > 0.4 && scale.nearness(0.0) < 0.6, "{scale:?}");
        assert!(scale.nearness(f32::NAN).is_nan());
    }
}
