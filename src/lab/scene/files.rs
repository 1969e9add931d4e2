//! A synthetic pair as files: images, true relative blur and depth, and `truth.json`.

use std::io::Write;

use serde::Serialize;

use super::{Exposure, Kernel, Radiance, Scene, Shape, Simulated};
use crate::base::{Error, Frame, Lens, Photometric, Samples, Similarity};
use crate::files::export::description::{DEPTH, PHOTOGRAPH, RELATIVE_BLUR};
use crate::files::export::png_file::{self, Pixels};
use crate::files::export::{
    Destination, Header, Kind, RangeReport, SIMULATED_FILES, SizeReport, Staging, color_type, exr_file, to_json,
    write_json_to,
};

/// `truth.json`: what is true of a synthetic pair. `parfocal solve --transform` reads it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    #[serde(flatten)]
    header: Header,
    /// The scene's name.
    pub scene: String,
    /// The seed.
    pub seed: u64,
    /// Size of both images.
    pub size: SizeReport,
    /// I1, which is the reference, and I2.
    pub frames: Vec<FrameTruth>,
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

/// The truth of one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameTruth {
    /// Its file.
    pub file: String,
    /// Focus setting of a frame of a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<f64>,
    /// T: the reference's pixel x lies at T x in this frame.
    pub transform: Similarity,
    /// `gain` and `offset`, which map it onto the reference; they undo the exposure.
    #[serde(flatten)]
    pub photometric: Photometric,
    /// What was done to it, `I ← gain I + offset`.
    pub exposure: Exposure,
    /// Darkening of its corners against the reference's, which grows with the squared distance from the middle.
    pub vignetting: f64,
}

impl Truth {
    /// What is true of `simulated`, which `scene` rendered.
    pub fn new(scene: &Scene, simulated: &Simulated) -> Self {
        let [i1, i2, ..] = SIMULATED_FILES;
        let frame = |file: &str, transform, exposure: Exposure| FrameTruth {
            file: file.to_string(),
            position: None,
            transform,
            photometric: exposure.photometric(),
            exposure,
            vignetting: 0.0,
        };
        let second = frame(i2, simulated.transform, scene.exposure);
        Self {
            header: Header::new(Kind::Simulation),
            scene: scene.name.clone(),
            seed: scene.seed,
            size: SizeReport { width: scene.width, height: scene.height },
            frames: vec![frame(i1, Similarity::IDENTITY, Exposure::default()), second],
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
    let mut staging = Staging::replacing(out.into(), json)?;
    staging.add(i1, |w| write_picture(w, &simulated.i1))?;
    staging.add(i2, |w| write_picture(w, &simulated.i2))?;
    staging.add(blur, |w| exr_file::write(w, size, &simulated.relative_blur, &RELATIVE_BLUR))?;
    if let Some(depth) = &simulated.depth {
        staging.add(depth_file, |w| exr_file::write(w, size, depth, &DEPTH))?;
    }
    staging.add(json, |w| write_json_to(w, truth))?;
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
    png_file::write(writer, size, color_type(frame.format().channels), &Pixels::Words(&samples), &PHOTOGRAPH)
}
