//! The report of a benchmark, as JSON.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::input::{Input, Options, SYNTHETIC};
use crate::base::{DeviceInfo, Error, Settings};
use crate::files::bounded_read;
use crate::files::export::{self, Destination, FileKind, Kind};

/// Greatest size of a report that is read, 64 MiB. A thousand runs with a thousand repeats take less.
const MAX_BYTES: u64 = 64 << 20;

/// A benchmark of one device, in milliseconds, 10⁶ pixels and 10⁹ bytes; `null` if the device has no timestamps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of parfocal that wrote it.
    pub version: String,
    /// The device.
    pub device: DeviceReport,
    /// Number of solves after the first that were not measured.
    pub warmup: u32,
    /// Number of measured solves.
    pub repeats: u32,
    /// Greatest number of outer iterations on each level.
    pub outer_iterations: u32,
    /// Relaxation sweeps per outer iteration.
    pub relaxation_sweeps: u32,
    /// Bytes per second that a pass which only copies an image reads and writes.
    pub copy_gb_per_s: Option<Spread>,
    /// Duration of opening the device, cold.
    pub engine_ms: f64,
    /// The shipped pairs that were not found.
    #[serde(default)]
    pub absent: Vec<String>,
    /// A run for each pair, method and kernel, in the order of the options.
    pub runs: Vec<RunReport>,
    /// The runs that failed.
    #[serde(default)]
    pub refused: Vec<Refused>,
}

/// The device of a benchmark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Name, driver and UUID.
    #[serde(flatten)]
    pub device: export::DeviceReport,
    /// Invocations in a subgroup.
    pub subgroup_size: u32,
}

/// A quantity with several measurements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Median; for an even number of samples, the mean of the middle two.
    pub median: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
    /// All samples in the order of measurement.
    #[serde(default)]
    pub samples: Vec<f64>,
}

/// The pair, method and kernel of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Case {
    /// The scene: "synthetic", the name of a shipped pair, or "pair". A report without it is of synthetic pairs.
    #[serde(default = "synthetic")]
    pub scene: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The method's name.
    pub method: String,
    /// The kernel's name.
    pub kernel: String,
}

fn synthetic() -> String {
    SYNTHETIC.to_string()
}

/// One run of a pair, method and kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunReport {
    /// What was solved.
    #[serde(flatten)]
    pub case: Case,
    /// Duration of a warm solve from frames to borrowed results.
    pub solve_ms: Spread,
    /// Duration from submission to the end of the device's work.
    pub device_ms: Option<Spread>,
    /// Pixels of the image divided by the median of `solve_ms`.
    pub mpx_per_s: f64,
    /// Pixels of the image divided by the median of `device_ms`.
    pub device_mpx_per_s: Option<f64>,
    /// Costs that occur once.
    pub cold: Cold,
    /// Memory of a solver.
    pub memory: Memory,
    /// Dispatches of one solve.
    pub dispatches: Dispatches,
    /// Whether the solve converged; absent in reports before this field existed.
    #[serde(default)]
    pub converged: Option<bool>,
    /// The levels, coarse to fine.
    pub levels: Vec<LevelReport>,
    /// The red-black relaxation.
    pub relaxation: Option<Relaxation>,
    /// The passes of an additional solve, in order of first use; empty without device timestamps.
    pub passes: Vec<PassReport>,
}

/// Costs that occur once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cold {
    /// Duration of [`PairSolver::for_size`](crate::PairSolver::for_size).
    pub prepare_ms: f64,
    /// Duration of the first solve, end to end.
    pub first_ms: f64,
}

/// Memory of a solver, bytes per pixel of the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    /// Images on the device.
    pub device_bytes_per_px: f64,
    /// Buffers visible to the host.
    pub host_bytes_per_px: f64,
}

/// Dispatches of one solve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dispatches {
    /// Dispatches in the recorded command buffer.
    pub recorded: usize,
    /// Dispatches with at least one workgroup: a level that has converged dispatches none.
    pub executed: usize,
}

/// One level of the pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Number of outer iterations.
    pub iterations: usize,
}

/// The red-black relaxation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relaxation {
    /// Pixels of all relaxation sweeps on all levels divided by the time of `relax` and `relax_tiles`. A sweep
    /// updates the red and the black pixels.
    pub mpx_sweeps_per_s: f64,
    /// Compulsory traffic divided by the bytes that the copy moves in the same time.
    pub share_of_copy: Option<f64>,
}

/// One pass: all its dispatches in one solve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassReport {
    /// Name of the pass.
    pub name: String,
    /// Duration of all its dispatches.
    pub ms: f64,
    /// Dispatches with at least one workgroup.
    pub dispatches: usize,
    /// Compulsory traffic: every input element is read once, and every output element is written once.
    pub bytes: u64,
    /// Traffic divided by time.
    pub gb_per_s: f64,
    /// Bandwidth divided by that of the copy; above 1 if a cache holds the data.
    pub share_of_copy: Option<f64>,
}

/// A run that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refused {
    /// What was to be solved.
    #[serde(flatten)]
    pub case: Case,
    /// The reason, a sentence.
    pub error: String,
}

impl Report {
    /// A report without runs.
    pub(super) fn new(device: &DeviceInfo, engine_ms: f64, copy_gb_per_s: Option<Spread>, options: &Options) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_string(),
            device: DeviceReport { device: device.into(), subgroup_size: device.subgroup_size },
            warmup: options.warmup,
            repeats: options.repeats.max(1),
            outer_iterations: options.settings.outer_iterations,
            relaxation_sweeps: options.settings.relaxation_sweeps,
            copy_gb_per_s,
            engine_ms,
            absent: options.absent.clone(),
            runs: Vec::new(),
            refused: Vec::new(),
        }
    }

    /// The report as JSON, without a newline at its end.
    ///
    /// # Errors
    /// None known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        export::to_json(&export::with_header(Kind::Bench, self))
    }

    /// Writes the report as JSON. Creates the folder of the file if it is missing. Replaces an earlier report; the
    /// [`Destination`] must force the replacement of another file. On failure the file stays unchanged.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write<'d>(&self, file: impl Into<Destination<'d>>) -> Result<(), Error> {
        export::write_json(file, FileKind::Bench, self)
    }

    /// Reads a report.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read or is not a report of a benchmark.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let text = bounded_read::text(file, MAX_BYTES)
            .map_err(|e| Error::file(file, format!("cannot be read as a report ({e}); check the path")))?;
        serde_json::from_str(&text).map_err(|e| {
            Error::file(file, format!("is no report of a bench ({e}); give a file that parfocal bench -o wrote"))
        })
    }
}

impl Spread {
    /// The spread of some samples; `None` without samples.
    pub fn of(samples: &[f64]) -> Option<Self> {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        let middle = sorted.len() / 2;
        let median = if sorted.len() % 2 == 1 { sorted[middle] } else { (sorted[middle - 1] + sorted[middle]) / 2.0 };
        Some(Self { median, min, max, samples: samples.to_vec() })
    }
}

impl Case {
    pub(super) fn new(input: &Input, settings: &Settings) -> Self {
        let [width, height] = input.size();
        let (method, kernel) = (settings.method.name().to_string(), settings.kernel.name().to_string());
        Self { scene: input.scene().to_string(), width, height, method, kernel }
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scene, width, height, method, kernel } = self;
        write!(f, "{scene} {width}x{height} {method} {kernel}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_median_least_and_greatest() {
        assert_eq!(Spread::of(&[]), None);
        let odd = Spread::of(&[3.0, 1.0, 2.0]).unwrap();
        assert_eq!((odd.median, odd.min, odd.max), (2.0, 1.0, 3.0));
        assert_eq!(odd.samples, [3.0, 1.0, 2.0]);
        let even = Spread::of(&[4.0, 1.0, 2.0, 10.0]).unwrap();
        assert_eq!((even.median, even.min, even.max), (3.0, 1.0, 10.0));
        let one = Spread::of(&[7.0]).unwrap();
        assert_eq!((one.median, one.min, one.max), (7.0, 7.0, 7.0));
    }

    #[test]
    fn an_error_names_a_file_that_is_not_a_report() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("old.json");
        for (text, expected) in [("", "no report of a bench"), ("{}", "missing field"), ("[1]", "no report of a bench")]
        {
            std::fs::write(&file, text).unwrap();
            let message = Report::read(&file).unwrap_err().to_string();
            assert!(message.contains("old.json") && message.contains(expected), "{message}");
        }
        assert!(Report::read(&folder.path().join("none.json")).unwrap_err().to_string().contains("none.json"));
    }
}
