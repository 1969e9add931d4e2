//! The plane of a height difference: how a part lies in its fixture.

use nalgebra::{Matrix3, Vector3};

use crate::base::centre;
use crate::base::random::Random;
use crate::base::statistics::{TUKEY, deviation, median, tukey};

/// The largest number of pixels for the fit of a plane; more are subsampled, since three parameters need no more.
const MAX_POINTS: usize = 1 << 16;
/// The smallest number of pixels.
pub(super) const MIN_POINTS: usize = 16;
/// Iterations towards least absolute deviations, which have a unique minimum. After a dozen they exclude a defect of
/// any height on less than a quarter of the part. A larger defect at one side gives a tilt.
const L1_ITERATIONS: usize = 30;
/// Iterations with Tukey's biweight after them, which excludes defects entirely.
const TUKEY_ITERATIONS: usize = 10;
/// Cells along each side of the image. Planes through the medians of three cells are further starts of the biweight,
/// which has a minimum on either side of a step.
const CELLS: u32 = 8;
/// The number of triples of cells. One in eight lies on a given half of the part, so that some hundred of them do.
const TRIPLES: usize = 1000;
/// The largest number of pixels on which triples are compared, and the number of the best that are refined.
const MAX_COMPARED: usize = 1 << 12;
const REFINED: usize = 5;
/// The share of the pixels by which another plane must explain more than the one of least absolute deviations. Planes
/// that explain the same differ by noise only, and that one is the most level through most of the difference.
const LEAST_GAIN: f64 = 0.01;

/// A plane of heights over an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Plane {
    /// The height at the centre of the image.
    pub offset: f64,
    /// The slope to the right and downwards, in heights per pixel.
    pub slope: [f64; 2],
}

/// A pixel: its place, in halves of the longer side from the centre, its value, and the residual from which on it has
/// no weight.
struct Point {
    at: [f64; 2],
    value: f64,
    cutoff: f64,
}

impl Plane {
    /// Returns the height at a point, px, of an image of the given size.
    pub fn at(&self, [x, y]: [f64; 2], [width, height]: [u32; 2]) -> f64 {
        let [cx, cy] = centre(width, height);
        self.offset + self.slope[0] * (x - cx) + self.slope[1] * (y - cy)
    }

    /// Returns the tilt: the difference of the highest and the lowest corner of an image of the given size.
    pub fn tilt(&self, [width, height]: [u32; 2]) -> f64 {
        let sides = [width, height].map(|side| f64::from(side.saturating_sub(1)));
        self.slope.iter().zip(sides).map(|(slope, side)| slope.abs() * side).sum()
    }

    /// Subtracts the plane from the values of an image.
    pub(super) fn subtract_from(&self, size: [u32; 2], values: &mut [f32]) {
        let width = size[0] as usize;
        for (i, value) in values.iter_mut().enumerate() {
            *value = (f64::from(*value) - self.at([(i % width) as f64, (i / width) as f64], size)) as f32;
        }
    }

    /// Fits a plane to the finite values: that from which the fewest pixels, weighted by Tukey's biweight, are off by
    /// more than their `cutoff`. A step over up to half of the pixels is therefore no tilt. `None` if there are too few
    /// values, or all lie on a line.
    pub(super) fn fit(size: [u32; 2], values: &[f32], cutoff: impl Fn(usize) -> f64) -> Option<Self> {
        let half = f64::from(size[0].max(size[1])) / 2.0;
        let points = subsample(size, values, half, cutoff);
        if points.len() < MIN_POINTS {
            return None;
        }
        let level = least_absolute(&points)?;
        let step = points.len().div_ceil(MAX_COMPARED);
        let compared = |plane: &Vector3<f64>| unexplained(points.iter().step_by(step), plane);
        let mut others: Vec<(f64, Vector3<f64>)> =
            through_cells(size, half, &points).into_iter().map(|plane| (compared(&plane), plane)).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        let refined = |plane: Vector3<f64>| {
            let plane = refine(&points, plane);
            (unexplained(points.iter(), &plane), plane)
        };
        let level = refined(level);
        let other =
            others.into_iter().take(REFINED).map(|(_, plane)| refined(plane)).min_by(|a, b| a.0.total_cmp(&b.0));
        let (_, plane) = other.filter(|other| other.0 < level.0 - LEAST_GAIN).unwrap_or(level);
        Some(Self { offset: plane[2], slope: [plane[0] / half, plane[1] / half] })
    }
}

/// Returns the pixels with finite values, at most [`MAX_POINTS`], evenly spaced in rows and columns.
fn subsample(size: [u32; 2], values: &[f32], half: f64, cutoff: impl Fn(usize) -> f64) -> Vec<Point> {
    let ([cx, cy], width) = (centre(size[0], size[1]), size[0] as usize);
    let step = ((values.len() as f64 / MAX_POINTS as f64).sqrt().ceil() as usize).max(1);
    let is_selected =
        |i: &usize| (i % width).is_multiple_of(step) && (i / width).is_multiple_of(step) && values[*i].is_finite();
    // Coordinates are scaled by half of the longer side, so that the sums have similar magnitudes. A cutoff above 0
    // keeps the weights finite.
    let point = |i: usize| Point {
        at: [((i % width) as f64 - cx) / half, ((i / width) as f64 - cy) / half],
        value: f64::from(values[i]),
        cutoff: cutoff(i).max(1e-9),
    };
    (0..values.len()).filter(is_selected).map(point).collect()
}

/// Returns the plane of least absolute deviations. `None` if the points are on a line.
fn least_absolute(points: &[Point]) -> Option<Vector3<f64>> {
    let mut plane = fit_weighted(points, |_| 1.0)?;
    for _ in 0..L1_ITERATIONS {
        // Positive even if all points are on the plane.
        let residuals: Vec<f64> = points.iter().map(|point| residual(point, &plane)).collect();
        let scale = (0.1 * deviation(&residuals)).max(1e-12);
        plane = fit_weighted(points, |point| scale / residual(point, &plane).abs().max(scale))?;
    }
    Some(plane)
}

/// Returns planes through the medians of three cells of the image each, the same for the same points.
fn through_cells(size: [u32; 2], half: f64, points: &[Point]) -> Vec<Vector3<f64>> {
    let side = 2.0 * half / f64::from(CELLS);
    let mut cells: Vec<Vec<&Point>> = (0..CELLS * CELLS).map(|_| Vec::new()).collect();
    let index =
        |at: f64, length: u32| ((at * half + f64::from(length) / 2.0) / side).clamp(0.0, f64::from(CELLS - 1)) as usize;
    for point in points {
        cells[index(point.at[1], size[1]) * CELLS as usize + index(point.at[0], size[0])].push(point);
    }
    let middle = |cell: &Vec<&Point>| {
        let of = |value: &dyn Fn(&Point) -> f64| median(cell.iter().map(|point| value(point)));
        Some(Point { at: [of(&|p| p.at[0])?, of(&|p| p.at[1])?], value: of(&|p| p.value)?, cutoff: 1.0 })
    };
    let cells: Vec<Point> = cells.iter().filter_map(middle).collect();
    let mut random = Random::new(1, 0);
    let mut pick = || ((random.uniform() * cells.len() as f64) as usize).min(cells.len() - 1);
    let triples: Vec<[usize; 3]> = (0..TRIPLES).map(|_| [pick(), pick(), pick()]).collect();
    triples.into_iter().filter_map(|triple| through(triple.map(|n| &cells[n]))).collect()
}

/// Returns the plane through three points. `None` if they are on a line.
fn through(points: [&Point; 3]) -> Option<Vector3<f64>> {
    let rows = Matrix3::from_fn(|row, column| if column < 2 { points[row].at[column] } else { 1.0 });
    // Twice the area of the triangle: three cells in an L have 1/16.
    let is_plane = rows.determinant().abs() > 1e-2;
    rows.try_inverse().filter(|_| is_plane).map(|inverse| inverse * Vector3::from(points.map(|point| point.value)))
}

/// Refines a plane by Tukey's biweight with the points' own cutoffs. Returns the plane as it is if too few points are
/// within theirs.
fn refine(points: &[Point], mut plane: Vector3<f64>) -> Vector3<f64> {
    for _ in 0..TUKEY_ITERATIONS {
        let weight = |point: &Point| tukey(TUKEY * residual(point, &plane) / point.cutoff) / point.cutoff.powi(2);
        let Some(next) = fit_weighted(points, weight) else { return plane };
        plane = next;
    }
    plane
}

/// Returns the share of the points that a plane does not explain: the mean of Tukey's loss, which is 1 from the cutoff
/// on.
fn unexplained<'a>(points: impl Iterator<Item = &'a Point>, plane: &Vector3<f64>) -> f64 {
    let loss = |point: &Point| 1.0 - (1.0 - (residual(point, plane) / point.cutoff).powi(2)).max(0.0).powi(3);
    let (sum, count) = points.fold((0.0, 0.0), |(sum, count), point| (sum + loss(point), count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Returns the residual of a point from the plane `[slope x, slope y, offset]`.
fn residual(point: &Point, plane: &Vector3<f64>) -> f64 {
    point.value - plane[0] * point.at[0] - plane[1] * point.at[1] - plane[2]
}

/// Fits a plane by weighted least squares. `None` if the points with a weight are on a line.
fn fit_weighted(points: &[Point], weight: impl Fn(&Point) -> f64) -> Option<Vector3<f64>> {
    // Sums of plain numbers take a fraction of the time of sums of matrices.
    let mut sums = [0.0; 9];
    for point in points {
        let ([x, y], weight) = (point.at, weight(point));
        let [by_x, by_y, by_value] = [weight * x, weight * y, weight * point.value];
        let terms = [by_x * x, by_x * y, by_x, by_y * y, by_y, weight, by_value * x, by_value * y, by_value];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    let [xx, xy, x, yy, y, count, ..] = sums;
    let (matrix, side) = (Matrix3::new(xx, xy, x, xy, yy, y, x, y, count), Vector3::from_column_slice(&sums[6..]));
    // For points on a line the determinant is only rounding error.
    let is_plane = matrix.determinant() > 1e-12 * matrix.trace().powi(3);
    matrix.cholesky().filter(|_| is_plane).map(|factors| factors.solve(&side))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::statistics::tests::smooth_noise;

    const SIZE: [u32; 2] = [60, 40];

    fn field(of: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        (0..60 * 40).map(|i| of((i % 60) as f64, (i / 60) as f64) as f32).collect()
    }

    #[test]
    fn a_defect_on_a_fifth_of_the_part_does_not_tilt_the_plane() {
        let plane = Plane { offset: 4.0, slope: [0.02, -0.05] };
        for height in [0.5, 20.0] {
            let values = field(|x, y| plane.at([x, y], SIZE) + if x > 47.0 { height } else { 0.0 });
            let found = Plane::fit(SIZE, &values, |_| 0.1).unwrap();
            let corner = found.at([0.0, 0.0], SIZE) - plane.at([0.0, 0.0], SIZE);
            assert!(corner.abs() < 1e-3 * height, "{found:?}");
        }
    }

    #[test]
    fn too_few_or_collinear_points_have_no_plane() {
        let nan = f64::NAN;
        assert_eq!(Plane::fit(SIZE, &field(|_, _| nan), |_| 0.1), None);
        assert_eq!(Plane::fit(SIZE, &field(|_, y| if y == 3.0 { 1.0 } else { nan }), |_| 0.1), None, "a line");
        let flat = Plane::fit(SIZE, &field(|_, _| 2.0), |_| 0.1).unwrap();
        assert!((flat.offset - 2.0).abs() < 1e-9 && flat.slope[0].abs().max(flat.slope[1].abs()) < 1e-9);
    }

    #[test]
    fn many_pixels_are_subsampled() {
        let size = [800, 300];
        let values: Vec<f32> = (0..240_000).map(|i| 0.01 * (i % 800) as f32).collect();
        assert!(subsample(size, &values, 400.0, |_| 0.1).len() <= MAX_POINTS);
        assert!((Plane::fit(size, &values, |_| 0.1).unwrap().slope[0] - 0.01).abs() < 1e-6);
    }

    #[test]
    fn a_step_over_up_to_half_of_the_part_is_no_tilt() {
        let size = [90, 70];
        for seed in 0..6 {
            let (noise, mut random) = (smooth_noise([90, 70], 2.0, seed), Random::new(seed, 1));
            let tilted = Plane { offset: 1.0, slope: [0.02 * random.normal(), 0.02 * random.normal()] };
            let turn = std::f64::consts::TAU * random.uniform();
            for (share, height) in [(0.3, 1.5), (0.4, -1.5), (0.48, 1.5), (0.5, 3.0)] {
                // A step along a line across the part, with this share of the pixels beyond it.
                let along = |i: usize| turn.cos() * (i % 90) as f64 + turn.sin() * (i / 90) as f64;
                let mut sorted: Vec<f64> = (0..6300).map(along).collect();
                sorted.sort_by(f64::total_cmp);
                let line = sorted[((1.0 - share) * 6299.0) as usize];
                let at = |i: usize| tilted.at([(i % 90) as f64, (i / 90) as f64], size);
                let step = |i: usize| if along(i) > line { height } else { 0.0 };
                let values: Vec<f32> = (0..6300).map(|i| (at(i) + step(i) + 0.05 * noise[i]) as f32).collect();
                let found = Plane::fit(size, &values, |_| 1.0 / 3.0).unwrap();
                let off = Plane { offset: 0.0, slope: [0, 1].map(|n| found.slope[n] - tilted.slope[n]) };
                assert!(off.tilt(size) < 0.1, "{seed} {share} {height}: {off:?}");
            }
        }
    }

    #[test]
    fn a_bow_within_the_cutoff_tilts_nothing() {
        let bow = |x: f64, y: f64| 0.3 * (((x - 29.5) / 30.0).powi(2) + ((y - 19.5) / 30.0).powi(2));
        let found = Plane::fit(SIZE, &field(bow), |_| 1.0 / 3.0).unwrap();
        assert!(found.tilt(SIZE) < 0.02, "{found:?}");
    }
}
