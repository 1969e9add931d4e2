//! The report of a bench. Scripts read it: fields may be added, not renamed.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Input, Options};
use crate::base::{DeviceInfo, Error, Settings};
use crate::files::export::{self, Destination, FileKind};

/// The most bytes that are read, 64 MiB: a thousand runs of a thousand repeats take less.
const MAX_BYTES: u64 = 64 << 20;

/// What was measured on one device. Milliseconds, 10⁶ pixels, 10⁹ bytes; `null` where the device has no clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of parfocal that wrote it.
    pub version: String,
    /// What it ran on.
    pub device: DeviceReport,
    /// "synthetic", or "pair".
    pub input: String,
    /// Solves after the first that were not counted.
    pub warmup: u32,
    /// Solves that were.
    pub repeats: u32,
    /// Outer iterations on each level at most.
    pub outer_iterations: u32,
    /// Relaxation sweeps per outer iteration.
    pub relaxation_sweeps: u32,
    /// What a pass that only copies an image reads and writes in a second: the bandwidth that the other passes have.
    pub copy_gb_per_s: Option<Spread>,
    /// Opening the device, cold.
    pub engine_ms: f64,
    /// A run for each size, method and kernel.
    pub runs: Vec<RunReport>,
    /// The runs that could not be done.
    #[serde(default)]
    pub refused: Vec<Refused>,
}

/// What it ran on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Name, driver, UUID.
    #[serde(flatten)]
    pub device: export::DeviceReport,
    /// Invocations in a subgroup.
    pub subgroup_size: u32,
}

/// One number, measured several times.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Median; of an even number of samples the mean of the middle two.
    pub median: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
    /// All, in the order in which they were taken.
    #[serde(default)]
    pub samples: Vec<f64>,
}

/// One size, method and kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunReport {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The method's name.
    pub method: String,
    /// The kernel's name.
    pub kernel: String,
    /// End to end: frames handed over to results lent, warm.
    pub solve_ms: Spread,
    /// From submitting to the device's last answer.
    pub device_ms: Option<Spread>,
    /// Pixels of the image over the median of `solve_ms`.
    pub mpx_per_s: f64,
    /// Pixels of the image over the median of `device_ms`.
    pub device_mpx_per_s: Option<f64>,
    /// What comes once.
    pub cold: Cold,
    /// What it takes.
    pub memory: Memory,
    /// Passes of one solve.
    pub dispatches: Dispatches,
    /// Coarse to fine.
    pub levels: Vec<LevelReport>,
    /// The red-black relaxation.
    pub relaxation: Option<Relaxation>,
    /// By named pass, in order of first use, of one more solve, in which the device's clock is read; empty where it has none.
    pub passes: Vec<PassReport>,
}

/// What comes once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cold {
    /// [`PairSolver::for_size`](crate::PairSolver::for_size).
    pub prepare_ms: f64,
    /// The first solve, end to end.
    pub first_ms: f64,
}

/// Bytes over the pixels of the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    /// Images on the device.
    pub device_bytes_per_px: f64,
    /// Buffers that the host sees.
    pub host_bytes_per_px: f64,
}

/// Passes of one solve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dispatches {
    /// In the recording.
    pub recorded: usize,
    /// Of those, over any workgroups: a level that has settled runs over none.
    pub executed: usize,
}

/// What one level did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Outer iterations done.
    pub iterations: usize,
}

/// The red-black relaxation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relaxation {
    /// Pixels of the sweeps done on all levels over the time in `relax` and `relax_level`; a sweep is one over red and one over black.
    pub mpx_sweeps_per_s: f64,
    /// Its compulsory traffic over what the copy moves in the same time.
    pub share_of_copy: Option<f64>,
}

/// One named pass, all its dispatches in one solve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassReport {
    /// The pass.
    pub name: String,
    /// Median.
    pub ms: f64,
    /// Dispatches over any workgroups.
    pub dispatches: usize,
    /// Compulsory traffic of those: every input element read once, every output element written once.
    pub bytes: u64,
    /// The one over the other.
    pub gb_per_s: f64,
    /// That over what the copy does; above 1 where a cache holds what moves.
    pub share_of_copy: Option<f64>,
}

/// A run that could not be done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refused {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The method's name.
    pub method: String,
    /// The kernel's name.
    pub kernel: String,
    /// Why, a sentence.
    pub error: String,
}

impl Report {
    /// A report without runs.
    pub(super) fn new(device: &DeviceInfo, engine_ms: f64, copy_gb_per_s: Option<Spread>, options: &Options) -> Self {
        let input = match options.input {
            Input::Synthetic(_) => "synthetic",
            Input::Pair(_) => "pair",
        };
        Self {
            version: env!("CARGO_PKG_VERSION").to_string(),
            device: DeviceReport { device: device.into(), subgroup_size: device.subgroup_size },
            input: input.to_string(),
            warmup: options.warmup,
            repeats: options.repeats.max(1),
            outer_iterations: options.settings.outer_iterations,
            relaxation_sweeps: options.settings.relaxation_sweeps,
            copy_gb_per_s,
            engine_ms,
            runs: Vec::new(),
            refused: Vec::new(),
        }
    }

    /// As JSON, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }

    /// Writes it as JSON into a file; its folder is made if it is missing. An earlier report of a bench is replaced, another
    /// file only where the [`Destination`] forces it; on failure it stays as it was.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write<'d>(&self, file: impl Into<Destination<'d>>) -> Result<(), Error> {
        export::write_json(file, FileKind::Bench, self)
    }

    /// Reads one that was written earlier.
    ///
    /// # Errors
    /// [`Error::File`]: the file cannot be read, or is no report of a bench.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let mut text = String::new();
        let read = File::open(file).and_then(|f| f.take(MAX_BYTES + 1).read_to_string(&mut text));
        match read {
            Err(e) => Err(Error::file(file, format!("cannot be read as a report ({e}); check the path"))),
            Ok(bytes) if bytes as u64 > MAX_BYTES => Err(Error::file(file, "is too long for a report of a bench")),
            Ok(_) => serde_json::from_str(&text).map_err(|e| {
                Error::file(file, format!("is no report of a bench ({e}); give a file that parfocal bench -o wrote"))
            }),
        }
    }
}

impl Spread {
    /// Of some samples; nothing of none.
    pub fn of(samples: &[f64]) -> Option<Self> {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        let middle = sorted.len() / 2;
        let median = if sorted.len() % 2 == 1 { sorted[middle] } else { (sorted[middle - 1] + sorted[middle]) / 2.0 };
        Some(Self { median, min, max, samples: samples.to_vec() })
    }
}

impl Refused {
    pub(super) fn new([width, height]: [u32; 2], settings: &Settings, error: &Error) -> Self {
        let (method, kernel) = (settings.method.name().to_string(), settings.kernel.name().to_string());
        Self { width, height, method, kernel, error: error.to_string() }
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
    fn what_is_no_report_is_named() {
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
