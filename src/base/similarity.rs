//! The registration: a similarity about the image centre.

/// `T x = c + s R(θ) (x - c) + t`, with c the image centre `((W-1)/2, (H-1)/2)`, x right and y down.
///
/// `I2(T x)` lines up with `I1(x)`.
///
/// Stored, as in `report.json`: `{"tx_px", "ty_px", "rotation_deg", "scale"}`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(from = "super::stored::Similarity", into = "super::stored::Similarity")
)]
pub struct Similarity {
    /// Translation to the right, pixels of the full-size image.
    pub tx: f64,
    /// Translation downwards, pixels of the full-size image.
    pub ty: f64,
    /// Rotation θ in radians, positive from x towards y.
    pub rotation: f64,
    /// Scale s; 1 leaves sizes alone.
    pub scale: f64,
}

impl Similarity {
    /// The similarity that moves nothing.
    pub const IDENTITY: Self = Self { tx: 0.0, ty: 0.0, rotation: 0.0, scale: 1.0 };

    /// From a translation in pixels, a rotation in degrees and a scale.
    pub fn new(tx: f64, ty: f64, rotation_deg: f64, scale: f64) -> Self {
        Self { tx, ty, rotation: rotation_deg.to_radians(), scale }
    }

    /// From the linear part as a displacement, `a = s cos θ - 1` and `b = s sin θ`, and the translation in pixels:
    /// `T x = x + t + (a X - b Y, b X + a Y)` with `(X, Y) = x - c`.
    ///
    /// The solver works in these four because T is linear in them and because `T x - x` keeps its digits in f32
    /// where `T x` does not.
    pub fn from_displacement([a, b, tx, ty]: [f64; 4]) -> Self {
        Self { tx, ty, rotation: b.atan2(1.0 + a), scale: (1.0 + a).hypot(b) }
    }

    /// `[a, b, tx, ty]`, the inverse of [`from_displacement`](Self::from_displacement).
    pub fn displacement(&self) -> [f64; 4] {
        let (sin, cos) = self.rotation.sin_cos();
        [self.scale * cos - 1.0, self.scale * sin, self.tx, self.ty]
    }

    /// Rotation in degrees.
    pub fn rotation_deg(&self) -> f64 {
        self.rotation.to_degrees()
    }

    /// `T x` for a point and a centre, both in pixels.
    pub fn apply(&self, [x, y]: [f64; 2], [cx, cy]: [f64; 2]) -> [f64; 2] {
        let [a, b, tx, ty] = self.displacement();
        let (dx, dy) = (x - cx, y - cy);
        [x + tx + a * dx - b * dy, y + ty + b * dx + a * dy]
    }

    /// The similarity that undoes this one.
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

    /// The similarity that applies `first` and then this one.
    pub fn after(&self, first: &Self) -> Self {
        let (sin, cos) = self.rotation.sin_cos();
        Self {
            tx: self.tx + self.scale * (cos * first.tx - sin * first.ty),
            ty: self.ty + self.scale * (sin * first.tx + cos * first.ty),
            rotation: self.rotation + first.rotation,
            scale: self.scale * first.scale,
        }
    }

    /// The same map of the plane, whose centre is `to` instead of `from`, both in the pixels of either image.
    pub fn about(&self, from: [f64; 2], to: [f64; 2]) -> Self {
        let [x, y] = self.apply(to, from);
        Self { tx: x - to[0], ty: y - to[1], ..*self }
    }

    /// The largest distance in pixels between where the two similarities put a corner of a `width` x `height` image.
    pub fn corner_distance(&self, other: &Self, width: u32, height: u32) -> f64 {
        let [cx, cy] = centre(width, height);
        [[0.0, 0.0], [2.0 * cx, 0.0], [0.0, 2.0 * cy], [2.0 * cx, 2.0 * cy]]
            .into_iter()
            .map(|corner| {
                let (p, q) = (self.apply(corner, [cx, cy]), other.apply(corner, [cx, cy]));
                (p[0] - q[0]).hypot(p[1] - q[1])
            })
            .fold(0.0, f64::max)
    }
}

impl Default for Similarity {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// The image centre c, in pixels, with pixel centres at integers.
pub fn centre(width: u32, height: u32) -> [f64; 2] {
    [(f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Similarity {
        Similarity::new(1.3, -0.9, 12.0, 1.07)
    }

    #[test]
    fn a_quarter_turn_takes_x_to_y() {
        let quarter = Similarity::new(0.0, 0.0, 90.0, 2.0);
        let [x, y] = quarter.apply([11.0, 10.0], [10.0, 10.0]);
        assert!((x - 10.0).abs() < 1e-12 && (y - 12.0).abs() < 1e-12, "({x}, {y})");
    }

    #[test]
    fn displacement_round_trips() {
        let back = Similarity::from_displacement(example().displacement());
        assert!(back.corner_distance(&example(), 4000, 3000) < 1e-9);
    }

    #[test]
    fn inverse_and_composition_agree() {
        let both = example().after(&example().inverse());
        assert!(both.corner_distance(&Similarity::IDENTITY, 4000, 3000) < 1e-9);
        let twice = example().after(&example());
        let c = centre(101, 51);
        let [x, y] = example().apply(example().apply([3.0, 7.0], c), c);
        let [u, v] = twice.apply([3.0, 7.0], c);
        assert!((x - u).hypot(y - v) < 1e-9);
    }
}
