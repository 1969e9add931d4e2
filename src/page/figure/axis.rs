//! Linear and logarithmic axes: where a value stands, and which values are named.

/// One axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    pub(super) label: String,
    log: bool,
    /// As asked for; `None` follows the data.
    limits: Option<[f64; 2]>,
}

/// An axis that knows its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    log: bool,
    low: f64,
    high: f64,
}

/// A place on an axis, named or not.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tick {
    pub value: f64,
    pub label: Option<String>,
}

impl Axis {
    /// Even steps; `label` says the quantity and its unit.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: false, limits: None }
    }

    /// Even factors. What is not above 0 is drawn at the lower end.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: true, limits: None }
    }

    /// Fixed ends instead of those of the data. Ends that are not finite, not in order, or not above 0 on a logarithmic
    /// axis are not taken.
    pub fn limits(mut self, low: f64, high: f64) -> Self {
        self.limits = Some([low, high]);
        self
    }

    /// The ends for these values; 0 to 1, or 0.1 to 1, where none can be shown.
    pub(crate) fn spanning(&self, values: impl IntoIterator<Item = f64>) -> Span {
        let shown = |v: &f64| v.is_finite() && v.abs() < 1e300 && (!self.log || *v > 1e-300);
        if let Some([low, high]) = self.limits
            && [low, high].iter().all(shown)
            && low < high
        {
            return Span { log: self.log, low, high };
        }
        let least = if self.log { 0.1 } else { 0.0 };
        let ends = values.into_iter().filter(shown).map(|v| (v, v)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (low, high) = ends.unwrap_or((least, 1.0));
        let (low, high) = match (low < high, self.log) {
            (true, _) => (low, high),
            (false, true) => (low / 2.0, high * 2.0),
            (false, false) => (low - 0.5f64.max(1e-3 * low.abs()), high + 0.5f64.max(1e-3 * high.abs())),
        };
        Span { log: self.log, low, high }
    }
}

impl Span {
    /// With room at both ends, a fraction of the length.
    pub(super) fn padded(self, fraction: f64) -> Self {
        let (low, high) = (self.place(self.low), self.place(self.high));
        let room = fraction * (high - low);
        let back = |p: f64| if self.log { 10f64.powf(p) } else { p };
        Self { low: back(low - room), high: back(high + room), ..self }
    }

    /// 0 at the lower end, 1 at the upper, beyond them outside; NaN stays.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        if self.log && value <= 0.0 {
            return 0.0;
        }
        (self.place(value) - self.place(self.low)) / (self.place(self.high) - self.place(self.low))
    }

    /// Ticks between the ends, about `count` of them named.
    pub(crate) fn ticks(&self, count: usize) -> Vec<Tick> {
        let ticks = if self.log { self.log_ticks(count) } else { self.linear_ticks(count) };
        let slack = 1e-9 * (self.place(self.high) - self.place(self.low));
        let inside =
            |v: f64| self.place(v) >= self.place(self.low) - slack && self.place(v) <= self.place(self.high) + slack;
        ticks.into_iter().filter(|tick| inside(tick.value)).collect()
    }

    fn place(&self, value: f64) -> f64 {
        if self.log { value.log10() } else { value }
    }

    fn linear_ticks(&self, count: usize) -> Vec<Tick> {
        let step = step((self.high - self.low) / count.max(1) as f64);
        let first = (self.low / step).ceil();
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        // At most a few more than asked for, whatever the numbers.
        (0..=2 * count + 2)
            .map(|i| (first + i as f64) * step)
            .map(|value| Tick { value, label: Some(number(value, decimals)) })
            .collect()
    }

    /// Decades, every n-th where there are many; their multiples by 2 to 9 between, named (2 and 5) where there are few.
    fn log_ticks(&self, count: usize) -> Vec<Tick> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let decades = self.high.log10() - self.low.log10();
        let every = (decades / count.max(1) as f64).ceil().max(1.0) as i32;
        let named = |exponent: i32, digit: i32| match digit {
            1 => exponent.rem_euclid(every) == 0,
            2 | 5 => decades < 1.7,
            _ => false,
        };
        let digits = if every == 1 { 1..10 } else { 1..2 };
        (first..=last)
            .flat_map(|exponent| digits.clone().map(move |digit| (exponent, digit)))
            .map(|(exponent, digit)| {
                let value = f64::from(digit) * 10f64.powi(exponent);
                Tick { value, label: named(exponent, digit).then(|| power(value, exponent)) }
            })
            .collect()
    }
}

/// The least of 1, 2, 5 times a power of ten that is at least `least`.
fn step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= least * (1.0 - 1e-9)).unwrap_or(10.0);
    factor * power
}

/// With a real minus sign, and without one before zero.
fn number(value: f64, decimals: usize) -> String {
    if decimals > 6 || value.abs() >= 1e6 {
        return format!("{value:.1e}").replace('-', "−");
    }
    let text = format!("{value:.decimals$}");
    let zero = text.trim_start_matches(['-', '0', '.']).is_empty();
    if zero { text.trim_start_matches('-').to_string() } else { text.replace('-', "−") }
}

fn power(value: f64, exponent: i32) -> String {
    match exponent {
        -4..=-1 => format!("{value:.*}", exponent.unsigned_abs() as usize),
        0..=5 => format!("{value:.0}"),
        _ => format!("{value:.0e}").replace('-', "−"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(span: &Span, count: usize) -> Vec<String> {
        span.ticks(count).into_iter().filter_map(|tick| tick.label).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers_within_the_ends() {
        let axis = Axis::linear("x");
        assert_eq!(labels(&axis.spanning([-0.3, 1.0]), 5), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(&axis.spanning([-50.0, 6.0]), 6), ["−50", "−40", "−30", "−20", "−10", "0"]);
        assert_eq!(labels(&axis.spanning([0.0, 0.004]), 4), ["0.000", "0.001", "0.002", "0.003", "0.004"]);
    }

    #[test]
    fn log_ticks_name_decades_and_mark_what_lies_between() {
        let span = Axis::log("x").spanning([0.001, 10.0]);
        assert_eq!(labels(&span, 5), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(span.ticks(5).len(), 4 * 9 + 1);
        assert_eq!(labels(&Axis::log("x").spanning([0.9, 12.0]), 5), ["1", "2", "5", "10"]);
        assert_eq!(labels(&Axis::log("x").spanning([1e-12, 1e12]), 4), ["1e−12", "1e−6", "1", "1e6", "1e12"]);
        assert_eq!(span.fraction(0.1), 0.5);
        assert_eq!((span.fraction(0.0), span.fraction(-3.0)), (0.0, 0.0));
    }

    #[test]
    fn no_values_one_value_and_wild_values_still_make_an_axis() {
        for axis in
            [Axis::linear("x"), Axis::log("x"), Axis::log("x").limits(-1.0, 1.0), Axis::linear("x").limits(1.0, 1.0)]
        {
            for values in [&[][..], &[f64::NAN, f64::INFINITY], &[3.0], &[0.0], &[-1e299, 1e299], &[1e-320, 1e-320]] {
                let span = axis.spanning(values.iter().copied()).padded(0.05);
                assert!(span.low < span.high, "{axis:?} {values:?} {span:?}");
                assert!(span.ticks(5).len() < 800, "{axis:?} {values:?}");
                assert!(span.ticks(0).iter().all(|tick| tick.value.is_finite()));
            }
        }
    }

    #[test]
    fn limits_win_over_the_data() {
        let span = Axis::linear("x").limits(0.0, 2.0).spanning([5.0]);
        assert_eq!((span.fraction(1.0), span.fraction(5.0)), (0.5, 2.5));
    }
}
