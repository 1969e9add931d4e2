//! Judges whether the frames of a sweep determine the focus: whether they differ in it, and by steps that are fine
//! enough for their blur.

use crate::base::Error;
use crate::engine::{ColorShift, JointRegistration, MAX_RELATIVE_BLUR};

/// The least blur in the last frame of what is in focus in the first, px: below it the frames do not differ in focus.
///
/// Errors of the registration and the compression of files give frames of one focus setting up to 0.64 px (9 generated
/// sweeps and 25 made of five photographs). Three frames whose variance grows by 0.4 px² each have 0.86 px.
const LEAST_BLUR: f64 = 0.75;
/// The most blur, px, that noise alone may give frames of one focus setting. Noise of 0.05 of full scale gave 1.5 px;
/// real and generated sweeps have 5.7 px and more.
const MOST_BLUR_OF_NOISE: f64 = 3.0;
/// The most that the median standard deviation of u may be, as a share of the range of the frames, if their blur is not
/// that of noise.
///
/// Noise gives u and c together what explains it best, so u is then about as uncertain as the range is long. The share
/// is 0.13 to 9.6 for seven scenes photographed with one focus setting and noise of 0.002 to 0.05, and 0.006 to 0.03
/// for six sweeps of 0.9 to 3 px with noise of 0.003 to 0.03.
const MOST_DEVIATION: f64 = 0.08;
/// The least share of the settings at which two neighbouring frames can be compared, without a warning.
///
/// Where a step widens the blur by 4.4 px (seven frames of the heat sink) the share is 0.5, and 87 % of the pixels have
/// a u. With 6.4 px (four frames of the metal part) it is 0.24, and 53 % have one; with 8 px 0.16, and 10 to 15 %.
const LEAST_COMPARED: f64 = 1.0 / 3.0;

/// An error if the frames do not differ in focus, or if their `contrast` shows that they do, but the solve does not.
/// `median_deviation`: of u, in settings; `None` if no pixel has one.
pub(super) fn differ_in_focus(
    registration: &JointRegistration,
    median_deviation: Option<f64>,
    contrast: bool,
    unlike: Option<String>,
) -> Result<(), Error> {
    let (blur, range) = (blur(registration), registration.settings[registration.settings.len() - 1]);
    let is_noise = median_deviation.is_none_or(|deviation| deviation > MOST_DEVIATION * range);
    if blur >= MOST_BLUR_OF_NOISE || blur >= LEAST_BLUR && !is_noise {
        return Ok(());
    }
    if contrast {
        return Err(Error::Mismatch(format!(
            "the frames differ in focus, but their registration failed{}: take out frames of another view, or those that \
             moved far",
            unlike.map_or(String::new(), |unlike| format!("; {unlike}"))
        )));
    }
    Err(Error::Mismatch(
        "the frames seem to be of one focus setting: they do not differ in focus beyond noise; focus each frame a step \
         further than the one before"
            .to_string(),
    ))
}

/// A warning if the steps are too coarse for their blur. `max_relative_blur` is the limit of the settings.
pub(super) fn coarse_warning(registration: &JointRegistration, max_relative_blur: f64) -> Option<String> {
    let limit = max_relative_blur.min(MAX_RELATIVE_BLUR);
    let (blur, settings) = (blur(registration), &registration.settings);
    // V of two frames exceeds the limit beyond this distance from the middle between them, for a step of 1.
    let reach = limit / registration.rate;
    let compared: f64 = settings.windows(2).map(|p| p[1] - p[0]).map(|step| step.min(reach / step)).sum();
    let steps = settings.len() - 1;
    (compared < LEAST_COMPARED * settings[steps]).then(|| {
        format!(
            "the steps are too coarse for their blur, which changes by {:.0} px from frame to frame: {} frames would do \
             instead of {}, or a smaller aperture",
            blur / steps as f64,
            (blur / limit.sqrt()).ceil() + 1.0,
            settings.len()
        )
    })
}

/// A warning if u depends on the color of the texture. A step of the settings is `step` of their `unit`.
pub(super) fn color_warning(shift: &ColorShift, step: f64, unit: &str) -> Option<String> {
    (shift.included > 0.0).then(|| {
        format!(
            "the lens focuses colours apart: red is in focus {:+.3} {unit} and blue {:+.3} {unit} from green, so that the focus depends on the colour of the texture, by {:.3} {unit} (in σ): stack the green channel alone, or photograph in light of one colour",
            step * shift.red,
            step * shift.blue,
            step.abs() * shift.included
        )
    })
}

/// The blur in the last frame of what is in focus in the first, px.
fn blur(registration: &JointRegistration) -> f64 {
    registration.rate.sqrt() * registration.settings[registration.settings.len() - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings that begin at 0, and the blur of a step of 1, px.
    fn registration(settings: &[f64], blur: f64) -> JointRegistration {
        let (transforms, parallax, parallax_deviation, brightness) = Default::default();
        let (rate, settings, unlike) = (blur * blur, settings.to_vec(), Vec::new());
        JointRegistration { transforms, parallax, parallax_deviation, brightness, rate, settings, unlike }
    }

    #[test]
    fn coarse_steps_are_named_with_the_frames_that_would_do() {
        let warning = |settings: &[f64], blur: f64| coarse_warning(&registration(settings, blur), 144.0);
        // A limit of 10 px²: in between two frames 3.2 px apart in blur every setting is compared.
        let coarse = warning(&[0.0, 1.0, 2.0, 3.0], 8.0).unwrap();
        assert!(coarse.contains("8 px from frame to frame: 9 frames would do instead of 4"), "{coarse}");
        assert_eq!(warning(&[0.0, 1.0, 2.0, 3.0], 5.0), None);
        // One wide gap does not make a sweep coarse.
        assert_eq!(warning(&[0.0, 1.0, 2.0, 5.0], 3.0), None);
        assert!(coarse_warning(&registration(&[0.0, 1.0, 2.0], 3.0), 2.0).is_some());
    }

    #[test]
    fn frames_of_one_focus_setting_are_refused() {
        let judged = |blur: f64, deviation: Option<f64>| {
            differ_in_focus(&registration(&[0.0, 1.0, 2.0], blur / 2.0), deviation, false, None)
        };
        for (blur, deviation) in [(0.6, Some(0.02)), (1.5, Some(0.3)), (1.5, None)] {
            let error = judged(blur, deviation).unwrap_err().to_string();
            assert!(error.contains("do not differ in focus beyond noise"), "{error}");
        }
        assert!(judged(0.86, Some(0.02)).is_ok() && judged(5.0, Some(0.3)).is_ok());
    }
}
