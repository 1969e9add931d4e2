//! Benchmark: the time and iterations of solves by pair, method and kernel, and the time and memory traffic of each
//! pass compared with the bandwidth of a copy.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use parfocal::internals::bench::{self, Input, Options};
//! use parfocal::EngineOptions;
//!
//! let (mut inputs, absent) = Input::shipped(Path::new("data"))?;
//! inputs.push(Input::Synthetic([1000, 1000]));
//! let options = Options { inputs, absent, ..Options::default() };
//! let (engine, engine_ms) = bench::open(&EngineOptions::default())?;
//! let measured = bench::run(&engine, engine_ms, &options, &mut |line| eprintln!("{line}"))?;
//! println!("{}", measured.report.table());
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! A pair that the device cannot solve becomes a [`Refused`] of the report, and the other runs continue.

mod input;
mod report;
mod synthetic;
mod table;
mod timed;
mod trace;

use std::time::Instant;

use crate::base::Error;
use crate::engine::{Engine, EngineOptions, same_size};

pub use input::{Input, Options};
pub use report::{
    Case, Cold, DeviceReport, Dispatches, LevelReport, Memory, PassReport, Refused, Relaxation, Report, RunReport,
    Spread,
};
pub use table::compare;
pub use trace::Trace;

/// The results of a benchmark.
#[derive(Debug)]
pub struct Measured {
    /// The figures.
    pub report: Report,
    /// A trace of the last solve of each run, with each dispatch.
    pub trace: Trace,
}

/// Opens a device. Also returns the duration of opening it, ms.
///
/// # Errors
/// As [`Engine::new`].
pub fn open(options: &EngineOptions) -> Result<(Engine, f64), Error> {
    let started = Instant::now();
    let engine = Engine::new(options)?;
    Ok((engine, started.elapsed().as_secs_f64() * 1e3))
}

/// Runs the benchmark. Calls `log` with a line for each run. The report contains a run that fails.
///
/// # Errors
/// [`Error::Setting`] and [`Error::Mismatch`] for settings or a pair that no run could use; [`Error::Timeout`],
/// [`Error::Poisoned`] and [`Error::Vulkan`] if the bandwidth of a copy cannot be measured.
pub fn run(engine: &Engine, engine_ms: f64, options: &Options, log: &mut dyn FnMut(&str)) -> Result<Measured, Error> {
    options.settings.check()?;
    for input in &options.inputs {
        if let Input::Photographs { pair, .. } = input {
            same_size(pair.each_ref())?;
        }
    }
    log("copying, for the bandwidth");
    let copy = timed::copy_bandwidth(engine)?;
    let bandwidth = copy.as_ref().map(|copy| copy.median);
    let mut measured =
        Measured { report: Report::new(engine.info(), engine_ms, copy, options), trace: Trace::default() };
    for input in &options.inputs {
        let mut pair = None;
        for settings in options.settings_for(input) {
            let case = Case::new(input, &settings);
            log(&case.to_string());
            match timed::run(engine, options, input, &settings, &mut pair, bandwidth) {
                Ok((run, profile)) => {
                    measured.trace.add(&case.to_string(), input.size(), &profile);
                    measured.report.runs.push(run);
                }
                Err(error) => {
                    log(&format!("{case}: {error}"));
                    measured.report.refused.push(Refused { case, error: error.to_string() });
                }
            }
        }
    }
    Ok(measured)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_shipped_pairs_are_found_and_absent_ones_are_named() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
        let (inputs, absent) = Input::shipped(&data).unwrap();
        let found: Vec<(&str, [u32; 2])> = inputs.iter().map(|input| (input.scene(), input.size())).collect();
        assert_eq!((found, absent), (vec![("heatsink", [1920, 1080]), ("part", [640, 512])], Vec::new()));
        let (inputs, absent) = Input::shipped(&data.join("part")).unwrap();
        assert!(inputs.is_empty());
        assert_eq!(absent, ["heatsink", "part"]);
    }
}
