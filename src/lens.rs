//! The thin lens: from depth to blur, and from relative blur back to depth.

use serde::{Deserialize, Serialize};

use crate::Error;

/// A thin lens in front of a sensor, focused at one distance for each of the two images.
///
/// Section 7 of docs/method.md, "Metric depth". Distances are from the lens, along its axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Focal length f, mm.
    #[serde(rename = "focal_length_mm")]
    pub focal_length: f64,
    /// f-number N; the aperture is f/N wide.
    pub f_number: f64,
    /// Distance between the centres of neighbouring pixels, mm.
    #[serde(rename = "pixel_pitch_mm")]
    pub pixel_pitch: f64,
    /// The distances at which I1 and I2 are focused, mm.
    #[serde(rename = "focus_mm")]
    pub focus: [f64; 2],
    /// Deviation of the blur, per axis, over its radius: ½ for a disk, by its second moment.
    pub kappa: f64,
}

impl Lens {
    /// κ of a disk.
    pub const DISK: f64 = 0.5;

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`]: a length that is not positive and finite, or a focus that this lens cannot have.
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
        Ok(())
    }

    /// Distance v_i from the lens to the sensor, mm, for image 0 (I1) or 1 (I2): `f u_i / (u_i - f)`.
    pub fn sensor_distance(&self, image: usize) -> f64 {
        let (f, u) = (self.focal_length, self.focus[image]);
        f * u / (u - f)
    }

    /// How much larger I2 is than I1 because the sensor distance changed: `s = v2 / v1`.
    pub fn breathing(&self) -> f64 {
        self.sensor_distance(1) / self.sensor_distance(0)
    }

    /// Variance of the blur of a point at depth `z` mm, per axis, in the px² of its own image: `κ² (r_i / pitch)²` with
    /// `r_i = (f / 2N) v_i |1/u_i - 1/z|`.
    pub fn variance(&self, image: usize, z: f64) -> f64 {
        self.strength(image) * (1.0 / self.focus[image] - 1.0 / z).powi(2)
    }

    /// Relative blur `V = V2/s² - V1` of a point at depth `z` mm, px² of I1; `scale` is s of the registration.
    pub fn relative_blur(&self, z: f64, scale: f64) -> f64 {
        self.variance(1, z) / (scale * scale) - self.variance(0, z)
    }

    /// The depth in mm at which the relative blur is `v` px², the inverse of [`relative_blur`](Self::relative_blur) on
    /// its [`depth_range`](Self::depth_range); `None` outside.
    pub fn depth(&self, v: f64, scale: f64) -> Option<f64> {
        let [c0, c1, c2] = self.polynomial(scale);
        let discriminant = c1 * c1 - 4.0 * c2 * (c0 - v);
        if discriminant.is_nan() || discriminant < 0.0 {
            return None;
        }
        // On one side of the vertex the slope c1 + 2 c2 q has one sign, which chooses the root. Of its two forms, the one
        // that subtracts no nearly equal numbers: c2 vanishes where s = v2/v1.
        let slope = discriminant.sqrt().copysign(c1 + 2.0 * c2 * self.middle());
        let q = if slope * c1 >= 0.0 { 2.0 * (v - c0) / (c1 + slope) } else { (slope - c1) / (2.0 * c2) };
        let [near, far] = self.depth_range(scale);
        (q > 0.0 && (near..=far).contains(&(1.0 / q))).then(|| 1.0 / q)
    }

    /// The depths in mm, nearest and farthest, between which the relative blur is monotonic; the farthest may be
    /// infinite. Where `scale` is not v2/v1, V turns back at some depth, and the range ends there.
    pub fn depth_range(&self, scale: f64) -> [f64; 2] {
        let [_, c1, c2] = self.polynomial(scale);
        let vertex = -c1 / (2.0 * c2);
        let (mut low, mut high) = (0.0, 1.0 / self.focal_length);
        if vertex > self.middle() {
            high = vertex.min(high);
        } else if vertex > low {
            low = vertex;
        }
        [1.0 / high, 1.0 / low]
    }

    /// V as a polynomial in `q = 1/z`: `[c0, c1, c2]`.
    fn polynomial(&self, scale: f64) -> [f64; 3] {
        let [a1, a2] = self.focus.map(|u| 1.0 / u);
        let (k1, k2) = (self.strength(0), self.strength(1) / (scale * scale));
        [k2 * a2 * a2 - k1 * a1 * a1, -2.0 * (k2 * a2 - k1 * a1), k2 - k1]
    }

    /// `(κ f v_i / (2 N pitch))²`, px² mm².
    fn strength(&self, image: usize) -> f64 {
        let radius = self.focal_length / (2.0 * self.f_number) * self.sensor_distance(image);
        (self.kappa * radius / self.pixel_pitch).powi(2)
    }

    /// 1/z half way between the focus distances, which lies in the range of every lens that can be registered.
    fn middle(&self) -> f64 {
        (1.0 / self.focus[0] + 1.0 / self.focus[1]) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens { focal_length: 50.0, f_number: 2.8, pixel_pitch: 0.015, focus: [226.5, 233.5], kappa: Lens::DISK }
    }

    #[test]
    fn a_point_in_focus_is_sharp_and_blur_is_the_aperture_seen_from_the_point() {
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
    fn with_the_lens_own_breathing_relative_blur_is_linear_in_inverse_depth() {
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
    fn depth_inverts_relative_blur_where_it_is_monotonic() {
        for focus in [[226.5, 233.5], [233.5, 226.5], [400.0, 2000.0]] {
            let lens = Lens { focus, ..lens() };
            for scale in [lens.breathing(), 1.0, 0.99, 1.013] {
                let [near, far] = lens.depth_range(scale);
                assert!(focus.iter().any(|u| (near..=far).contains(u)), "{near} {far}");
                for i in 1..40 {
                    // Even in 1/z.
                    let share = f64::from(i) / 40.0;
                    let z = 1.0 / ((1.0 - share) / near + share / far);
                    let found = lens.depth(lens.relative_blur(z, scale), scale).unwrap();
                    assert!((found / z - 1.0).abs() < 1e-7, "{found} mm, not {z}, scale {scale}");
                }
            }
        }
    }

    #[test]
    fn outside_the_range_there_is_no_depth() {
        let lens = lens();
        assert_eq!(lens.depth(1e9, lens.breathing()), None);
        assert_eq!(lens.depth(-1e9, lens.breathing()), None);
        assert_eq!(lens.depth(f64::NAN, 1.0), None);
    }

    #[test]
    fn a_lens_that_cannot_be_is_refused() {
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
