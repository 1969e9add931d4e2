//! A synthetic pair as files: images, true relative blur and depth, and `truth.json`.

use std::io::Write;

use serde::Serialize;

use super::{Exposure, Kernel, Radiance, Scene, Shape, Simulated};
use crate::base::{Error, Frame, Lens, Photometric, Samples, Similarity};
use crate::files::export::meaning::{DEPTH, PHOTOGRAPH, RELATIVE_BLUR};
use crate::files::export::picture::{self, Stored};
use crate::files::export::{
    Destination, RangeReport, SIMULATED_FILES, SizeReport, Staging, color_type, field, to_json,
};

/// `truth.json`: what is true of a synthetic pair. `parfocal solve --transform` reads it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    /// The scene's name.
    pub scene: String,
    /// The seed.
    pub seed: u64,
    /// Size of both images.
    pub size: SizeReport,
    /// T: `I2(T x)` lies over I1(x).
    pub transform: Similarity,
    /// Gain and offset that map I2 onto I1, `J = gain I2(T x) + offset`; they undo the exposure.
    pub photometric: Photometric,
    /// What was done to I2, `I2 ← gain I2 + offset`.
    pub exposure: Exposure,
    /// Shape of the blur of both images.
    pub kernel: Kernel,
    /// Deviation of the noise, intensities.
    pub noise_sigma: f64,
    /// From the darkest to the brightest radiance, intensities.
    pub contrast: f64,
    /// Blur of both images in focus, px² of I1.
    pub base_blur_px2: f64,
    /// What is on the surface.
    pub radiance: Radiance,
    /// How the surface lies.
    pub shape: Shape,
    /// The range of V, px².
    pub relative_blur: RangeReport,
    /// The lens; absent where V is stated without one, and then there is no depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<Lens>,
    /// The file of depth in mm, `depth.exr`; null where the scene has no lens.
    pub depth: Option<&'static str>,
    /// What jumps of depth do: "ignored" where neither side hides the other, "rendered" where the nearer does.
    pub occlusion: &'static str,
    /// Samples of i1.png and i2.png that lay outside [0, 1] and were clipped.
    pub clipped_samples: usize,
    /// The files that belong to it, itself among them. A later run replaces and removes these and no others.
    pub files: Vec<&'static str>,
}

impl Truth {
    /// What is true of `simulated`, which `scene` rendered.
    pub fn new(scene: &Scene, simulated: &Simulated) -> Self {
        Self {
            scene: scene.name.clone(),
            seed: scene.seed,
            size: SizeReport { width: scene.width, height: scene.height },
            transform: simulated.transform,
            photometric: simulated.photometric,
            exposure: scene.exposure,
            kernel: scene.kernel,
            noise_sigma: scene.noise,
            contrast: scene.contrast,
            base_blur_px2: scene.base_blur,
            radiance: scene.radiance.clone(),
            shape: scene.shape.clone(),
            relative_blur: RangeReport::of(&simulated.relative_blur),
            lens: scene.lens().copied(),
            depth: simulated.depth.as_ref().map(|_| SIMULATED_FILES[3]),
            occlusion: scene.shape.occlusion(),
            clipped_samples: [&simulated.i1, &simulated.i2].map(clipped).iter().sum(),
            files: simulated_files(simulated.depth.is_some()),
        }
    }

    /// As text.
    ///
    /// # Errors
    /// That of the serialiser, which numbers that JSON has no form for would cause.
    pub fn to_json(&self) -> serde_json::Result<String> {
        to_json(self)
    }
}

/// Writes the [`SIMULATED_FILES`] of a synthetic pair into the folder `out`, which is made if it is missing; images have 16
/// bits. All of them, or none. Of another scene, what its truth lists is replaced or removed, and no other file, as by
/// [`write()`](crate::export::write()).
///
/// # Errors
/// [`Error::File`].
pub fn write_simulated<'d>(out: impl Into<Destination<'d>>, simulated: &Simulated, truth: &Truth) -> Result<(), Error> {
    let size = (simulated.i1.width(), simulated.i1.height());
    let [i1, i2, blur, depth_file, json] = SIMULATED_FILES;
    let mut staging = Staging::anew(out.into(), json)?;
    staging.add(i1, |w| write_picture(w, &simulated.i1))?;
    staging.add(i2, |w| write_picture(w, &simulated.i2))?;
    staging.add(blur, |w| field::write(w, size, &simulated.relative_blur, &RELATIVE_BLUR))?;
    if let Some(depth) = &simulated.depth {
        staging.add(depth_file, |w| field::write(w, size, depth, &DEPTH))?;
    }
    staging.add(json, |w| {
        truth.to_json().map_err(|e| e.to_string()).and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string()))
    })?;
    staging.place()
}

/// The files of a synthetic pair whose scene has a lens or not.
pub fn simulated_files(has_lens: bool) -> Vec<&'static str> {
    SIMULATED_FILES.into_iter().filter(|name| has_lens || *name != SIMULATED_FILES[3]).collect()
}

pub(super) fn floats(frame: &Frame) -> &[f32] {
    match frame.samples() {
        Samples::F32(samples) => samples,
        // A scene renders floats and nothing else.
        Samples::U8(_) | Samples::U16(_) => &[],
    }
}

pub(super) fn clipped(frame: &Frame) -> usize {
    floats(frame).iter().filter(|v| !(0.0..=1.0).contains(*v)).count()
}

/// 16-bit PNG, white at 1.
pub(super) fn write_picture(writer: impl Write, frame: &Frame) -> Result<(), String> {
    let samples: Vec<u16> = floats(frame).iter().map(|v| (v.clamp(0.0, 1.0) * 65535.0).round() as u16).collect();
    let size = (frame.width(), frame.height());
    picture::write(writer, size, color_type(frame.format().channels), &Stored::Words(&samples), &PHOTOGRAPH)
}
