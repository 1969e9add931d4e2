//! Experiments with bounds: the paper's (Ben-Ari, TPAMI 2014, section 5), the default settings, focus sweeps, and
//! inputs that do not fit the model.
//!
//! ```no_run
//! use parfocal::internals::evaluate::{Evaluation, Options};
//! use parfocal::{Engine, EngineOptions};
//!
//! let engine = Engine::new(&EngineOptions::default())?;
//! let evaluation = Evaluation::run(&engine, &Options::default(), &mut |line| eprintln!("{line}"));
//! evaluation.write("out/evaluate")?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! A solve that fails becomes a row with its reason, and the other solves continue. Only writing can fail.

mod contact_sheet;
mod defaults;
mod errors;
mod figures;
mod judgement;
mod pairs;
mod registration;
mod robustness;
mod section;
mod sweeps;

use std::io::Write;
use std::path::{Path, PathBuf};

use image::RgbImage;
use serde::Serialize;

use self::section::{Runner, Section};
use crate::base::Error;
use crate::engine::Engine;
use crate::files::export::{Destination, DeviceReport, Staging, write_drawing, write_json_to};

/// The options of an evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Folder of the photographs, with one folder for each pair. The report names missing photographs.
    pub data: PathBuf,
    /// Whether to use small scenes, few cases and reduced photographs. A quick run tests that everything works, not its
    /// accuracy.
    pub quick: bool,
    /// The only part to run; `None` for all.
    pub only: Option<Part>,
}

/// The parts of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Part {
    /// The paper's experiments by all methods: some 15 minutes on two processor cores without a GPU
    Paper,
    /// Bounds on the default settings: some 5 minutes. Reads part/57 and dual-pixel in DIR
    Defaults,
    /// Bounds on focus sweeps, with shape from focus for comparison: some 5 minutes. Reads cou in DIR
    Sweeps,
    /// Inputs that do not fit the model, and whether the program notices: some 8 minutes
    Judgement,
}

impl Default for Options {
    /// The default options: the full evaluation with the pairs in the folder `data`.
    fn default() -> Self {
        Self { data: PathBuf::from("data"), quick: false, only: None }
    }
}

/// The results of all experiments.
pub struct Evaluation {
    report: Report,
    figures: Vec<Figure>,
}

/// The content of `report.json`: the sections of each part; empty for a part that was not run.
#[derive(Serialize)]
struct Report {
    program: &'static str,
    kind: &'static str,
    version: &'static str,
    device: DeviceReport,
    quick: bool,
    paper: Vec<Section>,
    defaults: Vec<Section>,
    sweeps: Vec<Section>,
    judgement: Vec<Section>,
    files: Vec<String>,
}

/// A picture and the name of its file.
struct Figure {
    name: String,
    /// A sentence that describes the picture.
    caption: String,
    picture: RgbImage,
}

impl Figure {
    fn file(name: &str) -> String {
        format!("{name}.png")
    }
}

const REPORT: &str = "report.json";
const TABLES: &str = "report.md";

impl Evaluation {
    /// Runs the experiments. Calls `log` with a line for each.
    pub fn run(engine: &Engine, options: &Options, log: &mut dyn FnMut(&str)) -> Self {
        let mut runner = Runner::new(engine, options.quick, log);
        let (data, includes) = (&options.data, |part| options.only.is_none_or(|only| only == part));
        let (paper, mut figures) =
            if includes(Part::Paper) { run_paper(&mut runner, data) } else { Default::default() };
        let defaults = if includes(Part::Defaults) { defaults::run(&mut runner, data) } else { Vec::new() };
        let sweeps = if includes(Part::Sweeps) { sweeps::run(&mut runner, data) } else { Vec::new() };
        let (judgement, warned) =
            if includes(Part::Judgement) { judgement::run(&mut runner) } else { Default::default() };
        figures.extend(warned);
        let files = figures.iter().map(|figure: &Figure| Figure::file(&figure.name));
        let report = Report {
            program: env!("CARGO_PKG_NAME"),
            kind: "evaluation",
            version: env!("CARGO_PKG_VERSION"),
            device: engine.info().into(),
            quick: options.quick,
            paper,
            defaults,
            sweeps,
            judgement,
            files: files.chain([TABLES, REPORT].map(String::from)).collect(),
        };
        Self { report, figures }
    }

    /// The tables of all parts but the paper's, as Markdown; empty if they were not measured.
    pub fn summary(&self) -> String {
        let Report { defaults, sweeps, judgement, .. } = &self.report;
        let parts = [(defaults::HEADING, defaults), (sweeps::HEADING, sweeps), (judgement::HEADING, judgement)];
        let parts = parts.map(|(heading, sections)| section::markdown(heading, sections));
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
    }

    /// The content of `report.json`.
    pub fn report(&self) -> &impl Serialize {
        &self.report
    }

    /// The text of `report.md`.
    pub fn to_markdown(&self) -> String {
        let Report { version, device, quick, .. } = &self.report;
        let quick = if *quick {
            "\nThis was a quick run, on small scenes and reduced photographs: it shows that everything runs. The bounds are \
             for the full run and need not be met.\n"
        } else {
            ""
        };
        let head = format!(
            "# Evaluation\n\nparfocal {version} on {}, driver {}. Times are wall-clock times of whole solves on this device, \
             beside its other work; on a software device they say little about a GPU.\n{quick}",
            device.name, device.driver
        );
        let paper = section::markdown("The paper's experiments", &self.report.paper);
        let figures =
            self.figures.iter().map(|figure| format!("![{}]({})\n", figure.caption, Figure::file(&figure.name)));
        let parts = [head, paper].into_iter().chain(figures).chain([self.summary()]);
        parts.filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
    }

    /// Writes `report.md`, `report.json` and the figures into a folder: all or none. Creates the folder if it is
    /// missing. Replaces the files of an earlier evaluation; the [`Destination`] must force the replacement of others.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write<'d>(&self, out: impl Into<Destination<'d>>) -> Result<(), Error> {
        let mut staging = Staging::replacing(out.into(), REPORT)?;
        for figure in &self.figures {
            staging.add(Figure::file(&figure.name), |writer| write_drawing(writer, &figure.picture))?;
        }
        staging.add(TABLES, |w| w.write_all(self.to_markdown().as_bytes()).map_err(|e| e.to_string()))?;
        staging.add(REPORT, |w| write_json_to(w, &self.report))?;
        staging.place()
    }

    /// Checks, before any experiment, that [`write`](Self::write) would accept a folder. A folder is refused if files
    /// of other programs have the names of results.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check<'d>(out: impl Into<Destination<'d>>) -> Result<(), Error> {
        let figures = figures::names(judgement::PAIRS).into_iter().map(|name| Figure::file(&name));
        let names: Vec<String> = figures.chain([TABLES, REPORT].map(String::from)).collect();
        out.into().check_results(REPORT, &names)
    }
}

/// The sections and figures of the paper's experiments.
fn run_paper(runner: &mut Runner, data: &Path) -> (Vec<Section>, Vec<Figure>) {
    let mut figures = figures::Collector::default();
    let mut sections = Vec::from(registration::known(runner, data, &mut figures));
    sections.push(registration::photographs(runner, data, &mut figures));
    let robustness = robustness::run(runner);
    sections.extend(robustness.iter().map(robustness::Curve::section));
    (sections, figures.finish(&robustness))
}
