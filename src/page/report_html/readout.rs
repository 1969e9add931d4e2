//! A quantity at each pixel of the page: its name, decimals and colours.

use serde_json::{Value, json};

use super::encoding::{self, Grid};
use crate::files::export::{Nearer, Quantiles, Scale};

/// A quantity at each pixel, as the page displays it.
#[derive(Clone, Debug)]
pub struct Readout<'a> {
    key: &'static str,
    name: &'static str,
    sign: &'static str,
    unit: &'static str,
    note: &'static str,
    values: &'a [f32],
    digits: u32,
    ramp: Ramp,
    ends: [&'static str; 2],
    /// Whether the colours run from the high to the low end.
    reversed: bool,
    gray: bool,
    /// Whether the page computes the values from other fields.
    computed: bool,
}

/// Map from values to colours.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ramp {
    Linear { low: f32, high: f32 },
    Logarithmic { low: f32, high: f32 },
}

/// Fraction of the values, at either end, that may exceed the colour ramp.
const TAIL: f64 = 0.01;

/// Least ratio between the ends of a logarithmic ramp.
const LEAST_RATIO: f32 = 10.0;

/// Decimals of a quantity with a span of some tens to hundreds of its unit.
const DIGITS: u32 = 4;

/// Decimals of logarithms, for 1 % of the value.
const LOGARITHM_DIGITS: u32 = 2;

/// Decimals of mm, for the micrometre.
const METRIC_DIGITS: u32 = 3;

impl<'a> Readout<'a> {
    /// A field in grey, least black and greatest white, with four decimals.
    ///
    /// `key` identifies the field within the page, in lower case with underscores. `name` is displayed, and `sign` is
    /// its short form next to the number. `values` has one value per pixel of the page's images, row-major, with NaN
    /// for missing values. The page leaves out a field if all its values are equal.
    pub fn new(key: &'static str, name: &'static str, sign: &'static str, values: &'a [f32]) -> Self {
        let (low, high) = span(values);
        let ramp = Ramp::Linear { low, high };
        let ends = ["little", "much"];
        Self {
            key,
            name,
            sign,
            unit: "",
            note: "",
            values,
            digits: DIGITS,
            ramp,
            ends,
            reversed: false,
            gray: true,
            computed: false,
        }
    }

    /// Sets the unit.
    pub fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    /// Sets the explanation, a sentence or two.
    pub fn note(self, note: &'static str) -> Self {
        Self { note, ..self }
    }

    /// Sets the number of decimals.
    pub fn digits(self, digits: u32) -> Self {
        Self { digits, ..self }
    }

    /// Sets a logarithmic scale, for values above 0.
    pub fn logarithmic(self) -> Self {
        let values: Vec<f32> = self.values.iter().copied().filter(|&v| v > 0.0).collect();
        let (low, high) = span(&values);
        let low = low.max(f32::MIN_POSITIVE);
        Self { ramp: Ramp::Logarithmic { low, high: high.max(LEAST_RATIO * low) }, ..self }
    }

    /// Limits the decimals by the standard deviation: one unit of the last decimal is at most a fifth of the median.
    pub(super) fn rounded_by(self, deviation: &[f32]) -> Self {
        let typical = Quantiles::of(deviation).at(0.5).filter(|sigma| *sigma > 0.0);
        let enough =
            typical.map_or(self.digits, |sigma| (-(f64::from(sigma) / 5.0).log10()).ceil().clamp(0.0, 9.0) as u32);
        Self { digits: self.digits.min(enough.max(1)), ..self }
    }

    /// Makes the page compute the values from other fields, by `formulas` in `data.js`.
    pub(super) fn computed(self) -> Self {
        Self { computed: true, ..self }
    }

    /// Whether the page contains the values.
    pub(super) fn is_encoded(&self) -> bool {
        !self.computed
    }

    /// Sets the names of the low and the high end.
    pub fn ends(self, ends: [&'static str; 2]) -> Self {
        Self { ends, ..self }
    }

    /// Sets the names of the near and the far end.
    pub(super) fn between(self, [near, far]: [&'static str; 2]) -> Self {
        let ends = if self.reversed { [near, far] } else { [far, near] };
        self.ends(ends)
    }

    /// Sets the colours; the last one is near.
    fn near_and_far(self, scale: Scale) -> Self {
        let reversed = scale.nearer == Nearer::Second;
        let ramp = Ramp::Linear { low: scale.low, high: scale.high };
        Self { ramp, reversed, gray: false, ..self }.between(["near", "far"])
    }

    /// V, px², on the scale of `depth.png`.
    pub(super) fn relative_blur(values: &'a [f32], nearer: Nearer) -> Self {
        Self::new("relative_blur", "Relative blur", "V", values).unit("px²").near_and_far(Scale::of(values, nearer)).note(
            "V is the difference of the variances of both blurs. It is positive where I2 is more blurred. Pixels without \
             a valid value are not drawn.",
        )
    }

    /// The focus setting, with [`Nearer::First`] if greater settings are near.
    pub(super) fn focus(values: &'a [f32], nearer: Nearer) -> Self {
        let (low, high) = span(values);
        let digits = digits_of(values, high - low, DIGITS);
        Self::new("focus", "Focus", "focus", values).digits(digits).near_and_far(Scale { low, high, nearer }).note(
            "Each pixel has the setting at which it is in focus, in the unit of the frames’ settings. Pixels that no \
             pair of frames determines are filled in, paler.",
        )
    }

    /// Depth and its standard deviation, mm.
    ///
    /// `near` states whether the greatest depth is near (`First`, for a stage that counts this way) or the least.
    pub(super) fn depth_with_deviation(values: &'a [f32], deviation: &'a [f32], near: Nearer) -> [Self; 2] {
        let (low, high) = span(values);
        let scale = Scale { low, high, nearer: near };
        let depth = Self::new("depth", "Depth", "depth", values)
            .unit("mm")
            .digits(digits_of(values, high - low, METRIC_DIGITS))
            .near_and_far(scale)
            .note(
                "Each pixel has its depth in mm. Pixels that are not valid, or out of the range of the lens, are not \
                 drawn.",
            );
        let sigma = Self::deviation("depth_deviation", &depth, ["σ of depth", "σ"], deviation).note(
            "σ is the standard deviation of depth, mm, from the images. It leaves out errors of the stated optics. The \
             scale is logarithmic.",
        );
        [depth, sigma]
    }

    /// The standard deviation of another field, in the same unit.
    pub(super) fn deviation(key: &'static str, of: &Readout<'_>, names: [&'static str; 2], values: &'a [f32]) -> Self {
        let [name, sign] = names;
        Self::new(key, name, sign, values)
            .unit(of.unit)
            .digits(of.digits.min(most_digits(values)))
            .logarithmic()
            .ends(["sure", "unsure"])
    }

    /// The residual: the difference that neither blur nor registration explains.
    pub(super) fn residual(values: &'a [f32]) -> Self {
        Self::new("residual", "Residual", "residual", values).digits(5).logarithmic().ends(["explained", "not"]).note(
            "The residual is what neither blur nor registration explains around each pixel, in intensities with white \
             at 1. It is large where something moved between the photographs or shone differently. The scale is logarithmic.",
        )
    }

    /// The confidence in V.
    pub(super) fn confidence(values: &'a [f32]) -> Self {
        Self::new("confidence", "Confidence", "confidence", values)
            .digits(5)
            .logarithmic()
            .ends(["unsure", "sure"])
            .note(
                "The confidence is 1/(1 + σ²), where σ is the standard deviation of V in px²: ½ where V is known to \
                 1 px². The scale is logarithmic.",
            )
    }

    /// Whether two values differ.
    pub(super) fn is_worth_showing(&self) -> bool {
        let mut values = self.values.iter().filter(|v| !v.is_nan());
        values.next().is_some_and(|first| values.any(|v| v != first))
    }

    pub(super) fn key(&self) -> &'static str {
        self.key
    }

    pub(super) fn values(&self) -> &'a [f32] {
        self.values
    }

    /// The scale for the heights of the surface.
    pub(super) fn scale(&self) -> Scale {
        let (Ramp::Linear { low, high } | Ramp::Logarithmic { low, high }) = self.ramp;
        Scale { low, high, nearer: if self.reversed { Nearer::Second } else { Nearer::First } }
    }

    /// The description for `data.js`.
    pub(super) fn description(&self) -> Value {
        let (Ramp::Linear { low, high } | Ramp::Logarithmic { low, high }) = self.ramp;
        json!({
            "key": self.key, "name": self.name, "sign": self.sign, "unit": self.unit, "note": self.note,
            "digits": self.digits, "low": low, "high": high,
            "logarithmic": self.is_logarithmic(), "logarithms": self.is_logarithmic(), "computed": self.computed,
            "ends": self.ends, "reversed": self.reversed, "gray": self.gray,
            "median": Quantiles::of(self.values).at(0.5),
        })
    }

    fn is_logarithmic(&self) -> bool {
        matches!(self.ramp, Ramp::Logarithmic { .. })
    }

    /// The values on the grid with the displayed decimals; on a logarithmic scale, two decimals of their logarithms.
    pub(super) fn encoded(&self, grid: &Grid) -> Result<String, String> {
        let mut values = if self.computed { Vec::new() } else { grid.values(self.values) };
        if self.is_logarithmic() {
            values.iter_mut().for_each(|v| *v = v.ln());
        }
        encoding::decimals(&values, grid.width, if self.is_logarithmic() { LOGARITHM_DIGITS } else { self.digits })
    }
}

/// The 1st and the 99th percentile of the finite values, made unequal; 0 and 1 if none is finite.
fn span(values: &[f32]) -> (f32, f32) {
    let mut quantiles = Quantiles::of(values);
    let ends = quantiles.at(TAIL).zip(quantiles.at(1.0 - TAIL));
    let (low, high) = ends.unwrap_or((0.0, 1.0));
    if high > low { (low, high) } else { (low, low + low.abs().max(1e-3) * 1e-3) }
}

/// Decimals: `usual` for a span of 1 and more, one more for each power of ten below. Fewer if the page's 32-bit
/// integers could not represent the greatest value.
fn digits_of(values: &[f32], span: f32, usual: u32) -> u32 {
    let power = f64::from(span).log10().ceil().clamp(-5.0, 0.0);
    most_digits(values).min((f64::from(usual) - power) as u32)
}

/// Greatest number of decimals with which the greatest value fits a 32-bit integer.
fn most_digits(values: &[f32]) -> u32 {
    let greatest = values.iter().filter(|v| v.is_finite()).fold(1.0f64, |m, v| m.max(f64::from(v.abs())));
    (9.0 - greatest.log10().ceil()).max(0.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_equal_values_are_left_out() {
        let shown = |values: &[f32]| Readout::new("a", "A", "a", values).is_worth_showing();
        assert!(shown(&[0.0, f32::NAN, 1.0]));
        assert!(!shown(&[]) && !shown(&[f32::NAN; 2]) && !shown(&[2.0, f32::NAN, 2.0]));
    }

    #[test]
    fn the_ends_of_every_ramp_differ() {
        for values in [&[][..], &[5.0; 3], &[f32::NAN, -1.0], &[0.0, 0.0], &[f32::INFINITY, 3.0]] {
            let linear = Readout::new("a", "A", "a", values);
            for field in [linear.clone(), linear.logarithmic()] {
                let (Ramp::Linear { low, high } | Ramp::Logarithmic { low, high }) = field.ramp;
                assert!(low < high && low.is_finite() && high.is_finite(), "{values:?} {field:?}");
            }
        }
    }

    #[test]
    fn depth_has_decimals_to_the_micrometre_or_finer() {
        assert_eq!(
            [340.0, 7.0, 0.5, 0.05, 1e-9, 0.0].map(|span| digits_of(&[], span, METRIC_DIGITS)),
            [3, 3, 3, 4, 8, 8]
        );
        assert_eq!(digits_of(&[310_000.0, f32::NAN], 2e4, METRIC_DIGITS), 3);
        assert_eq!(digits_of(&[3e8], 2e4, METRIC_DIGITS), 0);
        assert_eq!(digits_of(&[0.0044, 0.0043], 1e-4, DIGITS), 8);
    }
}
