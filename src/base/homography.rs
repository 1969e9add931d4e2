//! The registration in general: a projective map about the image centre.

use super::similarity::{Similarity, centre};

/// Where 1 + g·p falls to this, T is cut off: beyond its horizon nothing has an image, and a pixel near it or beyond lands
/// far outside. The engine's shaders have the same.
const HORIZON: f64 = 0.1;
/// Two numbers of a matrix that differ by less are equal: 0.003 px at 3000 px from the centre, some units of the engine's
/// single precision.
const EQUAL: f64 = 1e-6;

/// `T x = c + (M p + t)/(1 + g·p)`, with `p = x - c`, c the image centre `((W-1)/2, (H-1)/2)`, x right and y down.
///
/// `I2(T x)` lines up with `I1(x)`. With g = 0 it is an affine map, with M = s R(θ) besides a [`Similarity`].
///
/// Stored as `{"tx_px", "ty_px", "rotation_deg", "scale"}`, what T does at the centre; unless it is a similarity also
/// `"matrix"`, `[[M, t], [g, 1]]` by rows, which then rules.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::stored::Homography", into = "super::stored::Homography")
)]
pub struct Homography {
    /// `[[M, t], [gᵀ, 1]]`.
    matrix: [[f64; 3]; 3],
}

impl Homography {
    /// The map that moves nothing.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// From `[[M, t], [g, k]]` by rows, of points from the centre in pixels, k not 0; `None` where it has no inverse, mirrors,
    /// or is not of finite numbers.
    pub fn from_matrix(matrix: [[f64; 3]; 3]) -> Option<Self> {
        let found = Self { matrix: matrix.map(|row| row.map(|v| v / matrix[2][2])) };
        let finite = found.matrix.iter().flatten().all(|v| v.is_finite());
        (finite && determinant(&found.jacobian()) > 0.0).then_some(found)
    }

    /// `[[M, t], [g, 1]]` by rows: of points from the centre, pixels.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        self.matrix
    }

    /// Where T takes the centre, from there: t, pixels.
    pub fn translation(&self) -> [f64; 2] {
        [self.matrix[0][2], self.matrix[1][2]]
    }

    /// g, 1/px: how fast scale changes over the image.
    pub fn perspective(&self) -> [f64; 2] {
        [self.matrix[2][0], self.matrix[2][1]]
    }

    /// What T does to what is small, at the centre: `M - t gᵀ`.
    pub fn jacobian(&self) -> [[f64; 2]; 2] {
        let ([tx, ty], [gx, gy], m) = (self.translation(), self.perspective(), &self.matrix);
        [[m[0][0] - tx * gx, m[0][1] - tx * gy], [m[1][0] - ty * gx, m[1][1] - ty * gy]]
    }

    /// s at the centre: the root of what T does to areas there.
    pub fn scale(&self) -> f64 {
        determinant(&self.jacobian()).abs().sqrt()
    }

    /// θ at the centre in radians, from x towards y: of the rotation nearest to T.
    pub fn rotation(&self) -> f64 {
        let [[xx, xy], [yx, yy]] = self.jacobian();
        (yx - xy).atan2(xx + yy)
    }

    /// Rotation at the centre in degrees.
    pub fn rotation_deg(&self) -> f64 {
        self.rotation().to_degrees()
    }

    /// The similarity that does at the centre what T does there, but for shear.
    pub fn at_centre(&self) -> Similarity {
        let [tx, ty] = self.translation();
        Similarity { tx, ty, rotation: self.rotation(), scale: self.scale() }
    }

    /// Whether T is affine.
    pub fn is_affine(&self) -> bool {
        // g is per pixel: times 3000 px as small as the others.
        self.perspective().iter().all(|g| g.abs() < EQUAL / 3000.0)
    }

    /// T as a similarity, if it is one.
    pub fn similarity(&self) -> Option<Similarity> {
        let [[xx, xy, _], [yx, yy, _], _] = self.matrix;
        let conformal = (xx - yy).abs() < EQUAL && (xy + yx).abs() < EQUAL;
        (self.is_affine() && conformal).then(|| self.at_centre())
    }

    /// `T x` for a point and a centre, both in pixels.
    pub fn apply(&self, [x, y]: [f64; 2], [cx, cy]: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = self.displacement([x - cx, y - cy]);
        [x + dx, y + dy]
    }

    /// `T x - x` of a point from the centre, pixels.
    pub fn displacement(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let m = &self.matrix;
        let depth = m[2][0] * x + m[2][1] * y;
        let over = 1.0 / (1.0 + depth).max(HORIZON);
        [
            over * (m[0][2] + (m[0][0] - 1.0) * x + m[0][1] * y - depth * x),
            over * (m[1][2] + m[1][0] * x + (m[1][1] - 1.0) * y - depth * y),
        ]
    }

    /// The map that undoes this one.
    pub fn inverse(&self) -> Self {
        let m = &self.matrix;
        let minor = |i: usize, j: usize| {
            let ([a, b], [c, d]) = ([(i + 1) % 3, (i + 2) % 3], [(j + 1) % 3, (j + 2) % 3]);
            m[a][c] * m[b][d] - m[a][d] * m[b][c]
        };
        Self::normalised(std::array::from_fn(|i| std::array::from_fn(|j| minor(j, i))))
    }

    /// The map that applies `first` and then this one.
    pub fn after(&self, first: &Self) -> Self {
        Self::normalised(product(&self.matrix, &first.matrix))
    }

    /// The same map of the plane, whose centre is `to` instead of `from`, both in the pixels of either image.
    pub fn about(&self, from: [f64; 2], to: [f64; 2]) -> Self {
        let shift = |by: f64| {
            let [x, y] = [0, 1].map(|i| by * (to[i] - from[i]));
            [[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]
        };
        Self::normalised(product(&shift(-1.0), &product(&self.matrix, &shift(1.0))))
    }

    /// The same map where pixels are `by` times as many.
    pub fn scaled(&self, by: f64) -> Self {
        let [[xx, xy, tx], [yx, yy, ty], [gx, gy, one]] = self.matrix;
        Self { matrix: [[xx, xy, by * tx], [yx, yy, by * ty], [gx / by, gy / by, one]] }
    }

    /// The largest distance in pixels between where the two maps put a corner of a `width` x `height` image.
    pub fn corner_distance(&self, other: impl Into<Self>, width: u32, height: u32) -> f64 {
        let (c, other) = (centre(width, height), other.into());
        corners(c).map(|corner| distance(self.apply(corner, c), other.apply(corner, c))).into_iter().fold(0.0, f64::max)
    }

    fn normalised(matrix: [[f64; 3]; 3]) -> Self {
        Self { matrix: matrix.map(|row| row.map(|v| v / matrix[2][2])) }
    }
}

impl Default for Homography {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl From<Similarity> for Homography {
    fn from(t: Similarity) -> Self {
        let [a, b, tx, ty] = t.displacement();
        Self { matrix: [[1.0 + a, -b, tx], [b, 1.0 + a, ty], [0.0, 0.0, 1.0]] }
    }
}

impl From<&Similarity> for Homography {
    fn from(t: &Similarity) -> Self {
        Self::from(*t)
    }
}

impl From<&Homography> for Homography {
    fn from(t: &Homography) -> Self {
        *t
    }
}

/// The corners of an image with this centre.
pub(crate) fn corners([cx, cy]: [f64; 2]) -> [[f64; 2]; 4] {
    [[0.0, 0.0], [2.0 * cx, 0.0], [0.0, 2.0 * cy], [2.0 * cx, 2.0 * cy]]
}

fn distance(p: [f64; 2], q: [f64; 2]) -> f64 {
    (p[0] - q[0]).hypot(p[1] - q[1])
}

fn determinant([[a, b], [c, d]]: &[[f64; 2]; 2]) -> f64 {
    a * d - b * c
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Homography {
        Homography::from_matrix([[1.05, -0.03, 1.3], [0.02, 0.98, -0.9], [1e-5, -2e-5, 1.0]]).unwrap()
    }

    #[test]
    fn of_a_similarity_it_is_that_similarity() {
        let similarity = Similarity::new(1.3, -0.9, 12.0, 1.07);
        let map = Homography::from(similarity);
        let (c, p) = (centre(101, 51), [3.0, 7.0]);
        assert!(distance(map.apply(p, c), similarity.apply(p, c)) < 1e-12);
        let back = map.similarity().unwrap();
        assert!(back.corner_distance(&similarity, 4000, 3000) < 1e-9);
        assert_eq!(example().similarity(), None);
    }

    #[test]
    fn inverse_composition_and_centre_agree() {
        let both = example().after(&example().inverse());
        assert!(both.corner_distance(Homography::IDENTITY, 4000, 3000) < 1e-9);
        let (c, p) = (centre(101, 51), [3.0, 7.0]);
        let (one_by_one, once) = (example().apply(example().apply(p, c), c), example().after(&example()).apply(p, c));
        assert!(distance(one_by_one, once) < 1e-9);
        let moved = example().about(c, [20.0, 30.0]);
        assert!(distance(moved.apply(p, [20.0, 30.0]), example().apply(p, c)) < 1e-9);
        let twice = example().scaled(2.0).displacement([14.0, 6.0]);
        assert!(distance(twice, example().displacement([7.0, 3.0]).map(|d| 2.0 * d)) < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_derivative_at_the_centre() {
        let (h, t) = (1e-4, example());
        let d = |p| t.displacement(p);
        let by_x = [0, 1].map(|i| (d([h, 0.0])[i] - d([-h, 0.0])[i]) / (2.0 * h));
        let by_y = [0, 1].map(|i| (d([0.0, h])[i] - d([0.0, -h])[i]) / (2.0 * h));
        let [[xx, xy], [yx, yy]] = t.jacobian();
        for (found, expected) in [(by_x[0] + 1.0, xx), (by_x[1], yx), (by_y[0], xy), (by_y[1] + 1.0, yy)] {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn what_mirrors_or_has_no_inverse_is_none() {
        for matrix in [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0]] {
            assert_eq!(Homography::from_matrix([matrix, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), None);
        }
        assert_eq!(Homography::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]]), None);
    }

    #[test]
    fn beyond_the_horizon_a_point_lands_outside() {
        let steep = Homography::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]]).unwrap();
        let [dx, _] = steep.displacement([200.0, 0.0]);
        assert!(dx.is_finite() && dx > 1000.0, "{dx}");
    }
}
