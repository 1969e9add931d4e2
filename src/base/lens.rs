//! Lens models: a thin lens and an image-side telecentric lens, which convert depth to blur and back.

use crate::base::{Error, LensField};

/// A lens with the focus distances of the two images.
///
/// The blur of image i has the radius `a_i |x_i - x(z)|`. The radius is linear in x, a function of depth, and x_i is
/// the value of x at the focus distance u_i:
///
/// | | x(z) | a_i | I2 over I1, s |
/// | --- | --- | --- | --- |
/// | thin lens | 1/z | f v_i / 2N | v2 / v1 |
/// | image-side telecentric (Watanabe and Nayar 1997) | v_z = f z / (z - f) | 1 / 2N | 1 |
///
/// with `v_i = f u_i / (u_i - f)`; see section 7 of docs/method.md, "Metric depth". x decreases with depth. Relative
/// blur is a polynomial of degree 2 in x, and linear if s is that of the table. Distances are measured from the lens
/// along its axis.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Lens {
    /// Focal length f, mm.
    #[cfg_attr(feature = "serde", serde(rename = "focal_length_mm"))]
    pub focal_length: f64,
    /// f-number N; the diameter of the aperture is f/N.
    pub f_number: f64,
    /// Distance between the centres of adjacent pixels, mm.
    #[cfg_attr(feature = "serde", serde(rename = "pixel_pitch_mm"))]
    pub pixel_pitch: f64,
    /// Focus distances of I1 and I2, mm.
    #[cfg_attr(feature = "serde", serde(rename = "focus_mm"))]
    pub focus: [f64; 2],
    /// κ, the ratio of the blur's standard deviation per axis to its radius: ½ for a disk.
    #[cfg_attr(feature = "serde", serde(default = "disk"))]
    pub kappa: f64,
    /// Whether the lens is image-side telecentric, so that its magnification does not change with focus.
    #[cfg_attr(feature = "serde", serde(default))]
    pub telecentric: bool,
    /// How V changes over the field. `None` if it is the same everywhere. The methods of the lens take and return V of
    /// the image centre, to which [`LensField::to_centre`] moves V.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub field: Option<LensField>,
}

/// κ of a lens in a file that does not state it.
#[cfg(feature = "serde")]
fn disk() -> f64 {
    Lens::DISK
}

impl Lens {
    /// κ of a disk.
    pub const DISK: f64 = 0.5;

    /// Checks the ranges of all values.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value that is not positive, or equal focus distances, or one within the focal length,
    /// and those of [`LensField::check`].
    pub fn check(&self) -> Result<(), Error> {
        let positive = |name, value: f64| {
            if value > 0.0 && value < 1e9 {
                Ok(())
            } else {
                Err(Error::Setting { name, value, range: "positive, and less than 1e9".to_string() })
            }
        };
        positive("focal length", self.focal_length)?;
        positive("f-number", self.f_number)?;
        positive("pixel pitch", self.pixel_pitch)?;
        positive("kappa", self.kappa)?;
        for (name, value) in [("focus distance of I1", self.focus[0]), ("focus distance of I2", self.focus[1])] {
            positive(name, value)?;
            if value <= self.focal_length {
                let range = format!("more than the focal length, {} mm", self.focal_length);
                return Err(Error::Setting { name, value, range });
            }
        }
        if self.focus[0] == self.focus[1] {
            let range = format!("another than that of I1, {} mm", self.focus[0]);
            return Err(Error::Setting { name: "focus distance of I2", value: self.focus[1], range });
        }
        self.field.as_ref().map_or(Ok(()), LensField::check)
    }

    /// Returns the distance v_i from the lens to the sensor, mm, for image 0 (I1) or 1 (I2): `f u_i / (u_i - f)`.
    pub fn sensor_distance(&self, image: usize) -> f64 {
        let (f, u) = (self.focal_length, self.focus[image]);
        f * u / (u - f)
    }

    /// Returns the focus breathing, the magnification of I2 relative to I1: `s = v2 / v1`, or 1 if telecentric.
    pub fn breathing(&self) -> f64 {
        if self.telecentric { 1.0 } else { self.sensor_distance(1) / self.sensor_distance(0) }
    }

    /// Returns the side of a pixel of I1 projected to the depth `z` mm, mm. The chief ray passes through the centre of
    /// the lens, or through the front focal point if the lens is telecentric.
    pub fn footprint(&self, z: f64) -> f64 {
        let f = self.focal_length;
        self.pixel_pitch * if self.telecentric { (z - f) / f } else { z / self.sensor_distance(0) }
    }

    /// Returns the variance per axis of the blur of a point at depth `z` mm, px² of image `image`: `κ² (r_i / pitch)²`
    /// with `r_i = a_i |x_i - x(z)|`.
    pub fn variance(&self, image: usize, z: f64) -> f64 {
        self.strength(image) * (self.coordinate(self.focus[image]) - self.coordinate(z)).powi(2)
    }

    /// Returns the signed standard deviation of that blur, px of the image. It is negative for a point beyond the
    /// focus.
    pub(crate) fn signed_sigma(&self, image: usize, z: f64) -> f64 {
        self.strength(image).sqrt() * (self.coordinate(z) - self.coordinate(self.focus[image]))
    }

    /// Returns the relative blur `V = V2/s² - V1` of a point at depth `z` mm, px² of I1. `scale` is s of the
    /// registration.
    pub fn relative_blur(&self, z: f64, scale: f64) -> f64 {
        self.variance(1, z) / (scale * scale) - self.variance(0, z)
    }

    /// Returns the depth, mm, at which the relative blur is `v` px². `None` outside of
    /// [`depth_range`](Self::depth_range).
    pub fn depth(&self, v: f64, scale: f64) -> Option<f64> {
        self.inverse(scale).depth(v)
    }

    /// Returns the nearest and the farthest depth, mm, between which the relative blur is monotonic. The farthest may
    /// be infinite. If `scale` differs from [`breathing`](Self::breathing), V has an extremum, where the range ends.
    pub fn depth_range(&self, scale: f64) -> [f64; 2] {
        self.inverse(scale).range
    }

    /// Returns the inverse of [`relative_blur`](Self::relative_blur), for use at many pixels.
    pub fn inverse(&self, scale: f64) -> BlurToDepth {
        let polynomial @ [_, c1, c2] = self.polynomial(scale);
        let (vertex, middle) = (-c1 / (2.0 * c2), self.middle());
        // From infinity to the focal length, within which no image forms.
        let (mut low, mut high) =
            if self.telecentric { (self.focal_length, f64::INFINITY) } else { (0.0, 1.0 / self.focal_length) };
        if vertex > middle {
            high = vertex.min(high);
        } else if vertex > low {
            low = vertex;
        }
        let range = [high, low].map(|x| self.depth_at(x));
        BlurToDepth { lens: *self, polynomial, is_increasing: c1 + 2.0 * c2 * middle > 0.0, range }
    }

    /// Returns the coefficients `[c0, c1, c2]` of V as a polynomial in x.
    pub(crate) fn polynomial(&self, scale: f64) -> [f64; 3] {
        let [x1, x2] = self.focus.map(|u| self.coordinate(u));
        let (k1, k2) = (self.strength(0), self.strength(1) / (scale * scale));
        [k2 * x2 * x2 - k1 * x1 * x1, -2.0 * (k2 * x2 - k1 * x1), k2 - k1]
    }

    /// Returns x(z): 1/mm for a thin lens, mm if telecentric.
    pub(crate) fn coordinate(&self, z: f64) -> f64 {
        if self.telecentric { self.focal_length * z / (z - self.focal_length) } else { 1.0 / z }
    }

    /// Returns the depth at a value of x, mm: the inverse of x(z).
    fn depth_at(&self, x: f64) -> f64 {
        if self.telecentric { self.focal_length / (1.0 - self.focal_length / x) } else { 1.0 / x }
    }

    /// Returns `(κ a_i / pitch)²`, the blur in px² at a distance of 1 in x from the focus.
    fn strength(&self, image: usize) -> f64 {
        let aperture = 1.0 / (2.0 * self.f_number);
        let a = if self.telecentric { aperture } else { aperture * self.focal_length * self.sensor_distance(image) };
        (self.kappa * a / self.pixel_pitch).powi(2)
    }

    /// Returns the mean of x at the two focus distances, which is in the range of every lens whose images can be
    /// registered.
    fn middle(&self) -> f64 {
        (self.coordinate(self.focus[0]) + self.coordinate(self.focus[1])) / 2.0
    }
}

/// The conversion of relative blur to depth, for one lens and one scale s of the registration ([`Lens::inverse`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlurToDepth {
    lens: Lens,
    polynomial: [f64; 3],
    /// Whether V increases with x, towards the lens.
    is_increasing: bool,
    /// Nearest and farthest depth, mm.
    range: [f64; 2],
}

impl BlurToDepth {
    /// Returns the depth, mm, at which the relative blur is `v` px². `None` outside of [`Lens::depth_range`].
    pub fn depth(&self, v: f64) -> Option<f64> {
        let [c0, c1, c2] = self.polynomial;
        let discriminant = c1 * c1 - 4.0 * c2 * (c0 - v);
        if discriminant.is_nan() || discriminant < 0.0 {
            return None;
        }
        // On one side of the vertex the slope c1 + 2 c2 x has one sign, which selects the root. Its form is chosen to
        // avoid cancellation: c2 vanishes if s is that of the lens.
        let slope = if self.is_increasing { discriminant.sqrt() } else { -discriminant.sqrt() };
        let x = if slope * c1 >= 0.0 { 2.0 * (v - c0) / (c1 + slope) } else { (slope - c1) / (2.0 * c2) };
        let (z, [near, far]) = (self.lens.depth_at(x), self.range);
        (z.is_finite() && (near..=far).contains(&z)).then_some(z)
    }

    /// Returns the standard deviation of the depth, mm, where V is `v` px² with the standard deviation `sigma` px².
    ///
    /// It is half the distance between the depths at v - sigma and v + sigma, and `|dz/dV| sigma` for a small sigma.
    /// Beyond an end of the range the depth is that of the end, which may be infinite. `None` if `v` has no depth.
    pub fn sigma(&self, v: f64, sigma: f64) -> Option<f64> {
        self.depth(v)?;
        let [nearer, farther] = if self.is_increasing { [v + sigma, v - sigma] } else { [v - sigma, v + sigma] };
        let [near, far] = self.range;
        let spread = self.depth(farther).unwrap_or(far) - self.depth(nearer).unwrap_or(near);
        Some(if sigma.is_nan() { f64::NAN } else { spread / 2.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens {
            focal_length: 50.0,
            f_number: 2.8,
            pixel_pitch: 0.015,
            focus: [226.5, 233.5],
            telecentric: false,
            ..telecentric()
        }
    }

    /// The lens of the Cup pair.
    fn telecentric() -> Lens {
        let (pixel_pitch, focus) = (0.01304, [529.0, 869.0]);
        Lens {
            focal_length: 25.0,
            f_number: 8.3,
            pixel_pitch,
            focus,
            kappa: Lens::DISK,
            telecentric: true,
            field: None,
        }
    }

    #[test]
    fn a_point_in_focus_is_sharp_and_other_blur_follows_similar_triangles() {
        let lens = lens();
        assert_eq!(lens.variance(0, 226.5), 0.0);
        assert_eq!(lens.variance(1, 233.5), 0.0);
        // By similar triangles: the cone from the aperture to the image at v_z is cut by the sensor at v.
        let (v, z) = (lens.sensor_distance(0), 240.0);
        let v_z = 50.0 * z / (z - 50.0);
        let radius = 50.0 / 2.8 / 2.0 * (v - v_z).abs() / v_z;
        let expected = (0.5 * radius / 0.015).powi(2);
        assert!((lens.variance(0, z) / expected - 1.0).abs() < 1e-12);
    }

    #[test]
    fn with_the_breathing_of_the_lens_relative_blur_is_linear_in_inverse_depth() {
        let (lens, s) = (lens(), lens().breathing());
        assert!((s - lens.sensor_distance(1) / lens.sensor_distance(0)).abs() < 1e-15 && s < 1.0);
        let at = |q: f64| lens.relative_blur(1.0 / q, s);
        let (a, b) = (1.0 / 226.5, 1.0 / 233.5);
        assert!((at((a + b) / 2.0) - (at(a) + at(b)) / 2.0).abs() < 1e-9);
        assert!(at((a + b) / 2.0).abs() < 1e-9, "halfway between the focus distances both are equally blurred");
        let [near, far] = lens.depth_range(s);
        assert!((near - 50.0).abs() < 1e-9 && far > 1e6);
    }

    #[test]
    fn blur_of_a_telecentric_lens_is_proportional_to_the_defocus_of_the_image() {
        let lens = telecentric();
        let (v1, v_z) = (25.0 * 529.0 / (529.0 - 25.0), 25.0 * 700.0 / (700.0 - 25.0));
        let radius = (v1 - v_z) / (2.0 * 8.3) / 0.01304;
        assert!((lens.variance(0, 700.0) / (0.25 * radius * radius) - 1.0).abs() < 1e-12);
        assert_eq!((lens.variance(0, 529.0), lens.variance(1, 869.0), lens.breathing()), (0.0, 0.0, 1.0));
        // The readme of the pair states the radius where the other image is focused: 2.307 px.
        for (z, sign) in [(529.0, 1.0), (869.0, -1.0)] {
            let v = lens.relative_blur(z, 1.0);
            assert!((v - sign * (2.307f64 / 2.0).powi(2)).abs() < 2e-3, "{v} px²");
        }
        // V is linear in v_z, and 0 half way.
        let middle = (v1 + lens.sensor_distance(1)) / 2.0;
        assert!(lens.relative_blur(25.0 * middle / (middle - 25.0), 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_footprint_is_the_pixel_pitch_over_the_magnification() {
        // In focus the image is smaller than the scene by f/(u - f), whatever the lens.
        for telecentric in [false, true] {
            let lens = Lens { telecentric, ..lens() };
            assert!((lens.footprint(226.5) - 0.015 * (226.5 - 50.0) / 50.0).abs() < 1e-12);
        }
        assert!((lens().footprint(453.0) / lens().footprint(226.5) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn depth_inverts_relative_blur_where_it_is_monotonic() {
        for telecentric in [false, true] {
            for focus in [[226.5, 233.5], [233.5, 226.5], [400.0, 2000.0]] {
                let lens = Lens { focus, telecentric, ..lens() };
                for scale in [lens.breathing(), 1.0, 0.99, 1.013] {
                    let [near, far] = lens.depth_range(scale);
                    assert!(focus.iter().any(|u| (near..=far).contains(u)), "{near} {far}");
                    for i in 1..40 {
                        // Evenly spaced in 1/z.
                        let (near, share) = (near.max(51.0), f64::from(i) / 40.0);
                        let z = 1.0 / ((1.0 - share) / near + share / far);
                        let depth = lens.depth(lens.relative_blur(z, scale), scale).unwrap();
                        assert!((depth / z - 1.0).abs() < 1e-7, "{depth} mm, not {z}, scale {scale}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_range_ends_at_the_extremum_of_v() {
        // k (v2 - x)²/s² - k (v1 - x)² is level at x = (v2 - s² v1) / (1 - s²).
        let lens = telecentric();
        let [v1, v2] = [0, 1].map(|i| lens.sensor_distance(i));
        let (s, at) = (1.05f64, |z: f64| lens.relative_blur(z, 1.05));
        let x = (v2 - s * s * v1) / (1.0 - s * s);
        let [near, far] = lens.depth_range(s);
        assert!((near / (25.0 * x / (x - 25.0)) - 1.0).abs() < 1e-9 && near > 100.0 && far.is_infinite(), "{near}");
        assert!(at(near) > at(1.01 * near) && at(near) > at(0.99 * near));
        assert_eq!(lens.depth(at(near) + 1e-6, s), None);
    }

    #[test]
    fn sigma_of_depth_is_the_slope_times_that_of_v_and_infinite_at_infinity() {
        // Of V = a + b x: dz/dV is -z²/b for the thin lens, and -(z - f)²/(f² b) for the telecentric.
        for lens in [lens(), telecentric()] {
            let (s, f) = (lens.breathing(), lens.focal_length);
            let inverse = lens.inverse(s);
            for z in [lens.focus[0], lens.focus[1], 1.02 * lens.focus[1]] {
                let slope = lens.polynomial(s)[1];
                let expected = if lens.telecentric { (z - f).powi(2) / (f * f) } else { z * z } / slope.abs();
                let found = inverse.sigma(lens.relative_blur(z, s), 1e-4).unwrap() / 1e-4;
                assert!((found / expected - 1.0).abs() < 1e-4, "{found} mm/px², not {expected}");
            }
            assert!(inverse.sigma(0.0, f64::NAN).unwrap().is_nan());
            assert_eq!(inverse.sigma(0.0, 1e6), Some(f64::INFINITY), "infinity lies within one deviation");
            assert_eq!(inverse.sigma(-1e9, 0.1), None, "beyond infinity");
        }
    }

    #[test]
    fn a_file_may_omit_only_kappa_telecentric_and_field() {
        let text = r#"{"focal_length_mm": 25, "f_number": 8.3, "pixel_pitch_mm": 0.01304, "focus_mm": [529, 869]}"#;
        assert_eq!(serde_json::from_str::<Lens>(text).unwrap(), Lens { telecentric: false, ..telecentric() });
        let more = text.replace('}', r#", "telecentric": true}"#);
        assert_eq!(serde_json::from_str::<Lens>(&more).unwrap(), telecentric());
        let unknown = serde_json::from_str::<Lens>(&text.replace('}', r#", "fnumber": 8}"#)).unwrap_err().to_string();
        assert!(unknown.contains("fnumber") && unknown.contains("f_number") && unknown.contains("kappa"), "{unknown}");
        assert!(serde_json::from_str::<Lens>(r#"{"f_number": 8}"#).is_err());
        assert_eq!(serde_json::from_str::<Lens>(&serde_json::to_string(&lens()).unwrap()).unwrap(), lens());
    }

    #[test]
    fn outside_the_range_there_is_no_depth() {
        let lens = lens();
        assert_eq!(lens.depth(1e9, lens.breathing()), None);
        assert_eq!(lens.depth(-1e9, lens.breathing()), None);
        assert_eq!(lens.depth(f64::NAN, 1.0), None);
    }

    #[test]
    fn an_invalid_lens_is_refused() {
        for bad in [
            Lens { focal_length: 0.0, ..lens() },
            Lens { f_number: f64::NAN, ..lens() },
            Lens { pixel_pitch: -1.0, ..lens() },
            Lens { focus: [50.0, 200.0], ..lens() },
            Lens { focus: [200.0, 200.0], ..lens() },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
        assert!(lens().check().is_ok());
    }
}
