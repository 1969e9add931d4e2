//! The plane that most of a difference of heights lies in.

use nalgebra::{Matrix3, Vector3};

use crate::base::centre;
use crate::base::statistics::{deviation, tukey};

/// Pixels that a plane is fitted to, evenly spread, if there are more: three numbers need no more of them.
const MOST: usize = 1 << 16;
/// The least of them.
const LEAST: usize = 16;
/// Fits by nearly least absolute values, which have one answer wherever they begin: a defect of any height on less
/// than a quarter of the part is left behind, wherever it lies, after a dozen; of more, at one side, a tilt is made.
const FIRST: usize = 30;
/// Fits by Tukey's weights after them, which leave defects out altogether.
const LAST: usize = 10;

/// A plane over a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Plane {
    /// The height at the centre of the picture.
    pub offset: f64,
    /// How much it rises to the right and downwards, heights a pixel.
    pub slope: [f64; 2],
}

impl Plane {
    /// Its height at a place of a picture of this size, px.
    pub fn at(&self, [x, y]: [f64; 2], [width, height]: [u32; 2]) -> f64 {
        let [cx, cy] = centre(width, height);
        self.offset + self.slope[0] * (x - cx) + self.slope[1] * (y - cy)
    }

    /// Values less the plane.
    pub(super) fn off(&self, size: [u32; 2], values: &mut [f32]) {
        let width = size[0] as usize;
        for (i, value) in values.iter_mut().enumerate() {
            *value = (f64::from(*value) - self.at([(i % width) as f64, (i / width) as f64], size)) as f32;
        }
    }

    /// The plane through most of the values that are numbers; `None` where there are too few, or all are on a line.
    pub(super) fn through(size: [u32; 2], values: &[f32]) -> Option<Self> {
        // Places about the centre, in halves of the longer side: sums of alike size.
        let ([cx, cy], reach) = (centre(size[0], size[1]), f64::from(size[0].max(size[1])) / 2.0);
        let points: Vec<Vector3<f64>> =
            spread(size, values).map(|[x, y, v]| Vector3::new((x - cx) / reach, (y - cy) / reach, v)).collect();
        if points.len() < LEAST {
            return None;
        }
        let mut found = refitted(&points, &Vector3::zeros(), |_| 1.0)?;
        for _ in 0..FIRST {
            // A number above zero: where all of it is on the plane already, it stays there.
            let scale = (0.1 * scatter(&points, &found)).max(1e-12);
            found = refitted(&points, &found, |r| scale / r.abs().max(scale))?;
        }
        for _ in 0..LAST {
            let scale = scatter(&points, &found).max(1e-12);
            found = refitted(&points, &found, |r| tukey(r / scale))?;
        }
        Some(Self { offset: found[2], slope: [found[0] / reach, found[1] / reach] })
    }
}

/// Places and values, of so many pixels at most, in rows and columns evenly spread.
fn spread([width, height]: [u32; 2], values: &[f32]) -> impl Iterator<Item = [f64; 3]> {
    let (pixels, width) = (width as usize * height as usize, width as usize);
    let step = ((pixels as f64 / MOST as f64).sqrt().ceil() as usize).max(1);
    let is_taken = move |i: &usize| (i % width).is_multiple_of(step) && (i / width).is_multiple_of(step);
    let point = move |i: usize| [(i % width) as f64, (i / width) as f64, f64::from(values[i])];
    (0..pixels).filter(is_taken).map(point).filter(|[.., v]| v.is_finite())
}

/// How far a value lies off the plane `[slope x, slope y, offset]`.
fn off(point: &Vector3<f64>, plane: &Vector3<f64>) -> f64 {
    point[2] - plane[0] * point[0] - plane[1] * point[1] - plane[2]
}

/// The standard deviation of values about a plane, by the median.
fn scatter(points: &[Vector3<f64>], plane: &Vector3<f64>) -> f64 {
    deviation(&points.iter().map(|point| off(point, plane)).collect::<Vec<_>>())
}

/// Least squares, weighted by how far values lie off the plane so far; `None` where the places are on a line.
fn refitted(points: &[Vector3<f64>], plane: &Vector3<f64>, weight: impl Fn(f64) -> f64) -> Option<Vector3<f64>> {
    let (mut matrix, mut side) = (Matrix3::zeros(), Vector3::zeros());
    for point in points {
        let (row, weight) = (Vector3::new(point[0], point[1], 1.0), weight(off(point, plane)));
        matrix += weight * row * row.transpose();
        side += weight * point[2] * row;
    }
    // Of places on a line the determinant is rounding.
    let is_plane = matrix.determinant() > 1e-12 * matrix.trace().powi(3);
    matrix.cholesky().filter(|_| is_plane).map(|factors| factors.solve(&side))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [60, 40];

    fn field(of: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        (0..60 * 40).map(|i| of((i % 60) as f64, (i / 60) as f64) as f32).collect()
    }

    #[test]
    fn a_defect_on_a_fifth_does_not_pull_it() {
        let plane = Plane { offset: 4.0, slope: [0.02, -0.05] };
        for height in [0.5, 20.0] {
            let values = field(|x, y| plane.at([x, y], SIZE) + if x > 47.0 { height } else { 0.0 });
            let found = Plane::through(SIZE, &values).unwrap();
            let corner = found.at([0.0, 0.0], SIZE) - plane.at([0.0, 0.0], SIZE);
            assert!(corner.abs() < 1e-3 * height, "{found:?}");
        }
    }

    #[test]
    fn what_is_no_plane_has_none() {
        let nan = f64::NAN;
        assert_eq!(Plane::through(SIZE, &field(|_, _| nan)), None);
        assert_eq!(Plane::through(SIZE, &field(|_, y| if y == 3.0 { 1.0 } else { nan })), None, "a line");
        let flat = Plane::through(SIZE, &field(|_, _| 2.0)).unwrap();
        assert!((flat.offset - 2.0).abs() < 1e-9 && flat.slope[0].abs().max(flat.slope[1].abs()) < 1e-9);
    }

    #[test]
    fn many_pixels_are_thinned() {
        let size = [800, 300];
        let values: Vec<f32> = (0..240_000).map(|i| 0.01 * (i % 800) as f32).collect();
        assert!(spread(size, &values).count() <= MOST);
        assert!((Plane::through(size, &values).unwrap().slope[0] - 0.01).abs() < 1e-6);
    }
}
