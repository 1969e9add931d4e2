//! Heights at the pixels of a picture, and how well they are known.

use crate::base::{Error, Similarity, centre};
use crate::metric::measure::Values;

/// Heights at the pixels of a picture: of any unit, greater towards the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Heights {
    /// Pixels a row, of both fields.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The heights, row-major; NaN where there is none.
    pub values: Vec<f32>,
    /// Standard deviations, in the unit of the heights; NaN where there is no height.
    pub deviation: Vec<f32>,
}

impl Heights {
    /// From both fields, row-major. A height that is not finite, or whose standard deviation is none, is no height.
    ///
    /// # Errors
    /// [`Error::Mismatch`]: the fields are not of this size.
    pub fn new([width, height]: [u32; 2], values: &[f32], deviation: &[f32]) -> Result<Self, Error> {
        let pixels = width as usize * height as usize;
        if [values.len(), deviation.len()] != [pixels; 2] {
            let found = format!("{} heights and {} deviations", values.len(), deviation.len());
            return Err(Error::Mismatch(format!("{found} are not those of {width}x{height} pixels")));
        }
        let known = |(&v, &s): (&f32, &f32)| if v.is_finite() && s.is_finite() && s >= 0.0 { (v, s) } else { NONE };
        let (values, deviation) = values.iter().zip(deviation).map(known).unzip();
        Ok(Self { width, height, values, deviation })
    }

    /// Those at `T x`, for each pixel x of a picture of this size, about whose centre T is stated. Between pixels both fields are
    /// interpolated (bilinear): neighbours err alike, so that their mean is no better known than they are.
    pub fn onto(&self, [width, height]: [u32; 2], t: &Similarity) -> Self {
        let [values, deviation] = [&self.values, &self.deviation].map(|values| Values { width: self.width, values });
        let (middle, count) = (centre(width, height), width as usize * height as usize);
        let place = |i: usize| {
            let place = [(i % width as usize) as f64, (i / width as usize) as f64];
            t.apply(place, middle).map(snapped)
        };
        let at = |i: usize| (values.at(place(i)) as f32, deviation.at(place(i)) as f32);
        let (values, deviation) = (0..count).map(at).unzip();
        Self { width, height, values, deviation }
    }

    /// How steep it is at a pixel, heights a pixel, by the neighbours that have a height.
    pub(super) fn slope(&self, i: usize) -> f64 {
        let (width, x) = (self.width as usize, i % self.width as usize);
        let along = |before: Option<usize>, after: Option<usize>| {
            let known =
                |i: Option<usize>| i.and_then(|i| self.values.get(i)).map(|v| f64::from(*v)).filter(|v| v.is_finite());
            let (here, before, after) = (known(Some(i)), known(before), known(after));
            let steps = [before.zip(here), here.zip(after)].map(|pair| pair.map(|(a, b)| b - a));
            let (sum, count) = steps.iter().flatten().fold((0.0, 0.0), |(sum, n), step| (sum + step, n + 1.0));
            if count > 0.0 { sum / count } else { 0.0 }
        };
        let across = along((x > 0).then(|| i - 1), (x + 1 < width).then(|| i + 1));
        across.hypot(along(i.checked_sub(width), Some(i + width)))
    }
}

/// No height, and no deviation.
const NONE: (f32, f32) = (f32::NAN, f32::NAN);

/// A place that is a pixel but for rounding: beside a hole a weight of 1e-16 would lose it.
fn snapped(place: f64) -> f64 {
    if (place - place.round()).abs() < 1e-6 { place.round() } else { place }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_read_where_the_similarity_leads() {
        let plane = |x: f64, y: f64| 3.0 + 0.2 * x - 0.1 * y;
        let values: Vec<f32> = (0..40 * 30).map(|i| plane((i % 40) as f64, (i / 40) as f64) as f32).collect();
        let heights = Heights::new([40, 30], &values, &[0.5; 1200]).unwrap();
        let t = Similarity::new(2.3, -1.6, 9.0, 1.05);
        let moved = heights.onto([36, 28], &t);
        for (x, y) in [(10usize, 12usize), (18, 14), (25, 9)] {
            let [u, v] = t.apply([x as f64, y as f64], centre(36, 28));
            let found = f64::from(moved.values[y * 36 + x]);
            assert!((found - plane(u, v)).abs() < 1e-5, "{found}");
            assert!((moved.deviation[y * 36 + x] - 0.5).abs() < 1e-6);
            assert!((heights.slope(y * 40 + x) - 0.2f64.hypot(0.1)).abs() < 1e-5);
        }
        assert!((heights.slope(0) - 0.2f64.hypot(0.1)).abs() < 1e-5, "in a corner by one side");
        assert_eq!(heights.onto([40, 30], &Similarity::IDENTITY), heights);
    }

    #[test]
    fn a_height_without_a_deviation_is_none() {
        let nan = f32::NAN;
        let heights = Heights::new([5, 1], &[1.0, 2.0, nan, 4.0, 5.0], &[0.1, nan, 0.1, f32::INFINITY, 0.0]).unwrap();
        let known: Vec<bool> = heights.values.iter().map(|v| v.is_finite()).collect();
        assert_eq!(known, [true, false, false, false, true]);
        assert!(Heights::new([2, 2], &[1.0; 4], &[1.0; 3]).is_err());
    }
}
