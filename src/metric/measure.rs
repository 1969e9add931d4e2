//! Measurements of a field: levels of regions, step heights, and profiles along lines.

use crate::base::Region;
use crate::base::statistics::level;
use crate::base::{Error, Estimate};

/// The smallest number of valid pixels for a level.
const MIN_PIXELS: usize = 16;

/// Row-major values of an image. NaN marks pixels without a value.
#[derive(Clone, Copy, Debug)]
pub struct Values<'a> {
    /// Width, px.
    pub width: u32,
    /// The values.
    pub values: &'a [f32],
}

impl Values<'_> {
    pub(crate) fn height(&self) -> u32 {
        (self.values.len() / self.width.max(1) as usize) as u32
    }

    /// Returns the level of a region: the median of its valid pixels after the subtraction of the tilt about their
    /// centre.
    ///
    /// The standard error accounts for the correlation of adjacent pixels, estimated from the autocorrelation of the
    /// residuals. Relief other than tilt counts as noise. Errors common to the region, of the lens or the scale of
    /// V, are not included. `None` if fewer than 16 pixels are valid.
    ///
    /// # Errors
    /// [`Error::Region`] if the region is not within the image.
    pub fn level(&self, region: Region) -> Result<Option<Estimate>, Error> {
        let values = self.region(region)?;
        let valid = values.iter().filter(|v| v.is_finite()).count();
        Ok(level(&values, region.width as usize).filter(|_| valid >= MIN_PIXELS))
    }

    /// Returns the level of `to` minus that of `from`. `None` if either has no level. Their errors are independent.
    ///
    /// # Errors
    /// As for [`level`](Self::level).
    pub fn step(&self, from: Region, to: Region) -> Result<Option<Estimate>, Error> {
        let levels = self.level(from)?.zip(self.level(to)?);
        Ok(levels.map(|(a, b)| Estimate {
            value: b.value - a.value,
            standard_error: a.standard_error.hypot(b.standard_error),
        }))
    }

    /// Returns the values along a line, at [`Line::points`].
    ///
    /// Each is the mean of the valid bilinear samples across the width of the line, 1 px apart. NaN if none is valid.
    ///
    /// # Errors
    /// [`Error::Region`] if the line is shorter than 1 px, its width is invalid, or an end lies outside the image.
    pub fn profile(&self, line: &Line) -> Result<Vec<f64>, Error> {
        line.check((self.width, self.height()))?;
        let [across_x, across_y] = line.across();
        let half = (line.width.max(1.0).round() - 1.0) / 2.0;
        let samples = (2.0 * half) as usize;
        Ok(line
            .points()
            .map(|[x, y]| {
                let offsets = (0..=samples).map(|i| i as f64 - half);
                let values = offsets.map(|d| self.at([x + d * across_x, y + d * across_y])).filter(|v| v.is_finite());
                let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
                sum / count
            })
            .collect())
    }

    /// Returns the values of a region, row-major.
    pub(crate) fn region(&self, region: Region) -> Result<Vec<f64>, Error> {
        region.check((self.width, self.height()))?;
        Ok(region.crop(self.values, self.width as usize, 1).into_iter().map(f64::from).collect())
    }

    /// Returns the bilinear sample at a point, px. NaN outside of the image, and next to a NaN pixel.
    pub(crate) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let (i, j) = (x.floor(), y.floor());
        let (a, b) = (x - i, y - j);
        let value = |i: f64, j: f64, weight: f64| {
            if weight == 0.0 {
                return 0.0;
            }
            if i < 0.0 || j < 0.0 || i >= f64::from(self.width) || j >= f64::from(self.height()) {
                return f64::NAN;
            }
            weight * f64::from(self.values[j as usize * self.width as usize + i as usize])
        };
        value(i, j, (1.0 - a) * (1.0 - b))
            + value(i + 1.0, j, a * (1.0 - b))
            + value(i, j + 1.0, (1.0 - a) * b)
            + value(i + 1.0, j + 1.0, a * b)
    }
}

/// A line segment in an image, px. The centre of the first pixel is (0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Line {
    /// The start, px.
    pub from: [f64; 2],
    /// The end, px.
    pub to: [f64; 2],
    /// The width over which a profile is averaged, px, 1 to 4096.
    pub width: f64,
}

impl Line {
    /// Checks that the line can be measured in an image of this width and height.
    pub(crate) fn check(&self, (width, height): (u32, u32)) -> Result<(), Error> {
        let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
        let is_inside = |[x, y]: [f64; 2]| (0.0..=right).contains(&x) && (0.0..=bottom).contains(&y);
        let [[x1, y1], [x2, y2]] = [self.from, self.to];
        let line = format!("the line {x1},{y1},{x2},{y2}");
        if !is_inside(self.from) || !is_inside(self.to) {
            return Err(Error::Region(format!(
                "{line} leaves the image: x runs from 0 to {right}, y from 0 to {bottom}"
            )));
        }
        if self.length() < 1.0 || !(1.0..=4096.0).contains(&self.width) {
            return Err(Error::Region(format!("{line} must be at least 1 px long and 1 to 4096 px wide")));
        }
        Ok(())
    }

    /// Returns the length, px.
    pub fn length(&self) -> f64 {
        (self.to[0] - self.from[0]).hypot(self.to[1] - self.from[1])
    }

    /// Returns the points of a profile, evenly spaced from end to end, at most 1 px apart.
    pub fn points(&self) -> impl Iterator<Item = [f64; 2]> + use<> {
        let ([x1, y1], [x2, y2], last) = (self.from, self.to, self.length().ceil().max(1.0));
        (0..=last as usize).map(move |i| {
            let share = i as f64 / last;
            [x1 + share * (x2 - x1), y1 + share * (y2 - y1)]
        })
    }

    /// Returns the unit vector to the right of the line's direction, with y down.
    fn across(&self) -> [f64; 2] {
        let length = self.length();
        [(self.from[1] - self.to[1]) / length, (self.to[0] - self.from[0]) / length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::statistics::tests::smooth_noise;

    fn region(x: u32, y: u32, width: u32, height: u32) -> Region {
        Region { x, y, width, height }
    }

    /// A ramp of 0.5 per column and -0.25 per row.
    fn ramp() -> Vec<f32> {
        (0..40 * 30).map(|i| 0.5 * (i % 40) as f32 - 0.25 * (i / 40) as f32).collect()
    }

    #[test]
    fn a_step_is_within_its_error_despite_outliers_and_missing_pixels() {
        let noise = smooth_noise([100, 40], 2.0, 5);
        let mut values: Vec<f32> =
            (0..4000).map(|i| (0.1 * noise[i] + if i % 100 < 50 { 1.0 } else { 3.5 }) as f32).collect();
        for i in (0..4000).step_by(37) {
            values[i] = if i % 2 == 0 { f32::NAN } else { 1e6 };
        }
        let field = Values { width: 100, values: &values };
        let step = field.step(region(2, 2, 40, 36), region(55, 2, 40, 36)).unwrap().unwrap();
        println!("{step:?}");
        assert!((step.value - 2.5).abs() < 3.0 * step.standard_error, "{step:?}");
        // 1440 px of noise with a correlation area of about 50 px².
        assert!((0.01..0.06).contains(&step.standard_error), "{step:?}");
    }

    #[test]
    fn the_level_of_a_tilted_region_is_that_of_its_centre() {
        let values = ramp();
        let level = Values { width: 40, values: &values }.level(region(10, 4, 21, 11)).unwrap().unwrap();
        assert!((level.value - (0.5 * 20.0 - 0.25 * 9.0)).abs() < 1e-5 && level.standard_error < 1e-5, "{level:?}");
    }

    #[test]
    fn a_profile_of_a_ramp_is_the_ramp() {
        let values = ramp();
        let field = Values { width: 40, values: &values };
        for width in [1.0, 4.0, 5.0] {
            let line = Line { from: [5.5, 20.0], to: [30.0, 10.25], width };
            let profile = field.profile(&line).unwrap();
            assert_eq!(profile.len(), 28);
            for ([x, y], v) in line.points().zip(profile) {
                assert!((v - (0.5 * x - 0.25 * y)).abs() < 1e-5, "{v} at {x}, {y}");
            }
        }
        let edge = field.profile(&Line { from: [0.0, 0.0], to: [39.0, 0.0], width: 1.0 }).unwrap();
        assert!(edge.iter().all(|v| v.is_finite()));
    }

    #[test]
    fn a_missing_pixel_is_a_gap_unless_others_across_the_line_are_valid() {
        let mut values = ramp();
        values[10 * 40 + 20] = f32::NAN;
        let field = Values { width: 40, values: &values };
        let along = |width| field.profile(&Line { from: [10.0, 10.0], to: [30.0, 10.0], width }).unwrap();
        assert_eq!(along(1.0).iter().filter(|v| v.is_nan()).count(), 1);
        assert!(along(3.0).iter().all(|v| v.is_finite()));
    }

    #[test]
    fn invalid_regions_and_lines_are_refused_with_a_reason() {
        let mut values = ramp();
        values[..400].fill(f32::NAN);
        let field = Values { width: 40, values: &values };
        for (bad, part) in [
            (region(0, 0, 41, 5), "not within the image, 40x30"),
            (region(u32::MAX, 0, 2, 2), "not within"),
            (region(3, 3, 0, 2), "not within"),
        ] {
            let message = field.level(bad).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        assert_eq!(field.level(region(0, 0, 40, 10)).unwrap(), None, "no pixel is valid");
        for line in [[[0.0, 0.0], [40.0, 0.0]], [[0.0, 0.0], [f64::NAN, 0.0]], [[3.0, 3.0], [3.0, 3.5]]] {
            assert!(field.profile(&Line { from: line[0], to: line[1], width: 1.0 }).is_err(), "{line:?}");
        }
    }
}
