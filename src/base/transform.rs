//! Transforms of the registration: similarities and homographies about the image centre.

/// A similarity about the image centre: `T x = c + s R(θ) (x - c) + t`.
///
/// c is the image centre `((W-1)/2, (H-1)/2)`, x points right and y down, in pixels. `I2(T x)` is registered to
/// `I1(x)`. Serialized as `{"tx_px", "ty_px", "rotation_deg", "scale"}`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(from = "serialized::Similarity", into = "serialized::Similarity")
)]
pub struct Similarity {
    /// Translation to the right, px of the full-size image.
    pub tx: f64,
    /// Translation downwards, px of the full-size image.
    pub ty: f64,
    /// Rotation θ, rad, positive from x towards y.
    pub rotation: f64,
    /// Scale s.
    pub scale: f64,
}

impl Similarity {
    /// The identity.
    pub const IDENTITY: Self = Self { tx: 0.0, ty: 0.0, rotation: 0.0, scale: 1.0 };

    /// Makes a similarity from a translation in pixels, a rotation in degrees and a scale.
    pub fn new(tx: f64, ty: f64, rotation_deg: f64, scale: f64) -> Self {
        Self { tx, ty, rotation: rotation_deg.to_radians(), scale }
    }

    /// Makes a similarity from `a = s cos θ - 1`, `b = s sin θ` and the translation in pixels:
    /// `T x = x + t + (a X - b Y, b X + a Y)` with `(X, Y) = x - c`.
    ///
    /// The solver uses these parameters: T is linear in them, and `T x - x` keeps its precision in f32.
    pub fn from_displacement([a, b, tx, ty]: [f64; 4]) -> Self {
        Self { tx, ty, rotation: b.atan2(1.0 + a), scale: (1.0 + a).hypot(b) }
    }

    /// Returns `[a, b, tx, ty]`, the inverse of [`from_displacement`](Self::from_displacement).
    pub fn displacement(&self) -> [f64; 4] {
        let (sin, cos) = self.rotation.sin_cos();
        [self.scale * cos - 1.0, self.scale * sin, self.tx, self.ty]
    }

    /// Returns the rotation in degrees.
    pub fn rotation_deg(&self) -> f64 {
        self.rotation.to_degrees()
    }

    /// Returns `T x` for a point and the image centre, px.
    pub fn apply(&self, [x, y]: [f64; 2], [cx, cy]: [f64; 2]) -> [f64; 2] {
        let [a, b, tx, ty] = self.displacement();
        let (dx, dy) = (x - cx, y - cy);
        [x + tx + a * dx - b * dy, y + ty + b * dx + a * dy]
    }

    /// Returns the inverse similarity.
    pub fn inverse(&self) -> Self {
        let scale = 1.0 / self.scale;
        let (sin, cos) = (-self.rotation).sin_cos();
        Self {
            tx: -scale * (cos * self.tx - sin * self.ty),
            ty: -scale * (sin * self.tx + cos * self.ty),
            rotation: -self.rotation,
            scale,
        }
    }

    /// Returns the composition that applies `first`, then this similarity.
    pub fn after(&self, first: &Self) -> Self {
        let (sin, cos) = self.rotation.sin_cos();
        Self {
            tx: self.tx + self.scale * (cos * first.tx - sin * first.ty),
            ty: self.ty + self.scale * (sin * first.tx + cos * first.ty),
            rotation: self.rotation + first.rotation,
            scale: self.scale * first.scale,
        }
    }

    /// Returns the same map of the plane with the centre `to` instead of `from`, px.
    pub fn about(&self, from: [f64; 2], to: [f64; 2]) -> Self {
        let [x, y] = self.apply(to, from);
        Self { tx: x - to[0], ty: y - to[1], ..*self }
    }

    /// Returns the largest distance between the images of a corner under the two maps, px, of a `width` x `height`
    /// image.
    pub fn corner_distance(&self, other: &Self, width: u32, height: u32) -> f64 {
        let c = centre(width, height);
        corners(c).map(|corner| distance(self.apply(corner, c), other.apply(corner, c))).into_iter().fold(0.0, f64::max)
    }
}

impl Default for Similarity {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// Returns the image centre, px. Pixel centres are at integers.
pub fn centre(width: u32, height: u32) -> [f64; 2] {
    [(f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0]
}

/// The least value of 1 + g·p, as in the engine's shaders. A pixel near the horizon or beyond it maps far outside the
/// image.
const HORIZON: f64 = 0.1;
/// The tolerance for equal entries of a matrix: 0.003 px at 3000 px from the centre, a few units of single precision.
const TOLERANCE: f64 = 1e-6;

/// A projective map about the image centre: `T x = c + (M p + t)/(1 + g·p)` with `p = x - c`.
///
/// c is the image centre `((W-1)/2, (H-1)/2)`, x points right and y down, in pixels. `I2(T x)` is registered to
/// `I1(x)`. The map is affine if g = 0, and a [`Similarity`] if also M = s R(θ).
///
/// Serialized as the [similarity at the centre](Self::at_centre), `{"tx_px", "ty_px", "rotation_deg", "scale"}`. If the
/// map is no similarity, `"matrix"`, the rows of `[[M, t], [g, 1]]`, is added and takes precedence.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "serialized::Homography", into = "serialized::Homography")
)]
pub struct Homography {
    /// `[[M, t], [gᵀ, 1]]`.
    matrix: [[f64; 3]; 3],
}

impl Homography {
    /// The identity.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// Makes a map from the rows of `[[M, t], [g, k]]`, which applies to pixels relative to the centre; k is not 0.
    /// `None` if the matrix is singular, mirrors, or has an entry that is not finite.
    pub fn from_matrix(matrix: [[f64; 3]; 3]) -> Option<Self> {
        let map = Self { matrix: matrix.map(|row| row.map(|v| v / matrix[2][2])) };
        let is_finite = map.matrix.iter().flatten().all(|v| v.is_finite());
        (is_finite && determinant(&map.jacobian()) > 0.0).then_some(map)
    }

    /// Returns the rows of `[[M, t], [g, 1]]`, which applies to pixels relative to the centre.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        self.matrix
    }

    /// Returns t, the displacement of the centre, px.
    pub fn translation(&self) -> [f64; 2] {
        [self.matrix[0][2], self.matrix[1][2]]
    }

    /// Returns g, 1/px, the change of scale over the image.
    pub fn perspective(&self) -> [f64; 2] {
        [self.matrix[2][0], self.matrix[2][1]]
    }

    /// Returns the Jacobian of T at the centre, `M - t gᵀ`.
    pub fn jacobian(&self) -> [[f64; 2]; 2] {
        let ([tx, ty], [gx, gy], m) = (self.translation(), self.perspective(), &self.matrix);
        [[m[0][0] - tx * gx, m[0][1] - tx * gy], [m[1][0] - ty * gx, m[1][1] - ty * gy]]
    }

    /// Returns the scale s at the centre, the square root of the Jacobian's determinant.
    pub fn scale(&self) -> f64 {
        determinant(&self.jacobian()).abs().sqrt()
    }

    /// Returns the rotation θ at the centre, rad, from x towards y: that of the nearest rotation.
    pub fn rotation(&self) -> f64 {
        let [[xx, xy], [yx, yy]] = self.jacobian();
        (yx - xy).atan2(xx + yy)
    }

    /// Returns the rotation at the centre in degrees.
    pub fn rotation_deg(&self) -> f64 {
        self.rotation().to_degrees()
    }

    /// Returns the similarity with the translation, rotation and scale of T at the centre.
    pub fn at_centre(&self) -> Similarity {
        let [tx, ty] = self.translation();
        Similarity { tx, ty, rotation: self.rotation(), scale: self.scale() }
    }

    /// Returns whether T is affine.
    pub fn is_affine(&self) -> bool {
        // The same tolerance at 3000 px from the centre.
        self.perspective().iter().all(|g| g.abs() < TOLERANCE / 3000.0)
    }

    /// Returns T as a similarity, if it is one.
    pub fn similarity(&self) -> Option<Similarity> {
        let [[xx, xy, _], [yx, yy, _], _] = self.matrix;
        let is_conformal = (xx - yy).abs() < TOLERANCE && (xy + yx).abs() < TOLERANCE;
        (self.is_affine() && is_conformal).then(|| self.at_centre())
    }

    /// Returns `T x` for a point and the image centre, px.
    pub fn apply(&self, [x, y]: [f64; 2], [cx, cy]: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = self.displacement([x - cx, y - cy]);
        [x + dx, y + dy]
    }

    /// Returns `T x - x` for a point relative to the centre, px.
    #[inline(always)]
    pub fn displacement(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let m = &self.matrix;
        let depth = m[2][0] * x + m[2][1] * y;
        let over = 1.0 / (1.0 + depth).max(HORIZON);
        [
            over * (m[0][2] + (m[0][0] - 1.0) * x + m[0][1] * y - depth * x),
            over * (m[1][2] + m[1][0] * x + (m[1][1] - 1.0) * y - depth * y),
        ]
    }

    /// Returns the inverse map.
    pub fn inverse(&self) -> Self {
        let m = &self.matrix;
        let minor = |i: usize, j: usize| {
            let ([a, b], [c, d]) = ([(i + 1) % 3, (i + 2) % 3], [(j + 1) % 3, (j + 2) % 3]);
            m[a][c] * m[b][d] - m[a][d] * m[b][c]
        };
        Self::normalised(std::array::from_fn(|i| std::array::from_fn(|j| minor(j, i))))
    }

    /// Returns the composition that applies `first`, then this map.
    pub fn after(&self, first: &Self) -> Self {
        Self::normalised(product(&self.matrix, &first.matrix))
    }

    /// Returns the same map of the plane with the centre `to` instead of `from`, px.
    pub fn about(&self, from: [f64; 2], to: [f64; 2]) -> Self {
        let shift = |by: f64| {
            let [x, y] = [0, 1].map(|i| by * (to[i] - from[i]));
            [[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]
        };
        Self::normalised(product(&shift(-1.0), &product(&self.matrix, &shift(1.0))))
    }

    /// Returns the map for images magnified by the factor `by`.
    pub fn scaled(&self, by: f64) -> Self {
        let [[xx, xy, tx], [yx, yy, ty], [gx, gy, one]] = self.matrix;
        Self { matrix: [[xx, xy, by * tx], [yx, yy, by * ty], [gx / by, gy / by, one]] }
    }

    /// Returns the largest distance between the images of a corner under the two maps, px, of a `width` x `height`
    /// image.
    pub fn corner_distance(&self, other: impl Into<Self>, width: u32, height: u32) -> f64 {
        let (c, other) = (centre(width, height), other.into());
        corners(c).map(|corner| distance(self.apply(corner, c), other.apply(corner, c))).into_iter().fold(0.0, f64::max)
    }

    /// Returns the fraction of an image of this size that the map takes into an image of the same size, to about 3 %.
    pub(crate) fn overlap(&self, [width, height]: [u32; 2]) -> f64 {
        const SIDE: u32 = 32;
        let (last, middle) = ([width, height].map(|side| f64::from(side) - 1.0), centre(width, height));
        let at = |n: u32, last: f64| last * (f64::from(n) + 0.5) / f64::from(SIDE);
        let inside = |n: &u32| {
            let place = self.apply([at(n % SIDE, last[0]), at(n / SIDE, last[1])], middle);
            (0..2).all(|axis| (0.0..=last[axis]).contains(&place[axis]))
        };
        (0..SIDE * SIDE).filter(inside).count() as f64 / f64::from(SIDE * SIDE)
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

/// Returns the corners of an image from its centre, px.
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

/// The transforms as serde reads and writes them.
#[cfg(feature = "serde")]
mod serialized {
    use serde::{Deserialize, Serialize};

    #[derive(Serialize, Deserialize)]
    pub(super) struct Similarity {
        tx_px: f64,
        ty_px: f64,
        rotation_deg: f64,
        scale: f64,
    }

    impl From<Similarity> for super::Similarity {
        fn from(t: Similarity) -> Self {
            Self::new(t.tx_px, t.ty_px, t.rotation_deg, t.scale)
        }
    }

    impl From<super::Similarity> for Similarity {
        fn from(t: super::Similarity) -> Self {
            Self { tx_px: t.tx, ty_px: t.ty, rotation_deg: t.rotation_deg(), scale: t.scale }
        }
    }

    #[derive(Serialize, Deserialize)]
    pub(super) struct Homography {
        #[serde(flatten)]
        at_centre: Similarity,
        #[serde(skip_serializing_if = "Option::is_none")]
        matrix: Option<[[f64; 3]; 3]>,
    }

    impl TryFrom<Homography> for super::Homography {
        type Error = String;

        fn try_from(t: Homography) -> Result<Self, Self::Error> {
            let Some(matrix) = t.matrix else {
                let scale = t.at_centre.scale;
                // As a matrix, a negative scale is a rotation by 180 degrees.
                return if scale > 0.0 {
                    Ok(super::Similarity::from(t.at_centre).into())
                } else {
                    Err(format!("scale is {scale}, and must be above 0"))
                };
            };
            let problem = "the matrix is singular or mirrors: it must be [[M, t], [g, 1]] of the map from I1 to I2";
            Self::from_matrix(matrix).ok_or_else(|| problem.to_string())
        }
    }

    impl From<super::Homography> for Homography {
        fn from(t: super::Homography) -> Self {
            let (at_centre, matrix) = (t.at_centre().into(), t.similarity().is_none().then(|| t.matrix()));
            Self { at_centre, matrix }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn similarity() -> Similarity {
        Similarity::new(1.3, -0.9, 12.0, 1.07)
    }

    #[test]
    fn a_quarter_turn_takes_x_to_y() {
        let quarter = Similarity::new(0.0, 0.0, 90.0, 2.0);
        let [x, y] = quarter.apply([11.0, 10.0], [10.0, 10.0]);
        assert!((x - 10.0).abs() < 1e-12 && (y - 12.0).abs() < 1e-12, "({x}, {y})");
    }

    #[test]
    fn a_similarity_from_its_displacement_is_the_same() {
        let back = Similarity::from_displacement(similarity().displacement());
        assert!(back.corner_distance(&similarity(), 4000, 3000) < 1e-9);
    }

    #[test]
    fn inverse_and_composition_of_similarities_agree() {
        let both = similarity().after(&similarity().inverse());
        assert!(both.corner_distance(&Similarity::IDENTITY, 4000, 3000) < 1e-9);
        let twice = similarity().after(&similarity());
        let c = centre(101, 51);
        let p = [3.0, 7.0];
        assert!(distance(similarity().apply(similarity().apply(p, c), c), twice.apply(p, c)) < 1e-9);
    }

    fn homography() -> Homography {
        Homography::from_matrix([[1.05, -0.03, 1.3], [0.02, 0.98, -0.9], [1e-5, -2e-5, 1.0]]).unwrap()
    }

    #[test]
    fn a_homography_of_a_similarity_is_that_similarity() {
        let similarity = similarity();
        let map = Homography::from(similarity);
        let (c, p) = (centre(101, 51), [3.0, 7.0]);
        assert!(distance(map.apply(p, c), similarity.apply(p, c)) < 1e-12);
        let back = map.similarity().unwrap();
        assert!(back.corner_distance(&similarity, 4000, 3000) < 1e-9);
        assert_eq!(homography().similarity(), None);
    }

    #[test]
    fn inverse_composition_and_centre_of_homographies_agree() {
        let both = homography().after(&homography().inverse());
        assert!(both.corner_distance(Homography::IDENTITY, 4000, 3000) < 1e-9);
        let (c, p) = (centre(101, 51), [3.0, 7.0]);
        let (one_by_one, once) =
            (homography().apply(homography().apply(p, c), c), homography().after(&homography()).apply(p, c));
        assert!(distance(one_by_one, once) < 1e-9);
        let moved = homography().about(c, [20.0, 30.0]);
        assert!(distance(moved.apply(p, [20.0, 30.0]), homography().apply(p, c)) < 1e-9);
        let twice = homography().scaled(2.0).displacement([14.0, 6.0]);
        assert!(distance(twice, homography().displacement([7.0, 3.0]).map(|d| 2.0 * d)) < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_derivative_at_the_centre() {
        let (h, t) = (1e-4, homography());
        let d = |p| t.displacement(p);
        let by_x = [0, 1].map(|i| (d([h, 0.0])[i] - d([-h, 0.0])[i]) / (2.0 * h));
        let by_y = [0, 1].map(|i| (d([0.0, h])[i] - d([0.0, -h])[i]) / (2.0 * h));
        let [[xx, xy], [yx, yy]] = t.jacobian();
        for (derivative, expected) in [(by_x[0] + 1.0, xx), (by_x[1], yx), (by_y[0], xy), (by_y[1] + 1.0, yy)] {
            assert!((derivative - expected).abs() < 1e-9, "{derivative} {expected}");
        }
    }

    #[test]
    fn a_mirroring_or_singular_matrix_is_refused() {
        for matrix in [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0]] {
            assert_eq!(Homography::from_matrix([matrix, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), None);
        }
        assert_eq!(Homography::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]]), None);
    }

    #[test]
    fn a_point_beyond_the_horizon_maps_far_outside() {
        let steep = Homography::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]]).unwrap();
        let [dx, _] = steep.displacement([200.0, 0.0]);
        assert!(dx.is_finite() && dx > 1000.0, "{dx}");
    }
}
