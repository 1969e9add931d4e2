//! How fast it is: sizes, methods and kernels solved again and again, with the time and the traffic of each pass beside
//! what the memory does at most.
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
//! A size that the device cannot take is a [`Refused`] of the report; the other runs go on.

mod compare;
mod copy;
mod report;
mod synthetic;
mod table;
mod timed;
mod trace;

use std::time::Instant;

use crate::base::{Channels, Decode, Depth, Error, Format, Frame, Homography, Kernel, Method, Settings};
use crate::engine::{Engine, EngineOptions, same_size};

pub use compare::compare;
pub use report::{
    Cold, DeviceReport, Dispatches, LevelReport, Memory, PassReport, Refused, Relaxation, Report, RunReport, Spread,
};
pub use trace::Trace;

/// What is measured: every size with every method and kernel.
#[derive(Clone, Debug)]
pub struct Options {
    /// The pairs.
    pub input: Input,
    /// Methods.
    pub methods: Vec<Method>,
    /// Kernels.
    pub kernels: Vec<Kernel>,
    /// Everything else that the solver is told.
    pub settings: Settings,
    /// T, which the method aligned holds; of a synthetic pair it is known.
    pub held: Homography,
    /// Solves after the first that are not counted.
    pub warmup: u32,
    /// Solves that are; at least one is done.
    pub repeats: u32,
    /// The time of every dispatch is taken, for a [trace](Trace), instead of those of the passes alone; that takes time itself.
    pub traced: bool,
}

/// What is solved.
#[derive(Clone, Debug)]
pub enum Input {
    /// Synthetic pairs of these widths and heights, pixels, made on the spot; grey, 16 bits.
    Synthetic(Vec<[u32; 2]>),
    /// One pair of photographs.
    Pair(Box<[Frame; 2]>),
}

impl Default for Options {
    /// Two small sizes by the unified method with a Gaussian, five times after one that is not counted.
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

/// What came out.
#[derive(Debug)]
pub struct Measured {
    /// The numbers.
    pub report: Report,
    /// The last solve of each run, dispatch by dispatch.
    pub trace: Trace,
}

/// Opens a device, and says in how many milliseconds, cold.
///
/// # Errors
/// As [`Engine::new`].
pub fn open(options: &EngineOptions) -> Result<(Engine, f64), Error> {
    let started = Instant::now();
    let engine = Engine::new(options)?;
    Ok((engine, started.elapsed().as_secs_f64() * 1e3))
}

/// Measures; `say` is told what is being done, a line at a time.
///
/// # Errors
/// Settings that no size could be solved with, a pair of two sizes, and whatever keeps the device from copying an
/// image: [`Error::Setting`], [`Error::Mismatch`], [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`]. What
/// keeps a single run from being done is in the report.
pub fn run(engine: &Engine, engine_ms: f64, options: &Options, say: &mut dyn FnMut(&str)) -> Result<Measured, Error> {
    options.settings.check()?;
    if let Input::Pair(pair) = &options.input {
        let [i1, i2] = &**pair;
        same_size([i1, i2])?;
    }
    say("copying, for the bandwidth");
    let copy = copy::bandwidth(engine)?;
    let mut measured =
        Measured { report: Report::new(engine.info(), engine_ms, copy, options), trace: Trace::default() };
    for size in options.input.sizes() {
        let mut pair = None;
        for settings in options.all_settings() {
            let title = format!("{}x{} {} {}", size[0], size[1], settings.method.name(), settings.kernel.name());
            say(&title);
            match timed::run(engine, options, size, &settings, &mut pair) {
                Ok((timed, profile)) => {
                    let copy = measured.report.copy_gb_per_s.as_ref().map(|copy| copy.median);
                    measured.report.runs.push(timed.report(copy));
                    measured.trace.add(&title, size, &profile);
                }
                Err(error) => {
                    say(&format!("{title}: {error}"));
                    measured.report.refused.push(Refused::new(size, &settings, &error));
                }
            }
        }
    }
    Ok(measured)
}

impl Options {
    /// What the solver is told in each run of a size.
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
