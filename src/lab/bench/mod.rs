//! Benchmark: the time of solves by size, method and kernel, and the time and memory traffic of each pass compared with
//! the bandwidth of a copy.
//!
//! ```no_run
//! use parfocal::internals::bench::{self, Options};
//! use parfocal::EngineOptions;
//!
//! let (engine, engine_ms) = bench::open(&EngineOptions::default())?;
//! let measured = bench::run(&engine, engine_ms, &Options::default(), &mut |line| eprintln!("{line}"))?;
//! println!("{}", measured.report.table());
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! A size that the device cannot solve becomes a [`Refused`] of the report, and the other runs continue.

mod report;
mod synthetic;
mod table;
mod timed;
mod trace;

use std::time::Instant;

use crate::base::{Channels, Decode, Depth, Error, Format, Frame, Homography, Kernel, Method, Settings};
use crate::engine::{Engine, EngineOptions, same_size};

pub use report::{
    Cold, DeviceReport, Dispatches, LevelReport, Memory, PassReport, Refused, Relaxation, Report, RunReport, Spread,
};
pub use table::compare;
pub use trace::Trace;

/// The options of a benchmark: every size is measured with every method and kernel.
#[derive(Clone, Debug)]
pub struct Options {
    /// The pairs to solve.
    pub input: Input,
    /// Methods of registration.
    pub methods: Vec<Method>,
    /// Kernels of the blur.
    pub kernels: Vec<Kernel>,
    /// All other settings.
    pub settings: Settings,
    /// T for the method `aligned`. Ignored for synthetic pairs, since their T is known.
    pub held: Homography,
    /// Number of solves after the first that are not measured.
    pub warmup: u32,
    /// Number of measured solves, at least one.
    pub repeats: u32,
    /// Whether to time every dispatch, for a [trace](Trace), instead of only the passes. Timing itself takes time.
    pub traced: bool,
}

/// The pairs to solve.
#[derive(Clone, Debug)]
pub enum Input {
    /// Synthetic pairs of these widths and heights, pixels; grey, 16 bits.
    Synthetic(Vec<[u32; 2]>),
    /// One pair of photographs.
    Pair(Box<[Frame; 2]>),
}

impl Default for Options {
    /// Two small sizes by the unified method, with one warm-up and five measured solves.
    fn default() -> Self {
        Self {
            input: Input::Synthetic(vec![[512, 512], [1024, 1024]]),
            methods: vec![Method::Unified],
            kernels: vec![Kernel::Auto],
            settings: Settings { decode: Decode::None, ..Settings::default() },
            held: Homography::IDENTITY,
            warmup: 1,
            repeats: 5,
            traced: false,
        }
    }
}

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
    if let Input::Pair(pair) = &options.input {
        let [i1, i2] = &**pair;
        same_size([i1, i2])?;
    }
    log("copying, for the bandwidth");
    let copy = timed::copy_bandwidth(engine)?;
    let bandwidth = copy.as_ref().map(|copy| copy.median);
    let mut measured =
        Measured { report: Report::new(engine.info(), engine_ms, copy, options), trace: Trace::default() };
    for size in options.input.sizes() {
        let mut pair = None;
        for settings in options.all_settings() {
            let title = format!("{}x{} {} {}", size[0], size[1], settings.method.name(), settings.kernel.name());
            log(&title);
            match timed::run(engine, options, size, &settings, &mut pair, bandwidth) {
                Ok((run, profile)) => {
                    measured.report.runs.push(run);
                    measured.trace.add(&title, size, &profile);
                }
                Err(error) => {
                    log(&format!("{title}: {error}"));
                    measured.report.refused.push(Refused::new(size, &settings, &error));
                }
            }
        }
    }
    Ok(measured)
}

impl Options {
    /// The settings of each run of a size.
    fn all_settings(&self) -> impl Iterator<Item = Settings> {
        let of = |method, kernel: &Kernel| {
            let mut settings = Settings { method, kernel: kernel.clone(), ..self.settings.clone() };
            if method == Method::Aligned {
                settings.start = match self.input {
                    Input::Synthetic(_) => synthetic::transform().into(),
                    Input::Pair(_) => self.held,
                };
            }
            settings
        };
        self.methods.iter().flat_map(move |&method| self.kernels.iter().map(move |kernel| of(method, kernel)))
    }
}

impl Input {
    fn sizes(&self) -> Vec<[u32; 2]> {
        match self {
            Self::Synthetic(sizes) => sizes.clone(),
            Self::Pair(pair) => vec![[pair[0].width(), pair[0].height()]],
        }
    }

    fn formats(&self) -> [Format; 2] {
        match self {
            Self::Synthetic(_) => [Format { channels: Channels::Gray, depth: Depth::U16 }; 2],
            Self::Pair(pair) => [pair[0].format(), pair[1].format()],
        }
    }

    /// The pair of a size.
    fn pair(&self, size: [u32; 2]) -> Result<[Frame; 2], Error> {
        match self {
            Self::Synthetic(_) => synthetic::pair(size).map_err(Error::Mismatch),
            Self::Pair(pair) => Ok((**pair).clone()),
        }
    }
}
