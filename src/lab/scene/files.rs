//! Synthetic pairs and sweeps as files: images, true blur, depth and focus, and `truth.json`.

use std::io::Write;

use serde::Serialize;

use super::{Exposure, Kernel, Radiance, Scene, Shape, Simulated, SimulatedSweep, SweepScene};
use crate::base::{Error, Frame, Lens, Photometric, Samples, Similarity};
use crate::files::export::image_files::{
    DEPTH, PHOTOGRAPH, Pixels, RELATIVE_BLUR, TRUE_FOCUS, color_type, write_field, write_png,
};
use crate::files::export::{
    Destination, Header, Kind, RangeReport, SIMULATED_FILES, SizeReport, Staging, write_json_to,
};

/// The file of the true focus of a sweep.
const FOCUS_FILE: &str = "focus.exr";

/// The content of `truth.json`: the ground truth of a pair or of a sweep. `parfocal solve --transform` reads it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth<F> {
    #[serde(flatten)]
    header: Header,
    /// The scene's name.
    pub scene: String,
    /// The seed.
    pub seed: u64,
    /// Seed of the noise, if it is another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_seed: Option<u64>,
    /// Size of all images.
    pub size: SizeReport,
    /// The frames in order: I1 and I2 of a pair.
    pub frames: Vec<FrameTruth>,
    /// The true field.
    #[serde(flatten)]
    pub field: F,
    /// Shape of the blur.
    pub kernel: Kernel,
    /// Standard deviation of the noise, intensities.
    pub noise_sigma: f64,
    /// The brightest minus the darkest radiance, intensities.
    pub contrast: f64,
    /// Blur of all images even in focus, px² of the reference.
    pub base_blur_px2: f64,
    /// The texture of the surface.
    pub radiance: Radiance,
    /// The shape of the surface. A sweep uses only its ends, not V or focus distances.
    pub shape: Shape,
    /// Occlusion at jumps of depth: "ignored", or "rendered" if the nearer side hides the other.
    pub occlusion: &'static str,
    /// Number of clipped samples, outside [0, 1].
    pub clipped_samples: usize,
    /// All files, including this one. A later run replaces or removes only these.
    pub files: Vec<String>,
}

/// The true field of a pair.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairField {
    /// By how much a camera that moved displaces near against far things, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_moves_px: Option<[f64; 2]>,
    /// The range of V, px².
    pub relative_blur: RangeReport,
    /// The lens; absent if V is stated without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<Lens>,
    /// The file of depth in mm, `depth.exr`; null without a lens.
    pub depth: Option<&'static str>,
}

/// The true field of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepField {
    /// Index of the reference frame; the focus is on its pixels.
    pub reference: usize,
    /// c: growth of the blur variance with the squared distance from the focus in settings, px².
    pub blur_rate_px2: f64,
    /// The range of the focus, settings.
    pub focus: RangeReport,
}

/// The truth of one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameTruth {
    /// The file of the frame.
    pub file: String,
    /// Focus setting of the frame in a sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<f64>,
    /// T: the reference's pixel x lies at T x in this frame.
    pub transform: Similarity,
    /// Gain and offset that map the frame onto the reference; they undo the exposure.
    #[serde(flatten)]
    pub photometric: Photometric,
    /// The exposure of the frame, `I ← gain I + offset`.
    pub exposure: Exposure,
    /// Darkening of the corners relative to the reference's. It increases with the squared distance from the middle.
    pub vignetting: f64,
}

impl<F: Serialize> Truth<F> {
    fn of(scene: &Scene, frames: Vec<FrameTruth>, field: F, clipped_samples: usize, files: Vec<String>) -> Self {
        Self {
            header: Header::new(Kind::Simulation),
            scene: scene.name.clone(),
            seed: scene.seed,
            noise_seed: scene.noise_seed,
            size: SizeReport { width: scene.width, height: scene.height },
            frames,
            field,
            kernel: scene.kernel,
            noise_sigma: scene.noise,
            contrast: scene.contrast,
            base_blur_px2: scene.base_blur,
            radiance: scene.radiance.clone(),
            shape: scene.shape.clone(),
            occlusion: scene.shape.occlusion(),
            clipped_samples,
            files,
        }
    }
}

impl Truth<PairField> {
    /// The truth of a pair that was rendered from a scene.
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
        let frames = vec![frame(i1, Similarity::IDENTITY, Exposure::default()), second];
        let field = PairField {
            camera_moves_px: Some(scene.camera_moves).filter(|moves| *moves != [0.0; 2]),
            relative_blur: RangeReport::of(&simulated.relative_blur),
            lens: scene.lens().copied(),
            depth: simulated.depth.as_ref().map(|_| SIMULATED_FILES[3]),
        };
        let clipped = [&simulated.i1, &simulated.i2].map(clipped).iter().sum();
        let files = simulated_files(simulated.depth.is_some()).into_iter().map(String::from).collect();
        Self::of(scene, frames, field, clipped, files)
    }
}

impl Truth<SweepField> {
    /// The truth of a sweep that was rendered from a scene.
    pub fn new(sweep: &SweepScene, simulated: &SimulatedSweep) -> Self {
        let files = simulated_sweep_files(sweep.frames);
        let shots = files.iter().zip(&simulated.shots);
        let frames = shots.map(|(file, shot)| FrameTruth {
            file: file.clone(),
            position: Some(shot.position),
            transform: shot.transform,
            photometric: shot.exposure.photometric(),
            exposure: shot.exposure,
            vignetting: shot.vignetting,
        });
        let (reference, blur_rate_px2) = (simulated.reference, sweep.blur_rate);
        let field = SweepField { reference, blur_rate_px2, focus: RangeReport::of(&simulated.focus) };
        let clipped = simulated.frames.iter().map(clipped).sum();
        Self::of(&sweep.scene, frames.collect(), field, clipped, files)
    }
}

/// Writes the [`SIMULATED_FILES`] of a pair, with images of 16 bits, into a folder: all or none. Creates the folder if
/// it is missing. Replaces or removes the files of an earlier simulation and no others, like
/// [`Results::write`](crate::export::Results::write).
///
/// # Errors
/// [`Error::File`].
pub fn write_simulated<'d>(
    out: impl Into<Destination<'d>>,
    simulated: &Simulated,
    truth: &Truth<PairField>,
) -> Result<(), Error> {
    let size = (simulated.i1.width(), simulated.i1.height());
    let [i1, i2, blur, depth_file, json] = SIMULATED_FILES;
    let mut staging = Staging::replacing(out.into(), json)?;
    staging.add(i1, |w| write_picture(w, &simulated.i1))?;
    staging.add(i2, |w| write_picture(w, &simulated.i2))?;
    staging.add(blur, |w| write_field(w, size, &simulated.relative_blur, &RELATIVE_BLUR))?;
    if let Some(depth) = &simulated.depth {
        staging.add(depth_file, |w| write_field(w, size, depth, &DEPTH))?;
    }
    staging.add(json, |w| write_json_to(w, truth))?;
    staging.place()
}

/// Writes the [files](simulated_sweep_files()) of a sweep, with the same rules as [`write_simulated()`].
///
/// # Errors
/// [`Error::File`].
pub fn write_simulated_sweep<'d>(
    out: impl Into<Destination<'d>>,
    simulated: &SimulatedSweep,
    truth: &Truth<SweepField>,
) -> Result<(), Error> {
    let size = (truth.size.width, truth.size.height);
    let json = SIMULATED_FILES[4];
    let mut staging = Staging::replacing(out.into(), json)?;
    for (frame, of) in simulated.frames.iter().zip(&truth.frames) {
        staging.add(&of.file, |w| write_picture(w, frame))?;
    }
    staging.add(FOCUS_FILE, |w| write_field(w, size, &simulated.focus, &TRUE_FOCUS))?;
    staging.add(json, |w| write_json_to(w, truth))?;
    staging.place()
}

/// The files of a pair, for a scene with or without a lens.
pub fn simulated_files(has_lens: bool) -> Vec<&'static str> {
    SIMULATED_FILES.into_iter().filter(|name| has_lens || *name != SIMULATED_FILES[3]).collect()
}

/// The files of a sweep: `frame_01.png` and so on, `focus.exr`, `truth.json`. Numbers have as many digits as the last
/// number, and at least two.
pub fn simulated_sweep_files(frames: usize) -> Vec<String> {
    let digits = frames.to_string().len().max(2);
    let names = (1..=frames).map(|k| format!("frame_{k:0digits$}.png"));
    names.chain([FOCUS_FILE, SIMULATED_FILES[4]].map(String::from)).collect()
}

/// The samples of a rendered frame, as floats.
pub(super) fn floats(frame: &Frame) -> &[f32] {
    match frame.samples() {
        Samples::F32(samples) => samples,
        Samples::U8(_) | Samples::U16(_) => &[],
    }
}

fn clipped(frame: &Frame) -> usize {
    floats(frame).iter().filter(|v| !(0.0..=1.0).contains(*v)).count()
}

/// Writes a PNG of 16 bits, white at 1.
fn write_picture(writer: impl Write, frame: &Frame) -> Result<(), String> {
    let samples: Vec<u16> = floats(frame).iter().map(|v| (v.clamp(0.0, 1.0) * 65535.0).round() as u16).collect();
    let size = (frame.width(), frame.height());
    write_png(writer, size, color_type(frame.format().channels), &Pixels::Words(&samples), &PHOTOGRAPH)
}
