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

mod report;
mod synthetic;
mod table;
mod timed;
mod trace;

use std::path::Path;
use std::time::Instant;

use crate::base::{Channels, Depth, Error, Format, Frame, Homography, Kernel, Method, Settings, Similarity};
use crate::engine::{Engine, EngineOptions, same_size};
use crate::files::image_io;

pub use report::{
    Case, Cold, DeviceReport, Dispatches, LevelReport, Memory, PassReport, Refused, Relaxation, Report, RunReport,
    Spread,
};
pub use table::compare;
pub use trace::Trace;

/// The options of a benchmark: every pair is measured with every method and kernel.
#[derive(Clone, Debug)]
pub struct Options {
    /// The pairs to solve, in this order.
    pub inputs: Vec<Input>,
    /// The pairs that the report names as absent.
    pub absent: Vec<String>,
    /// Methods of registration.
    pub methods: Vec<Method>,
    /// Kernels of the blur.
    pub kernels: Vec<Kernel>,
    /// All other settings.
    pub settings: Settings,
    /// Number of solves after the first that are not measured.
    pub warmup: u32,
    /// Number of measured solves, at least one.
    pub repeats: u32,
    /// Whether to time every dispatch, for a [trace](Trace), instead of only the passes. Timing itself takes time.
    pub traced: bool,
}

/// A pair to solve.
#[derive(Clone, Debug)]
pub enum Input {
    /// A synthetic pair of this width and height, pixels; grey, 16 bits.
    Synthetic([u32; 2]),
    /// Two photographs.
    Photographs {
        /// The name of the scene in the report.
        scene: String,
        /// I1 and I2.
        pair: Box<[Frame; 2]>,
        /// T for the method `aligned`.
        transform: Homography,
    },
}

impl Default for Options {
    /// Two small synthetic pairs by the unified method, with one warm-up and five measured solves.
    fn default() -> Self {
        Self {
            inputs: vec![Input::Synthetic([512, 512]), Input::Synthetic([1024, 1024])],
            absent: Vec::new(),
            methods: vec![Method::Unified],
            kernels: vec![Kernel::Auto],
            settings: Settings::default(),
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

impl Options {
    /// The settings of each run of a pair.
    fn settings_for(&self, input: &Input) -> impl Iterator<Item = Settings> {
        let of = |method, kernel: &Kernel| {
            let mut settings = Settings { method, kernel: kernel.clone(), ..self.settings.clone() };
            if method == Method::Aligned {
                settings.start = input.transform();
            }
            settings
        };
        self.methods.iter().flat_map(move |&method| self.kernels.iter().map(move |kernel| of(method, kernel)))
    }
}

/// Name and files of the pairs that the project ships in its folder `data`, and the arguments of [`Similarity::new`]
/// for their T.
const SHIPPED: [(&str, [&str; 2], [f64; 4]); 2] = [
    ("heatsink", ["heatsink/frame_15.png", "heatsink/frame_30.png"], [0.6, -0.14, 0.007, 1.0075]),
    ("part", ["part/57/I1.png", "part/57/I2.png"], [1.079, -0.2264, 0.20474, 0.993613]),
];

impl Input {
    /// Reads the photographs that the project ships from its folder `data`. Also returns the names of the absent pairs.
    ///
    /// # Errors
    /// As [`image_io::read_pair`], if the files of a pair exist.
    pub fn shipped(data: &Path) -> Result<(Vec<Self>, Vec<String>), Error> {
        let (mut inputs, mut absent) = (Vec::new(), Vec::new());
        for (scene, files, [tx, ty, rotation_deg, scale]) in SHIPPED {
            let [i1, i2] = files.map(|file| data.join(file));
            if i1.is_file() && i2.is_file() {
                let pair = Box::new(image_io::read_pair(&i1, &i2)?.into());
                let transform = Similarity::new(tx, ty, rotation_deg, scale).into();
                inputs.push(Self::Photographs { scene: scene.to_string(), pair, transform });
            } else {
                absent.push(scene.to_string());
            }
        }
        Ok((inputs, absent))
    }

    fn scene(&self) -> &str {
        match self {
            Self::Synthetic(_) => report::SYNTHETIC,
            Self::Photographs { scene, .. } => scene,
        }
    }

    fn size(&self) -> [u32; 2] {
        match self {
            Self::Synthetic(size) => *size,
            Self::Photographs { pair, .. } => [pair[0].width(), pair[0].height()],
        }
    }

    fn formats(&self) -> [Format; 2] {
        match self {
            Self::Synthetic(_) => [Format { channels: Channels::Gray, depth: Depth::U16 }; 2],
            Self::Photographs { pair, .. } => [pair[0].format(), pair[1].format()],
        }
    }

    fn transform(&self) -> Homography {
        match self {
            Self::Synthetic(_) => synthetic::transform().into(),
            Self::Photographs { transform, .. } => *transform,
        }
    }

    fn pair(&self) -> Result<[Frame; 2], Error> {
        match self {
            Self::Synthetic(size) => synthetic::pair(*size).map_err(Error::Mismatch),
            Self::Photographs { pair, .. } => Ok((**pair).clone()),
        }
    }
}

#[cfg(test)]
mod tests {
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
