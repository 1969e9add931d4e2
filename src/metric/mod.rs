//! Metric depth from relative blur, calibration of the lens, measurements, surface texture, repeated measurements, and
//! inspection of parts.

mod calibrate;
mod evidence;
mod field;
mod heights;
pub mod inspect;
pub mod measure;
mod plane;
pub mod repeat;
pub mod response;
pub mod roughness;
mod target;

pub(crate) use evidence::evidence;

pub use calibrate::{CalibratedParameter, Calibration, LensParameter, calibrate};
pub use field::CalibratedField;
pub use target::{SolvedTarget, Target};

use crate::base::Lens;
pub use crate::base::{Aperture, BlurToDepth, Estimate, LensField};

/// The start of warnings about a lens.
pub(crate) const DOUBT: &str = "the lens: ";

/// The largest fraction of valid pixels out of range without a warning. Borders and areas without texture may be out of
/// range.
const MAX_OUT_OF_RANGE: f64 = 0.05;

/// The least implausible pixel pitch, mm. The largest pixels, for astronomy and X-rays, have half of it.
const IMPLAUSIBLE_PITCH: f64 = 0.1;

/// The depth at each pixel of I1.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricDepth {
    /// Width of both fields, px.
    pub width: u32,
    /// Height of both fields, px.
    pub height: u32,
    /// Row-major depths from the lens, mm. NaN where V is NaN or outside the range of the lens model.
    pub depth: Vec<f32>,
    /// Standard deviations of the depths, mm, from those of V. NaN where the depth is NaN, and infinite where infinity
    /// lies within one standard deviation. Errors of the lens parameters are not included.
    pub deviation: Vec<f32>,
    /// The number of pixels with a finite V that has no depth in the range of the model, or is at its limit.
    pub out_of_range: usize,
    /// The lens.
    pub lens: Lens,
}

impl MetricDepth {
    /// Converts V to depth ([`BlurToDepth`]). The field of the lens is not used: [`LensField::to_centre`] removes it
    /// from V and its standard deviation first.
    ///
    /// `blur` is V, px², with NaN where not valid, and `uncertainty` its standard deviation, px². Both are row-major
    /// with `width` values per row. `scale` is s of the registration. Pixels with |V| at the `limit` of the solve, px²,
    /// have no depth.
    pub fn new(lens: &Lens, scale: f64, limit: f64, width: u32, blur: &[f32], uncertainty: &[f32]) -> Self {
        let inverse = lens.inverse(scale);
        // V is clamped to the limit; 0.1 % allow for rounding.
        let is_measured = |v: f64| v.abs() < 0.999 * limit;
        let invert = |(&v, &sigma): (&f32, &f32)| {
            let (v, sigma) = (f64::from(v), f64::from(sigma));
            let pair = inverse.depth(v).zip(inverse.sigma(v, sigma)).filter(|_| is_measured(v));
            pair.map_or((f32::NAN, f32::NAN), |(z, deviation)| (z as f32, deviation as f32))
        };
        let (depth, deviation): (Vec<f32>, Vec<f32>) = blur.iter().zip(uncertainty).map(invert).unzip();
        let out_of_range = blur.iter().zip(&depth).filter(|(v, z)| !v.is_nan() && z.is_nan()).count();
        let height = (depth.len() / width.max(1) as usize) as u32;
        Self { width, height, depth, deviation, out_of_range, lens: *lens }
    }

    /// Returns a warning if the lens is doubtful: its pixel pitch is implausible, or more than 5 % of the valid pixels
    /// are out of its range. The arguments are those of [`new`](Self::new).
    pub fn doubt(&self, scale: f64, limit: f64, blur: &[f32]) -> Option<String> {
        let valid = blur.iter().filter(|v| !v.is_nan()).count();
        let out = self.out_of_range as f64 / valid.max(1) as f64;
        let pitch = self.lens.pixel_pitch;
        let hint = match pitch >= IMPLAUSIBLE_PITCH {
            true => format!("did you mean a pixel pitch of {} mm? µm were given", (1e6 * pitch).round() / 1e9),
            false => "the stated lens did not take these photographs: see to its focus distances, f-number, and the pixel pitch \
                      if they were resized; parfocal calibrate finds them"
                .to_string(),
        };
        if out > MAX_OUT_OF_RANGE {
            return Some(format!("{DOUBT}{:.0} % of the valid pixels are out of its range: {hint}", 100.0 * out));
        }
        let smaller = || Lens { pixel_pitch: pitch / 1e3, ..self.lens }.inverse(scale);
        let fits_smaller = || {
            let inverse = smaller();
            let measured = blur.iter().filter(|v| !v.is_nan() && f64::from(v.abs()) < 0.999 * limit);
            let out = measured.filter(|v| inverse.depth(f64::from(**v)).is_none()).count();
            out as f64 <= MAX_OUT_OF_RANGE * valid as f64
        };
        (pitch >= IMPLAUSIBLE_PITCH && fits_smaller())
            .then(|| format!("{DOUBT}a pixel pitch of {pitch} mm is that of no sensor: {hint}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens {
        focal_length: 50.0,
        f_number: 5.6,
        pixel_pitch: 0.0075,
        focus: [226.5, 233.5],
        kappa: Lens::DISK,
        telecentric: false,
        field: None,
    };

    #[test]
    fn every_valid_pixel_has_a_depth_or_is_counted() {
        let lens = LENS;
        let s = lens.breathing();
        let blur = [227.0, 230.0, 233.0].map(|z| lens.relative_blur(z, s) as f32);
        let field = [blur[0], blur[1], f32::NAN, blur[2], 1e9, -1e9];
        let metric = MetricDepth::new(&lens, s, 1e12, 3, &field, &[0.01; 6]);
        assert_eq!((metric.width, metric.height, metric.out_of_range), (3, 2, 2));
        for (i, z) in [(0, 227.0), (1, 230.0), (3, 233.0)] {
            assert!((metric.depth[i] - z).abs() < 1e-3, "{} mm, not {z}", metric.depth[i]);
            // V decreases by 12 px² over 7 mm.
            assert!((metric.deviation[i] / (0.01 * 7.0 / 12.3) - 1.0).abs() < 0.2, "{} mm", metric.deviation[i]);
        }
        let clamped = MetricDepth::new(&lens, s, f64::from(blur[0].abs()), 3, &field, &[0.01; 6]);
        assert!(clamped.depth[0].is_nan() && clamped.depth[1].is_finite());
        assert!([2, 4, 5].iter().all(|&i| metric.depth[i].is_nan() && metric.deviation[i].is_nan()));
    }

    #[test]
    fn a_pitch_in_micrometres_and_a_wrong_lens_give_warnings() {
        let lens = LENS;
        let s = lens.breathing();
        let mut blur: Vec<f32> = (0..100).map(|i| lens.relative_blur(226.5 + 0.07 * f64::from(i), s) as f32).collect();
        let doubt =
            |lens: &Lens, blur: &[f32]| MetricDepth::new(lens, s, 1e9, 10, blur, &[0.1; 100]).doubt(s, 1e9, blur);
        assert_eq!(doubt(&lens, &blur), None);
        let warning = doubt(&Lens { pixel_pitch: 7.5, ..lens }, &blur).unwrap();
        assert!(warning.contains("did you mean a pixel pitch of 0.0075 mm?"), "{warning}");
        blur[..4].fill(-1e6);
        assert_eq!(doubt(&lens, &blur), None, "a few pixels are not many");
        blur[..9].fill(-1e6);
        let warning = doubt(&lens, &blur).unwrap();
        assert!(
            warning.starts_with(DOUBT) && warning.contains("9 %") && warning.contains("focus distances"),
            "{warning}"
        );
    }
}
