//! The range of stored values that pictures show, from black to white.

use serde::{Deserialize, Serialize};

use crate::base::{Frame, Samples};

/// Stored values that pictures show as black and as white. In memory the largest integer is 1, in reports it is as
/// stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tone {
    /// The value that is shown as black.
    pub black: f32,
    /// The value that is shown as white.
    pub white: f32,
}

impl Default for Tone {
    fn default() -> Self {
        Self { black: 0.0, white: 1.0 }
    }
}

/// Share of the values at either end that do not count: highlights, and pixels that do not work.
const TAIL: f64 = 0.001;

/// Share of the values beyond black or white from which a picture is stretched.
const BEYOND: f64 = 0.1;

/// Share of the range from black to white that a picture without a stretch takes at least, from either end.
const LEAST: f32 = 0.3;

/// Greatest number of values that are looked at.
const MOST_VALUES: usize = 1 << 16;

impl Tone {
    /// The range for a frame. 8-bit samples are made to be looked at, and stay.
    pub(crate) fn of(frame: &Frame) -> Self {
        let (channels, counted) = (frame.format().channels.count() as usize, frame.counted());
        let counts = |i: usize| counted.is_none_or(|counted| counted[i / channels] != 0);
        match frame.samples() {
            Samples::U8(_) => Self::default(),
            Samples::U16(s) => Self::over(s.len(), |i| counts(i).then(|| f32::from(s[i]) / 65535.0)),
            Samples::F32(s) => Self::over(s.len(), |i| counts(i).then(|| s[i])),
        }
    }

    /// The range for values: 0 to 1 if they fill it, such as integers of 16 bits. Values that take a part of it, such as
    /// those of 12 bits, or that lie beyond it, such as floats up to 255, are stretched: by a power of two if black can
    /// stay at 0, so that integers stay distinct and proportional to light.
    pub(crate) fn over(count: usize, value: impl Fn(usize) -> Option<f32>) -> Self {
        // Places of a low-discrepancy sequence, so that no row, column or channel is preferred.
        let place = |n: usize| ((n as f64 * 0.618_033_988_749_895).fract() * count as f64) as usize;
        let places = (0..count.min(MOST_VALUES)).map(|n| if count > MOST_VALUES { place(n) } else { n });
        let mut values: Vec<f32> = places.filter_map(value).filter(|value| value.is_finite()).collect();
        values.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| values.get((share * values.len().saturating_sub(1) as f64).round() as usize).copied();
        let [Some(low), Some(tenth), Some(rest), Some(high)] = [TAIL, BEYOND, 1.0 - BEYOND, 1.0 - TAIL].map(at) else {
            return Self::default();
        };
        let is_filled = high >= LEAST && low <= 1.0 - LEAST && tenth >= 0.0 && rest <= 1.0;
        if is_filled || high <= low {
            Self::default()
        } else if low >= 0.0 && 2.0 * low < high {
            Self { black: 0.0, white: high.log2().ceil().exp2() }
        } else {
            Self { black: low, white: high }
        }
    }

    /// The tone, unless it changes nothing.
    pub(crate) fn changing(self) -> Option<Self> {
        (self != Self::default()).then_some(self)
    }

    /// The shown value, 0 to 1, of a stored one.
    pub(crate) fn shown(self, stored: f32) -> f32 {
        ((stored - self.black) / (self.white - self.black)).clamp(0.0, 1.0)
    }

    /// The stored value of a shown one.
    pub(crate) fn stored(self, shown: f32) -> f32 {
        self.black + shown * (self.white - self.black)
    }

    /// The tone in values times a factor.
    pub(crate) fn times(self, factor: f32) -> Self {
        Self { black: factor * self.black, white: factor * self.white }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Channels;

    #[test]
    fn values_that_do_not_fill_the_range_are_stretched_and_others_stay() {
        let words = |most: u32, of: &dyn Fn(u32) -> u32| {
            let samples = (0..3000).map(|i| of(most * (i % 1000) / 999) as u16).collect();
            Tone::of(&Frame::new(1000, 3, Channels::Gray, Samples::U16(samples)).unwrap())
        };
        for bits in [8, 10, 12, 14] {
            let tone = words((1 << bits) - 1, &|v| v);
            assert_eq!(tone, Tone { black: 0.0, white: (bits as f32 - 16.0).exp2() });
            // Integers stay distinct, and are read back as they were.
            for v in [0u16, 1, 100, 255] {
                let shown = (65535.0 * tone.shown(f32::from(v) / 65535.0)).round() / 65535.0;
                assert_eq!((65535.0 * tone.stored(shown)).round() as u16, v);
            }
        }
        assert_eq!(words(65535, &|v| v), Tone::default());
        let inverted = words(4095, &|v| 65535 - v);
        assert!((inverted.black - 0.9376).abs() < 1e-3 && inverted.white > 0.9999, "{inverted:?}");
        let floats = |low: f32, high: f32| {
            let values = (0..1000).map(|i| low + (high - low) * i as f32 / 999.0).collect();
            Tone::of(&Frame::gray(100, 10, values).unwrap())
        };
        assert_eq!(floats(0.0, 255.0), Tone { black: 0.0, white: 256.0 });
        assert_eq!([floats(0.0, 1.0), floats(-0.05, 1.05), floats(0.5, 0.5)], [Tone::default(); 3]);
        let around = floats(-2.0, 2.0);
        assert!((around.black + 2.0).abs() < 0.01 && (around.white - 2.0).abs() < 0.01, "{around:?}");
        assert_eq!(Tone::over(0, |_| None), Tone::default());
    }
}
