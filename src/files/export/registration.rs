//! A registration as JSON: fields named as in `report.json`, so that [`read_transform`](super::read_transform) takes it.

use std::io::Write;

use serde::Serialize;

use super::destination::Destination;
use super::json;
use super::kind::FileKind;
use super::report::{DeviceReport, LevelReport, ShadingReport, SizeReport, TimingsReport};
use super::single::write_file;
use crate::base::{DeviceInfo, Error, Homography, Method, Photometric, Settings};
use crate::engine::{OtherMotion, Registered};
use crate::files::image_io::{self, Input, Values};

/// The report of one registration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegistrationReport {
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// T: I2(T x) lines up with I1(x).
    pub transform: Homography,
    /// What maps I2 onto I1.
    pub photometric: Photometric,
    /// How the gain varies over I2.
    pub shading: ShadingReport,
    /// Another motion model that would do, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_motion: Option<OtherMotion>,
    /// The method that ran.
    pub method: Method,
    /// What was asked.
    pub settings: Settings,
    /// How stored values became intensities, and on whose word.
    pub values: Values,
    /// Size of the images.
    pub size: SizeReport,
    /// Coarse to fine.
    pub levels: Vec<LevelReport>,
    /// Whether the registration settled on an answer that the images support.
    pub converged: bool,
    /// What the user should know; a sentence each.
    pub warnings: Vec<String>,
    /// What it ran on.
    pub device: DeviceReport,
    /// Whether it ran under the validation layer.
    pub validated: bool,
    /// The files of I1 and I2; empty where the frames did not come from files.
    pub inputs: Vec<Input>,
    /// Where the time went.
    pub timings_ms: TimingsReport,
}

impl RegistrationReport {
    /// Gathers the report of a registration.
    pub fn new(registered: &Registered, settings: &Settings, device: &DeviceInfo) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            transform: registered.transform,
            photometric: registered.photometric,
            shading: ShadingReport::of(&registered.brightness()),
            other_motion: registered.other_motion,
            method: settings.method,
            settings: settings.clone(),
            values: Values::stated(settings.decode),
            size: SizeReport { width: registered.width, height: registered.height },
            levels: registered.levels.iter().map(LevelReport::from).collect(),
            converged: registered.converged,
            warnings: registered.warnings.clone(),
            device: device.into(),
            validated: false,
            inputs: Vec::new(),
            timings_ms: (&registered.timings).into(),
        }
    }

    /// Adds which files were read, and what they give to warn of; and whether the validation layer watched.
    pub fn of(&mut self, inputs: Vec<Input>, validated: bool) {
        self.warnings.extend(image_io::pair_warnings(&inputs, self.settings.decode));
        (self.inputs, self.validated) = (inputs, validated);
    }

    /// As text, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        json::to_string(self)
    }
}

/// Writes a registration into a file; its folder is made if it is missing. An earlier registration is replaced, another
/// file only where the [`Destination`] forces it; on failure it stays as it was.
///
/// # Errors
/// [`Error::File`].
pub fn write_registration<'d>(file: impl Into<Destination<'d>>, report: &RegistrationReport) -> Result<(), Error> {
    write_json(file, FileKind::Registration, report)
}

/// Writes anything of a kind that is JSON into a file, as [`write_registration`] does.
///
/// # Errors
/// [`Error::File`].
pub fn write_json<'d>(file: impl Into<Destination<'d>>, kind: FileKind, value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(value).map_err(|e| e.to_string());
    write_file(file.into(), kind, |w| text.and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string())))
}
