//! Quantities at each pixel, the scale that maps them to nearness, and its colours.

use std::borrow::Cow;

use serde::Serialize;

use crate::base::{Error, Lens};
use crate::metric::inspect::Heights;

/// Fraction of the valid pixels at either end that may exceed the scale. It prevents outliers from compressing the
/// scale.
const TAIL: f64 = 0.01;

/// Least span of a scale of V, px². A smaller span is rounding and noise, which must not look like relief.
const LEAST_SPAN: f32 = 0.5;

/// Least span of a scale of depth or focus, as a fraction of the distance between the first and the last focus setting.
const LEAST_PART: f64 = 0.01;

/// Which photograph, or which end of a sweep, is focused nearer to the camera. In a [`Scale`], which end is near.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Nearer {
    /// I1, or the first frame: V > 0 is near. In a scale: the high end.
    #[default]
    First,
    /// I2, or the last frame: V > 0 is far. In a scale: the low end.
    Second,
}

impl Nearer {
    /// The number of the photograph: 1 or 2.
    pub fn number(self) -> u8 {
        match self {
            Nearer::First => 1,
            Nearer::Second => 2,
        }
    }

    /// The image that is focused nearer, from the focus distances of a lens.
    pub fn of_lens(lens: &Lens) -> Self {
        if lens.focus[0] < lens.focus[1] { Self::First } else { Self::Second }
    }

    /// The near end of a scale of positions: [`Nearer::First`] if larger positions are nearer.
    pub(super) fn end_of(self, positions: &[f64]) -> Self {
        let descending = positions.first() > positions.last();
        if descending == (self == Nearer::First) { Nearer::First } else { Nearer::Second }
    }
}

/// Returns the name of a column of CSV with its unit, in ASCII.
pub(super) fn column(name: &str, unit: &str) -> String {
    let unit = unit.replace("px²", "px2").replace("1/m", "per_m");
    if unit.is_empty() { name.to_string() } else { format!("{name}_{unit}") }
}

/// A quantity at each pixel with its standard deviation: V, the focus of a sweep, or depth.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity<'a> {
    /// "relative_blur", "focus" or "depth".
    pub name: &'static str,
    /// Unit: "px²", "settings", "1/m" or "mm".
    pub unit: &'static str,
    /// Values, row-major; NaN where not valid.
    pub values: Cow<'a, [f32]>,
    /// Standard deviation of each value.
    pub deviation: Cow<'a, [f32]>,
    /// [`Nearer::First`] where larger values are nearer to the camera.
    pub nearer: Nearer,
    /// Least span of a scale.
    least_span: f32,
}

impl<'a> Quantity<'a> {
    /// V in px², and its standard deviation.
    pub fn relative_blur(values: &'a [f32], deviation: &'a [f32], nearer: Nearer) -> Self {
        let (values, deviation) = (values.into(), deviation.into());
        Self { name: "relative_blur", unit: "px²", values, deviation, nearer, least_span: LEAST_SPAN }
    }

    /// Focus of a sweep whose frames are focused at these positions.
    pub(super) fn focus(
        values: &'a [f32],
        deviation: &'a [f32],
        unit: &'static str,
        positions: &[f64],
        nearer: Nearer,
    ) -> Self {
        let (least_span, nearer) = (least_span(positions), nearer.end_of(positions));
        Self { name: "focus", unit, values: values.into(), deviation: deviation.into(), nearer, least_span }
    }

    /// Depth in mm; the frames are focused at `planes`, mm.
    pub(super) fn depth(values: &'a [f32], deviation: &'a [f32], planes: &[f64], nearer: Nearer) -> Self {
        let least_span = least_span(planes);
        Self { name: "depth", unit: "mm", values: values.into(), deviation: deviation.into(), nearer, least_span }
    }

    /// The quantity with NaN at the marked pixels.
    pub(super) fn without(mut self, marked: &[bool]) -> Self {
        if marked.iter().any(|marked| *marked) {
            self.values.to_mut().iter_mut().zip(marked).filter(|(_, m)| **m).for_each(|(value, _)| *value = f32::NAN);
        }
        self
    }

    /// Heights towards the camera, of a field of this size.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the size is not that of the field.
    pub fn heights(&self, size: [u32; 2]) -> Result<Heights, Error> {
        let sign = if self.nearer == Nearer::First { 1.0 } else { -1.0 };
        let towards: Vec<f32> = self.values.iter().map(|v| sign * v).collect();
        Heights::new(size, &towards, &self.deviation)
    }

    /// The scale of its values in pictures.
    pub fn scale(&self) -> Scale {
        Scale::spanning([&self.values[..]], self.nearer, self.least_span)
    }

    /// The name for display.
    pub fn label(&self) -> String {
        self.name.replace('_', " ")
    }
}

fn least_span(positions: &[f64]) -> f32 {
    let ends = positions.first().zip(positions.last());
    let span = ends.map_or(0.0, |(first, last)| (last - first).abs());
    (LEAST_PART * span).max(1e-6) as f32
}

/// A map from values to nearness, for one field or for several fields that are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Low end.
    pub low: f32,
    /// High end, above `low`.
    pub high: f32,
    /// The near end: [`Nearer::First`] if `high` is near.
    pub nearer: Nearer,
}

impl Scale {
    /// A scale of V from the 1st to the 99th percentile of the finite values, with a span of at least half a px². It is
    /// around 0 if no value is finite.
    pub fn of(values: &[f32], nearer: Nearer) -> Self {
        Self::common([values], nearer)
    }

    /// One scale for several fields of V: from the lowest 1st percentile to the highest 99th percentile.
    pub fn common<'a>(fields: impl IntoIterator<Item = &'a [f32]>, nearer: Nearer) -> Self {
        Self::spanning(fields, nearer, LEAST_SPAN)
    }

    fn spanning<'a>(fields: impl IntoIterator<Item = &'a [f32]>, nearer: Nearer, least_span: f32) -> Self {
        let ends = fields.into_iter().filter_map(|values| {
            let mut quantiles = Quantiles::of(values);
            Some((quantiles.at(TAIL)?, quantiles.at(1.0 - TAIL)?))
        });
        let (low, high) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0.0, 0.0));
        let widen = (least_span - (high - low)).max(0.0) / 2.0;
        Self { low: low - widen, high: high + widen, nearer }
    }

    /// Nearness of a value: 0 at the far end and beyond, 1 at the near end and beyond; NaN if `value` is NaN.
    pub fn nearness(&self, value: f32) -> f64 {
        // In double precision the difference of two finite values does not overflow.
        let (value, low, high) = (f64::from(value), f64::from(self.low), f64::from(self.high));
        let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
        match self.nearer {
            Nearer::First => t,
            Nearer::Second => 1.0 - t,
        }
    }

    /// The value with this nearness: the inverse of [`nearness`](Self::nearness).
    pub fn value(&self, nearness: f64) -> f64 {
        let t = match self.nearer {
            Nearer::First => nearness,
            Nearer::Second => 1.0 - nearness,
        };
        f64::from(self.low) + t * (f64::from(self.high) - f64::from(self.low))
    }
}

/// Colours of near and far in every picture and on the page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Palette {
    /// Near yellow, far purple; perceptually uniform
    ///
    /// Viridis (van der Walt and Smith 2015), also for colour-blind viewers and in grey print.
    #[default]
    Viridis,
    /// Near red, far blue, as in the paper
    ///
    /// Turbo (Mikhailov 2019).
    RedBlue,
    /// Near white, far black
    Grey,
}

impl Palette {
    /// RGB of a nearness, clamped to 0 (far) to 1 (near).
    pub fn color(self, nearness: f64) -> [u8; 3] {
        let t = nearness.clamp(0.0, 1.0);
        match self {
            Self::Viridis => colorous::VIRIDIS.eval_continuous(t).as_array(),
            // Leaves out the last tenth at either end, which darkens towards violet and maroon.
            Self::RedBlue => colorous::TURBO.eval_continuous(0.1 + 0.8 * t).as_array(),
            Self::Grey => [(255.0 * t).round() as u8; 3],
        }
    }

    /// Names of the colours of near and far.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Viridis => ["yellow", "purple"],
            Self::RedBlue => ["red", "blue"],
            Self::Grey => ["white", "black"],
        }
    }
}

/// The finite values of a field, for their quantiles.
pub(crate) struct Quantiles(Vec<f32>);

impl Quantiles {
    /// Keeps the finite values.
    pub(crate) fn of(values: &[f32]) -> Self {
        Self(values.iter().copied().filter(|v| v.is_finite()).collect())
    }

    /// The quantile `q` in [0, 1], linear between ranks (0 is the least value, ½ the median); `None` if no value is
    /// finite.
    pub(crate) fn at(&mut self, q: f64) -> Option<f32> {
        let last = self.0.len().checked_sub(1)?;
        let rank = q * last as f64;
        let (_, &mut low, above) = self.0.select_nth_unstable_by(rank as usize, f32::total_cmp);
        let high = above.iter().copied().fold(f32::INFINITY, f32::min);
        let fraction = rank.fract();
        // At the last rank `above` is empty, and the fraction is 0.
        Some(if fraction == 0.0 {
            low
        } else {
            (f64::from(low) * (1.0 - fraction) + f64::from(high) * fraction) as f32
        })
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
    fn a_common_scale_covers_every_field() {
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

    #[test]
    fn quantiles_interpolate_and_ignore_invalid_values() {
        let mut quantiles = Quantiles::of(&[4.0, f32::NAN, 1.0, 3.0, 2.0, f32::INFINITY]);
        let found = [0.0, 0.5, 1.0, 1.0 / 3.0].map(|q| quantiles.at(q));
        assert_eq!(found, [1.0, 2.5, 4.0, 2.0].map(Some));
        let values: Vec<f32> = (0..101).rev().map(|i| i as f32).collect();
        let mut quantiles = Quantiles::of(&values);
        assert_eq!([0.01, 0.99].map(|q| quantiles.at(q)), [Some(1.0), Some(99.0)]);
        assert_eq!(Quantiles::of(&[f32::NAN]).at(0.5), None);
        assert_eq!(Quantiles::of(&[7.0]).at(0.5), Some(7.0));
    }

    #[test]
    fn near_is_bright_yellow_red_or_white() {
        let [near, far] = [1.0, 0.0].map(|t| Palette::Viridis.color(t));
        assert!(near[0] > 200 && near[1] > 200 && near[2] < 80, "{near:?}");
        assert!(far.iter().all(|c| *c < 100) && far[2] > far[1], "{far:?}");
        assert_eq!((Palette::Grey.color(2.0), Palette::Grey.color(-1.0)), ([255; 3], [0; 3]));
        let [[r, g, b], far] = [1.0, 0.0].map(|t| Palette::RedBlue.color(t));
        assert!(r > 150 && g < 100 && b < 50, "{r} {g} {b}");
        assert!(far[2] > 200 && far[0] < 100 && far[1] < 150, "{far:?}");
    }

    #[test]
    fn viridis_brightens_monotonically() {
        let luminance = |t: f64| {
            let [r, g, b] = Palette::Viridis.color(t).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f64> = (0..=50).map(|i| luminance(f64::from(i) / 50.0)).collect();
        assert!(steps.is_sorted(), "{steps:?}");
    }
}
