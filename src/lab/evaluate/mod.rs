//! The paper's experiments (Ben-Ari, TPAMI 2014, section 5) with parfocal's four systems: tables, figures, and which of
//! the aims are met; and what is demanded of the default settings, of pairs and of focus sweeps, measured.
//!
//! ```no_run
//! use parfocal::evaluate::{Evaluation, Options};
//! use parfocal::{Engine, EngineOptions};
//!
//! let engine = Engine::new(&EngineOptions::default())?;
//! let evaluation = Evaluation::run(&engine, &Options::default(), &mut |line| eprintln!("{line}"));
//! evaluation.write("out/evaluate")?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! A solve that fails is a line of the tables that says why; it ends nothing. Only writing can fail.

mod bench;
mod calibration;
mod cases;
mod descent;
mod displace;
mod errors;
mod figures;
mod itself;
mod kernels;
mod real;
mod registration;
mod report;
mod robustness;
mod section;
mod sigma;
mod sweeps;
mod system;
mod table;
mod targets;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use image::RgbImage;
use serde::Serialize;

use self::bench::Bench;
use self::section::Section;
use crate::base::Error;
use crate::engine::Engine;
use crate::files::export::{
    Destination, DeviceReport, Guard, Header, Kind, ReportFiles, Staging, write_drawing, write_json_to,
};

/// What is evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Folder that holds the real pairs, each in a folder of its own; those that are absent are named in the report.
    pub data: PathBuf,
    /// Small scenes, few points, reduced photographs: whether everything runs, not how good it is.
    pub quick: bool,
    /// One part alone.
    pub only: Option<Only>,
}

/// The parts of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Only {
    /// The paper's experiments, all systems.
    Paper,
    /// What is demanded of the default settings.
    Itself,
    /// What is demanded of focus sweeps.
    Sweeps,
}

impl Default for Options {
    /// Everything in full, on the pairs in the folder `data`.
    fn default() -> Self {
        Self { data: PathBuf::from("data"), quick: false, only: None }
    }
}

/// The results of all experiments.
pub struct Evaluation {
    results: Results,
    figures: Vec<Figure>,
}

/// What `report.json` holds: fields may be added, not renamed.
#[derive(Serialize)]
struct Results {
    #[serde(flatten)]
    header: Header,
    version: &'static str,
    files: [&'static str; 2],
    device: DeviceReport,
    quick: bool,
    targets: Vec<targets::Target>,
    registration: Vec<registration::CaseResult>,
    real: Vec<real::PairResult>,
    absent: Vec<cases::Absent>,
    robustness: Vec<robustness::Sweep>,
    descent: Vec<descent::Race>,
    kernels: Vec<kernels::KernelResult>,
    calibration: Vec<calibration::Calibration>,
    itself: Vec<Section>,
    sweeps: Vec<Section>,
}

impl Results {
    /// Nothing yet.
    fn of(engine: &Engine, options: &Options) -> Self {
        Self {
            header: Header::new(Kind::Evaluation),
            version: env!("CARGO_PKG_VERSION"),
            files: [REPORT, TABLES],
            device: engine.info().into(),
            quick: options.quick,
            targets: Vec::new(),
            registration: Vec::new(),
            real: Vec::new(),
            absent: Vec::new(),
            robustness: Vec::new(),
            descent: Vec::new(),
            kernels: Vec::new(),
            calibration: Vec::new(),
            itself: Vec::new(),
            sweeps: Vec::new(),
        }
    }
}

/// A picture and the name of its file.
struct Figure {
    name: String,
    /// What it shows, a sentence.
    caption: String,
    picture: RgbImage,
}

/// Where the figures go within the folder of the report.
const FIGURES: &str = "figures";
const REPORT: &str = "report.json";
const TABLES: &str = "report.md";

impl Evaluation {
    /// Runs what is asked for; `say` is told what is being done, a line at a time.
    pub fn run(engine: &Engine, options: &Options, say: &mut dyn FnMut(&str)) -> Self {
        let mut bench = Bench::new(engine, options.quick, say);
        let mut evaluation = Self { results: Results::of(engine, options), figures: Vec::new() };
        let wanted = |part: Only| options.only.is_none_or(|only| only == part);
        if wanted(Only::Paper) {
            evaluation.run_paper(&mut bench, &options.data);
        }
        if wanted(Only::Itself) {
            evaluation.results.itself = itself::run(&mut bench, &options.data);
        }
        if wanted(Only::Sweeps) {
            evaluation.results.sweeps = sweeps::run(&mut bench, &options.data);
        }
        evaluation
    }

    fn run_paper(&mut self, bench: &mut Bench, data: &Path) {
        let results = &mut self.results;
        let (pairs, absent) = cases::real_pairs(data);
        let mut figures = figures::Collector::default();
        results.registration = registration::run(bench, cases::all(data, &pairs, bench.quick), &mut figures);
        results.real = real::run(bench, data, &pairs, &mut figures);
        results.absent = absent;
        results.robustness = robustness::run(bench);
        results.descent = descent::run(bench);
        results.kernels = kernels::run(bench);
        results.calibration = calibration::run(bench);
        results.targets = targets::all(&results.registration);
        self.figures = figures.finish(&results.robustness, &results.descent);
    }

    /// What is demanded of the default settings, as a table of each section; empty where it was not measured.
    pub fn itself(&self) -> String {
        section::markdown(itself::HEADING, &self.results.itself)
    }

    /// What is demanded of focus sweeps, likewise.
    pub fn sweeps(&self) -> String {
        section::markdown(sweeps::HEADING, &self.results.sweeps)
    }

    /// The text of `report.json`, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        crate::files::export::to_json(&self.results)
    }

    /// The text of `report.md`.
    pub fn to_markdown(&self) -> String {
        report::markdown(&self.results, &self.figures)
    }

    /// Writes `report.md`, `report.json` and `figures/*.png` into a folder, which is made if it is missing. All are
    /// written under temporary names before the first gets its own; the report comes last. An earlier evaluation is
    /// replaced, another file only where the [`Destination`] forces it.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write<'d>(&self, out: impl Into<Destination<'d>>) -> Result<(), Error> {
        let out = out.into();
        let mut reports = Staging::joining(out, REPORT, Vec::new())?;
        let mut figures = Staging::over(out.to(&out.path().join(FIGURES)), figures_in(out.path()))?;
        for figure in &self.figures {
            figures.add(format!("{}.png", figure.name), |writer| write_drawing(writer, &figure.picture))?;
        }
        reports.add(REPORT, |w| write_json_to(w, &self.results))?;
        reports.add(TABLES, |w| w.write_all(self.to_markdown().as_bytes()).map_err(|e| e.to_string()))?;
        figures.place()?;
        reports.place()
    }
    /// Refuses, before it is run, a folder that [`write`](Self::write) would refuse: files that no evaluation wrote have the
    /// names of its results.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check<'d>(out: impl Into<Destination<'d>>) -> Result<(), Error> {
        let out = out.into();
        out.check_results(REPORT, &[REPORT, TABLES])?;
        let folder = out.path().join(FIGURES);
        let guard = Guard::by_list(out.to(&folder), figures_in(out.path()));
        figures::names().try_for_each(|name| guard.check(&folder.join(format!("{name}.png"))))
    }
}

/// The figures of the evaluation in a folder: those that its tables show.
fn figures_in(out: &Path) -> ReportFiles {
    let is_ours = ReportFiles::of(out, REPORT).contains(TABLES);
    let text = is_ours.then(|| fs::read_to_string(out.join(TABLES)).ok()).flatten().unwrap_or_default();
    let link = format!("]({FIGURES}/");
    ReportFiles::named(text.split(&link).skip(1).filter_map(|rest| rest.split(')').next()))
}
