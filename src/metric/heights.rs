//! Height maps with standard deviations, and the plane of a height difference.

use nalgebra::{Matrix3, Vector3};

use super::measure::Values;
use crate::base::statistics::{deviation, tukey};
use crate::base::{Error, Similarity, centre};

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
}

impl Heights {
    /// Makes a height map from row-major fields. Pixels whose height or standard deviation is not finite have no
    /// height.
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
        let (values, deviation) = values.iter().zip(deviation).map(pixel).unzip();
        Ok(Self { width, height, values, deviation })
    }

    /// Samples the map at `T x` for each pixel x of an image of the given size, with T about its centre.
    ///
    /// Both fields are interpolated bilinearly. Errors of adjacent pixels are correlated, so that interpolation does
    /// not reduce the standard deviation.
    pub fn resample(&self, [width, height]: [u32; 2], t: &Similarity) -> Self {
        let [values, deviation] = [&self.values, &self.deviation].map(|values| Values { width: self.width, values });
        let (middle, count) = (centre(width, height), width as usize * height as usize);
        let point = |i: usize| {
            let pixel = [(i % width as usize) as f64, (i / width as usize) as f64];
            t.apply(pixel, middle).map(snap_to_pixel)
        };
        let at = |i: usize| (values.at(point(i)) as f32, deviation.at(point(i)) as f32);
        let (values, deviation) = (0..count).map(at).unzip();
        Self { width, height, values, deviation }
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

/// The largest number of pixels for the fit of a plane; more are subsampled, since three parameters need no more.
const MAX_POINTS: usize = 1 << 16;
/// The smallest number of pixels.
const MIN_POINTS: usize = 16;
/// Iterations towards least absolute deviations, which have a unique minimum. After a dozen they exclude a defect of
/// any height on less than a quarter of the part. A larger defect at one side gives a tilt.
const L1_ITERATIONS: usize = 30;
/// Iterations with Tukey's biweight after them, which excludes defects entirely.
const TUKEY_ITERATIONS: usize = 10;

/// A plane of heights over an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Plane {
    /// The height at the centre of the image.
    pub offset: f64,
    /// The slope to the right and downwards, in heights per pixel.
    pub slope: [f64; 2],
}

impl Plane {
    /// Returns the height at a point, px, of an image of the given size.
    pub fn at(&self, [x, y]: [f64; 2], [width, height]: [u32; 2]) -> f64 {
        let [cx, cy] = centre(width, height);
        self.offset + self.slope[0] * (x - cx) + self.slope[1] * (y - cy)
    }

    /// Subtracts the plane from the values of an image.
    pub(super) fn subtract_from(&self, size: [u32; 2], values: &mut [f32]) {
        let width = size[0] as usize;
        for (i, value) in values.iter_mut().enumerate() {
            *value = (f64::from(*value) - self.at([(i % width) as f64, (i / width) as f64], size)) as f32;
        }
    }

    /// Fits a plane to the finite values, robustly. `None` if there are too few, or all lie on a line.
    pub(super) fn fit(size: [u32; 2], values: &[f32]) -> Option<Self> {
        // Coordinates are scaled by half of the longer side, so that the sums have similar magnitudes.
        let ([cx, cy], half) = (centre(size[0], size[1]), f64::from(size[0].max(size[1])) / 2.0);
        let points: Vec<Vector3<f64>> =
            subsample(size, values).map(|[x, y, v]| Vector3::new((x - cx) / half, (y - cy) / half, v)).collect();
        if points.len() < MIN_POINTS {
            return None;
        }
        let mut plane = fit_weighted(&points, &Vector3::zeros(), |_| 1.0)?;
        for _ in 0..L1_ITERATIONS {
            // Positive even if all points are on the plane.
            let scale = (0.1 * scatter(&points, &plane)).max(1e-12);
            plane = fit_weighted(&points, &plane, |r| scale / r.abs().max(scale))?;
        }
        for _ in 0..TUKEY_ITERATIONS {
            let scale = scatter(&points, &plane).max(1e-12);
            plane = fit_weighted(&points, &plane, |r| tukey(r / scale))?;
        }
        Some(Self { offset: plane[2], slope: [plane[0] / half, plane[1] / half] })
    }
}

/// Returns positions and finite values of at most [`MAX_POINTS`] pixels, evenly spaced in rows and columns.
fn subsample([width, height]: [u32; 2], values: &[f32]) -> impl Iterator<Item = [f64; 3]> {
    let (pixels, width) = (width as usize * height as usize, width as usize);
    let step = ((pixels as f64 / MAX_POINTS as f64).sqrt().ceil() as usize).max(1);
    let is_selected = move |i: &usize| (i % width).is_multiple_of(step) && (i / width).is_multiple_of(step);
    let point = move |i: usize| [(i % width) as f64, (i / width) as f64, f64::from(values[i])];
    (0..pixels).filter(is_selected).map(point).filter(|[.., v]| v.is_finite())
}

/// Returns the residual of a point from the plane `[slope x, slope y, offset]`.
fn residual(point: &Vector3<f64>, plane: &Vector3<f64>) -> f64 {
    point[2] - plane[0] * point[0] - plane[1] * point[1] - plane[2]
}

/// Returns the robust standard deviation of the residuals.
fn scatter(points: &[Vector3<f64>], plane: &Vector3<f64>) -> f64 {
    deviation(&points.iter().map(|point| residual(point, plane)).collect::<Vec<_>>())
}

/// Fits a plane by least squares, weighted by the residuals from the previous plane. `None` if the points are on a
/// line.
fn fit_weighted(points: &[Vector3<f64>], plane: &Vector3<f64>, weight: impl Fn(f64) -> f64) -> Option<Vector3<f64>> {
    let (mut matrix, mut side) = (Matrix3::zeros(), Vector3::zeros());
    for point in points {
        let (row, weight) = (Vector3::new(point[0], point[1], 1.0), weight(residual(point, plane)));
        matrix += weight * row * row.transpose();
        side += weight * point[2] * row;
    }
    // For points on a line the determinant is only rounding error.
    let is_plane = matrix.determinant() > 1e-12 * matrix.trace().powi(3);
    matrix.cholesky().filter(|_| is_plane).map(|factors| factors.solve(&side))
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
    fn a_pixel_without_a_standard_deviation_has_no_height() {
        let nan = f32::NAN;
        let heights = Heights::new([5, 1], &[1.0, 2.0, nan, 4.0, 5.0], &[0.1, nan, 0.1, f32::INFINITY, 0.0]).unwrap();
        let is_valid: Vec<bool> = heights.values.iter().map(|v| v.is_finite()).collect();
        assert_eq!(is_valid, [true, false, false, false, true]);
        assert!(Heights::new([2, 2], &[1.0; 4], &[1.0; 3]).is_err());
    }

    const SIZE: [u32; 2] = [60, 40];

    fn field(of: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        (0..60 * 40).map(|i| of((i % 60) as f64, (i / 60) as f64) as f32).collect()
    }

    #[test]
    fn a_defect_on_a_fifth_of_the_part_does_not_tilt_the_plane() {
        let plane = Plane { offset: 4.0, slope: [0.02, -0.05] };
        for height in [0.5, 20.0] {
            let values = field(|x, y| plane.at([x, y], SIZE) + if x > 47.0 { height } else { 0.0 });
            let found = Plane::fit(SIZE, &values).unwrap();
            let corner = found.at([0.0, 0.0], SIZE) - plane.at([0.0, 0.0], SIZE);
            assert!(corner.abs() < 1e-3 * height, "{found:?}");
        }
    }

    #[test]
    fn too_few_or_collinear_points_have_no_plane() {
        let nan = f64::NAN;
        assert_eq!(Plane::fit(SIZE, &field(|_, _| nan)), None);
        assert_eq!(Plane::fit(SIZE, &field(|_, y| if y == 3.0 { 1.0 } else { nan })), None, "a line");
        let flat = Plane::fit(SIZE, &field(|_, _| 2.0)).unwrap();
        assert!((flat.offset - 2.0).abs() < 1e-9 && flat.slope[0].abs().max(flat.slope[1].abs()) < 1e-9);
    }

    #[test]
    fn many_pixels_are_subsampled() {
        let size = [800, 300];
        let values: Vec<f32> = (0..240_000).map(|i| 0.01 * (i % 800) as f32).collect();
        assert!(subsample(size, &values).count() <= MAX_POINTS);
        assert!((Plane::fit(size, &values).unwrap().slope[0] - 0.01).abs() < 1e-6);
    }
}
