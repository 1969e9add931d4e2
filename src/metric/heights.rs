//! Height maps with standard deviations.

use super::evidence::evidence;
use super::measure::Values;
use super::response::Detail;
use crate::base::{Error, Region, Similarity, centre};

/// A height map, in any unit, greater towards the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Heights {
    /// Width of both fields, px.
    pub width: u32,
    /// Height of both fields, px.
    pub height: u32,
    /// Row-major heights. NaN marks pixels without a height.
    pub values: Vec<f32>,
    /// Standard deviations, in the unit of the heights. NaN where there is no height.
    pub deviation: Vec<f32>,
    /// Standard deviations of the height of one part: `deviation`, unless the map is the mean of several parts.
    pub part_deviation: Vec<f32>,
    /// The evidence for each height: the standard deviation of the picture's texture over that of its noise. Infinite
    /// where it is not known; NaN outside of the picture.
    pub evidence: Vec<f32>,
    /// Of a golden part, by how much the evidence of a good part may fall short of it at a pixel, as a factor: 1, unless
    /// good parts have texture of their own.
    pub spread: f32,
    /// The detail that the map resolves, if it is known.
    pub detail: Option<Detail>,
}

impl Heights {
    /// Makes a height map from row-major fields, with evidence that is not known. Pixels whose height or standard
    /// deviation is not finite have no height.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if a field has another size.
    pub fn new([width, height]: [u32; 2], values: &[f32], deviation: &[f32]) -> Result<Self, Error> {
        let pixels = width as usize * height as usize;
        if [values.len(), deviation.len()] != [pixels; 2] {
            let lengths = format!("{} heights and {} deviations", values.len(), deviation.len());
            return Err(Error::Mismatch(format!("{lengths} do not match {width}x{height} pixels")));
        }
        let is_valid = |v: f32, s: f32| v.is_finite() && s.is_finite() && s >= 0.0;
        let pixel = |(&v, &s): (&f32, &f32)| if is_valid(v, s) { (v, s) } else { (f32::NAN, f32::NAN) };
        let (values, deviation): (_, Vec<f32>) = values.iter().zip(deviation).map(pixel).unzip();
        let part_deviation = deviation.clone();
        Ok(Self {
            width,
            height,
            values,
            deviation,
            part_deviation,
            evidence: vec![f32::INFINITY; pixels],
            spread: 1.0,
            detail: None,
        })
    }

    fn check_size(&self, what: &str, values: &[f32]) -> Result<(), Error> {
        let (found, heights) = (values.len(), self.values.len());
        let mismatch = || Error::Mismatch(format!("{what} of {found} pixels for {heights} heights"));
        if found == heights { Ok(()) } else { Err(mismatch()) }
    }

    /// Sets the evidence for the heights.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it has another size.
    pub fn with_evidence(self, evidence: Vec<f32>) -> Result<Self, Error> {
        self.check_size("evidence", &evidence)?;
        Ok(Self { evidence, ..self })
    }

    /// Sets the evidence for the heights from a grey picture of the part and from what a solve does not explain, its
    /// residual, both in intensities.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if one has another size.
    pub fn with_picture(self, picture: &[f32], residual: &[f32]) -> Result<Self, Error> {
        self.check_size("a picture", picture)?;
        self.check_size("a residual", residual)?;
        let evidence = evidence(picture, residual, self.width as usize);
        self.with_evidence(evidence)
    }

    /// Sets the detail that the map resolves.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it has another size.
    pub fn with_detail(self, detail: Detail) -> Result<Self, Error> {
        self.check_size("sensitivities", &detail.sensitivity)?;
        Ok(Self { detail: Some(detail), ..self })
    }

    /// Takes from the standard deviations an error of one standard deviation that all heights have in common. A height
    /// whose error is not finite, or greater than its standard deviation, becomes a missing one.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it has another size.
    pub fn without_common(mut self, common: &[f32]) -> Result<Self, Error> {
        self.check_size("errors", common)?;
        for ((value, sigma), common) in self.values.iter_mut().zip(&mut self.deviation).zip(common) {
            // Both were rounded, by a few times 6e-8 of their value: an error that is all of it may exceed it by that.
            if common.abs() <= *sigma * (1.0 + 1e-6) {
                *sigma = (*sigma * *sigma - common * common).max(0.0).sqrt();
            } else {
                (*value, *sigma) = (f32::NAN, f32::NAN);
            }
        }
        self.part_deviation.clone_from(&self.deviation);
        Ok(self)
    }

    /// Sets the standard deviations of the height of one part, for a mean of several.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it has another size.
    pub fn with_part_deviation(self, part_deviation: Vec<f32>) -> Result<Self, Error> {
        self.check_size("deviations", &part_deviation)?;
        Ok(Self { part_deviation, ..self })
    }

    /// Returns the map with heights within these regions only, or all of it if there are none.
    ///
    /// # Errors
    /// [`Error::Region`] for a region without pixels, or not within the map.
    pub fn within(mut self, regions: &[Region]) -> Result<Self, Error> {
        regions.iter().try_for_each(|region| region.check((self.width, self.height)))?;
        let width = self.width as usize;
        let is_within = |i: usize, region: &Region| {
            let (x, y) = ((i % width) as u32, (i / width) as u32);
            (region.x..region.x + region.width).contains(&x) && (region.y..region.y + region.height).contains(&y)
        };
        let is_outside = |i: &usize| !regions.is_empty() && !regions.iter().any(|region| is_within(*i, region));
        for i in (0..self.values.len()).filter(is_outside) {
            (self.values[i], self.deviation[i]) = (f32::NAN, f32::NAN);
        }
        Ok(self)
    }

    /// Returns the map without the heights for which there is less evidence.
    pub(super) fn supported(&self, least: f32) -> Self {
        let keep = |field: &[f32]| {
            let pixels = field.iter().zip(&self.evidence);
            pixels.map(|(value, evidence)| if *evidence < least { f32::NAN } else { *value }).collect()
        };
        let (values, deviation) = (keep(&self.values), keep(&self.deviation));
        Self { values, deviation, ..self.clone() }
    }

    /// Samples the map at `T x` for each pixel x of an image of the given size, with T about its centre.
    ///
    /// The fields are interpolated bilinearly. Errors of adjacent pixels are correlated, so that interpolation does
    /// not reduce the standard deviation.
    pub fn resample(&self, [width, height]: [u32; 2], t: &Similarity) -> Self {
        let fields = [&self.values, &self.deviation, &self.part_deviation, &self.evidence];
        let (middle, count) = (centre(width, height), width as usize * height as usize);
        let point = |i: usize| {
            let pixel = [(i % width as usize) as f64, (i / width as usize) as f64];
            t.apply(pixel, middle).map(snap_to_pixel)
        };
        let moved = |values: &Vec<f32>| -> Vec<f32> {
            let field = Values { width: self.width, values };
            (0..count).map(|i| field.at(point(i)) as f32).collect()
        };
        let [values, deviation, part_deviation, evidence] = fields.map(moved);
        let moved = |detail: &Detail| Detail { sensitivity: moved(&detail.sensitivity), ..*detail };
        let detail = self.detail.as_ref().map(moved);
        Self { width, height, values, deviation, part_deviation, evidence, spread: self.spread, detail }
    }

    /// Returns the slope at a pixel, in heights per pixel, from the adjacent pixels that have a height.
    pub(super) fn slope(&self, i: usize) -> f64 {
        let (width, x) = (self.width as usize, i % self.width as usize);
        let along = |before: Option<usize>, after: Option<usize>| {
            let height =
                |i: Option<usize>| i.and_then(|i| self.values.get(i)).map(|v| f64::from(*v)).filter(|v| v.is_finite());
            let (here, before, after) = (height(Some(i)), height(before), height(after));
            let steps = [before.zip(here), here.zip(after)].map(|pair| pair.map(|(a, b)| b - a));
            let (sum, count) = steps.iter().flatten().fold((0.0, 0.0), |(sum, n), step| (sum + step, n + 1.0));
            if count > 0.0 { sum / count } else { 0.0 }
        };
        let across = along((x > 0).then(|| i - 1), (x + 1 < width).then(|| i + 1));
        across.hypot(along(i.checked_sub(width), Some(i + width)))
    }
}

/// Removes rounding errors of a coordinate, since a weight of 1e-16 for a missing pixel would make the sample NaN.
fn snap_to_pixel(coordinate: f64) -> f64 {
    if (coordinate - coordinate.round()).abs() < 1e-6 { coordinate.round() } else { coordinate }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_sampled_at_the_transformed_pixels() {
        let plane = |x: f64, y: f64| 3.0 + 0.2 * x - 0.1 * y;
        let values: Vec<f32> = (0..40 * 30).map(|i| plane((i % 40) as f64, (i / 40) as f64) as f32).collect();
        let heights = Heights::new([40, 30], &values, &[0.5; 1200]).unwrap();
        let t = Similarity::new(2.3, -1.6, 9.0, 1.05);
        let moved = heights.resample([36, 28], &t);
        for (x, y) in [(10usize, 12usize), (18, 14), (25, 9)] {
            let [u, v] = t.apply([x as f64, y as f64], centre(36, 28));
            let found = f64::from(moved.values[y * 36 + x]);
            assert!((found - plane(u, v)).abs() < 1e-5, "{found}");
            assert!((moved.deviation[y * 36 + x] - 0.5).abs() < 1e-6);
            assert!((heights.slope(y * 40 + x) - 0.2f64.hypot(0.1)).abs() < 1e-5);
        }
        assert!((heights.slope(0) - 0.2f64.hypot(0.1)).abs() < 1e-5, "one-sided in a corner");
        assert_eq!(heights.resample([40, 30], &Similarity::IDENTITY), heights);
    }

    #[test]
    fn regions_leave_out_the_rest() {
        let heights = Heights::new([4, 2], &[1.0; 8], &[0.1; 8]).unwrap();
        let regions = [(0, 0, 1, 2), (2, 1, 2, 1)].map(|(x, y, width, height)| Region { x, y, width, height });
        let is_valid: Vec<bool> =
            heights.clone().within(&regions).unwrap().values.iter().map(|v| v.is_finite()).collect();
        assert_eq!(is_valid, [true, false, false, false, true, false, true, true]);
        assert_eq!(heights.clone().within(&[]).unwrap(), heights);
        let beyond = Region { x: 3, y: 1, width: 2, height: 1 };
        assert!(heights.within(&[beyond]).unwrap_err().to_string().contains("not within the image"));
    }

    #[test]
    fn a_pixel_without_a_standard_deviation_has_no_height() {
        let nan = f32::NAN;
        let heights = Heights::new([5, 1], &[1.0, 2.0, nan, 4.0, 5.0], &[0.1, nan, 0.1, f32::INFINITY, 0.0]).unwrap();
        let is_valid: Vec<bool> = heights.values.iter().map(|v| v.is_finite()).collect();
        assert_eq!(is_valid, [true, false, false, false, true]);
        assert!(Heights::new([2, 2], &[1.0; 4], &[1.0; 3]).is_err());
    }

    #[test]
    fn a_height_whose_common_error_exceeds_its_standard_deviation_is_missing() {
        let heights = Heights::new([6, 1], &[1.0; 6], &[0.5, 0.5, 0.5, 0.5, 0.5, 0.0]).unwrap();
        let common = [0.3, -0.3, 0.500_000_1, 0.6, f32::NAN, 0.0];
        let found = heights.clone().without_common(&common).unwrap();
        let is_valid: Vec<bool> = found.values.iter().map(|v| v.is_finite()).collect();
        assert_eq!(is_valid, [true, true, true, false, false, true]);
        assert!((found.deviation[0] - 0.4).abs() < 1e-6 && (found.deviation[1] - 0.4).abs() < 1e-6);
        assert_eq!((found.deviation[2], found.deviation[5]), (0.0, 0.0));
        assert!(found.deviation[3].is_nan() && found.deviation[4].is_nan());
        assert_eq!(found.part_deviation[..3], found.deviation[..3]);
        assert!(heights.without_common(&[0.0; 5]).is_err());
    }
}
