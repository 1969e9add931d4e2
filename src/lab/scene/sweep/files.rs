//! A synthetic sweep as files: the frames, the true focus, and `truth.json`.

use serde::Serialize;

use super::{SimulatedSweep, SweepScene};
use crate::base::Error;
use crate::files::export::description::TRUE_FOCUS;
use crate::files::export::{
    Destination, Header, Kind, RangeReport, SIMULATED_FILES, SizeReport, Staging, exr_file, to_json, write_json_to,
};
use crate::lab::scene::files::{FrameTruth, clipped, write_picture};
use crate::lab::scene::{Kernel, Radiance, Shape};

/// The true focus.
const FOCUS_FILE: &str = "focus.exr";

/// `truth.json` of a sweep: what is true of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepTruth {
    #[serde(flatten)]
    header: Header,
    /// The scene's name.
    pub scene: String,
    /// The seed.
    pub seed: u64,
    /// Size of all frames.
    pub size: SizeReport,
    /// The frames in order.
    pub frames: Vec<FrameTruth>,
    /// The frame on whose pixels the focus is, from 0.
    pub reference: usize,
    /// c: px² of variance by which blur grows with the squared distance from the focus, in settings.
    pub blur_rate_px2: f64,
    /// Blur of all frames in focus, px² of the reference.
    pub base_blur_px2: f64,
    /// The range of u, settings.
    pub focus: RangeReport,
    /// Shape of the blur.
    pub kernel: Kernel,
    /// Deviation of the noise, intensities.
    pub noise_sigma: f64,
    /// From the darkest to the brightest radiance, intensities.
    pub contrast: f64,
    /// What is on the surface.
    pub radiance: Radiance,
    /// How the surface lies. What it states of V or of focus distances only says where its ends are.
    pub shape: Shape,
    /// What jumps of depth do: "ignored" where neither side hides the other, "rendered" where the nearer does.
    pub occlusion: &'static str,
    /// Samples of all frames that lay outside [0, 1] and were clipped.
    pub clipped_samples: usize,
    /// The files that belong to it, itself among them. A later run replaces and removes these and no others.
    pub files: Vec<String>,
}

impl SweepTruth {
    /// What is true of `simulated`, which `sweep` rendered.
    pub fn new(sweep: &SweepScene, simulated: &SimulatedSweep) -> Self {
        let scene = &sweep.scene;
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
        Self {
            header: Header::new(Kind::Simulation),
            scene: scene.name.clone(),
            seed: scene.seed,
            size: SizeReport { width: scene.width, height: scene.height },
            frames: frames.collect(),
            reference: simulated.reference,
            blur_rate_px2: sweep.blur_rate,
            base_blur_px2: scene.base_blur,
            focus: RangeReport::of(&simulated.focus),
            kernel: scene.kernel,
            noise_sigma: scene.noise,
            contrast: scene.contrast,
            radiance: scene.radiance.clone(),
            shape: scene.shape.clone(),
            occlusion: scene.shape.occlusion(),
            clipped_samples: simulated.frames.iter().map(clipped).sum(),
            files,
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

/// The files of a synthetic sweep: `frame_01.png` and so on, `focus.exr`, `truth.json`. Numbers have as many digits as the
/// last, two at least.
pub fn simulated_sweep_files(frames: usize) -> Vec<String> {
    let digits = frames.to_string().len().max(2);
    let names = (1..=frames).map(|k| format!("frame_{k:0digits$}.png"));
    names.chain([FOCUS_FILE, SIMULATED_FILES[4]].map(String::from)).collect()
}

/// Writes the [files](simulated_sweep_files()) of a synthetic sweep into the folder `out`, which is made if it is missing;
/// frames have 16 bits. All of them, or none; what is replaced is as by
/// [`write_simulated()`](crate::internals::scene::write_simulated()).
///
/// # Errors
/// [`Error::File`].
pub fn write_simulated_sweep<'d>(
    out: impl Into<Destination<'d>>,
    simulated: &SimulatedSweep,
    truth: &SweepTruth,
) -> Result<(), Error> {
    let size = (truth.size.width, truth.size.height);
    let json = SIMULATED_FILES[4];
    let mut staging = Staging::replacing(out.into(), json)?;
    for (frame, stated) in simulated.frames.iter().zip(&truth.frames) {
        staging.add(&stated.file, |w| write_picture(w, frame))?;
    }
    staging.add(FOCUS_FILE, |w| exr_file::write(w, size, &simulated.focus, &TRUE_FOCUS))?;
    staging.add(json, |w| write_json_to(w, truth))?;
    staging.place()
}
