//! The experiments: the paper's (Ben-Ari, TPAMI 2014, section 5), the default settings, focus sweeps, and inputs that
//! do not fit the model.
//!
//! A solve that fails becomes a row with its reason, and the other solves continue. Only writing can fail.

use std::fs;
use std::path::{Path, PathBuf};

use parfocal::export::{self, Destination, DeviceReport, listed_in, to_json};
use parfocal::internals::key_points;
use parfocal::page::figure::write_png;
use parfocal::{Engine, EngineOptions, Error};
use serde::Serialize;

use crate::figures::{self, Figure};
use crate::section::{self, Runner, Section};
use crate::{defaults, judgement, registration, robustness, sweeps};

/// Run the paper's experiments by all methods on scenes and photographs, measure the default settings, focus sweeps and
/// inputs that do not fit the model against their bounds, and write tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Exit status: 0 done (whether or not the bounds are met: see the report), 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    /// Folder for report.md, report.json and the figures; created if missing, an earlier evaluation in it replaced
    #[arg(short, long, value_name = "OUT", default_value = "out/evaluate")]
    output: PathBuf,
    /// Folder of the photographs, each pair in a folder of its own; absent ones are named in the report
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// Small scenes, few cases, reduced photographs: shows in a minute that everything runs
    #[arg(long)]
    quick: bool,
    /// The only part to run
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<Part>,
    /// Overwrite files that have the names of results even if no evaluation wrote them
    #[arg(long)]
    force: bool,
    /// Index, part of the name, UUID, cpu or vulkan [default: PARFOCAL_DEVICE, else a GPU, else cpu]
    #[arg(long, value_name = "D")]
    device: Option<String>,
}

/// The parts of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
pub(crate) enum Part {
    /// The paper's experiments by all methods: some 15 minutes on two processor cores without a GPU
    Paper,
    /// Bounds on the default settings: some 5 minutes. Reads part/57 and dual-pixel in DIR
    Defaults,
    /// Bounds on focus sweeps, with shape from focus for comparison: some 5 minutes. Reads cou in DIR
    Sweeps,
    /// Inputs that do not fit the model, and whether the program notices: some 8 minutes
    Judgement,
}

/// Evaluates and writes the report. Checks of the outputs come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let (out, message) = (Destination::new(&arguments.output, arguments.force), |e: Error| e.to_string());
    Evaluation::check(out).map_err(message)?;
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    let options = EngineOptions {
        device: arguments.device.clone().or_else(|| variable("PARFOCAL_DEVICE")),
        validation: variable("PARFOCAL_VALIDATE").is_some_and(|value| value != "0"),
        key_points: Some(key_points),
        ..EngineOptions::default()
    };
    let engine = Engine::new(&options).map_err(message)?;
    let evaluation = Evaluation::run(&engine, arguments, &mut |line| eprintln!("{line}"));
    match engine.validation_messages().as_slice() {
        [] => {}
        messages => return Err(format!("validation reported: {}", messages.join("; "))),
    }
    evaluation.write(out).map_err(message)?;
    eprintln!("{}in {}", evaluation.summary(), arguments.output.display());
    Ok(())
}

/// The results of all experiments.
pub(crate) struct Evaluation {
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

const REPORT: &str = "report.json";
const TABLES: &str = "report.md";

impl Evaluation {
    /// Runs the experiments. Calls `log` with a line for each.
    pub(crate) fn run(engine: &Engine, arguments: &Arguments, log: &mut dyn FnMut(&str)) -> Self {
        let mut runner = Runner::new(engine, arguments.quick, log);
        let (data, includes) = (&arguments.data, |part| arguments.only.is_none_or(|only| only == part));
        let (paper, mut figures) =
            if includes(Part::Paper) { run_paper(&mut runner, data) } else { Default::default() };
        let defaults = if includes(Part::Defaults) { defaults::run(&mut runner, data) } else { Vec::new() };
        let sweeps = if includes(Part::Sweeps) { sweeps::run(&mut runner, data) } else { Vec::new() };
        let (judgement, warned) =
            if includes(Part::Judgement) { judgement::run(&mut runner) } else { Default::default() };
        figures.extend(warned);
        let files = figures.iter().map(|figure: &Figure| Figure::file(&figure.name));
        let report = Report {
            program: "parfocal",
            kind: "evaluation",
            version: env!("CARGO_PKG_VERSION"),
            device: engine.info().into(),
            quick: arguments.quick,
            paper,
            defaults,
            sweeps,
            judgement,
            files: files.chain([TABLES, REPORT].map(String::from)).collect(),
        };
        Self { report, figures }
    }

    /// The tables of all parts but the paper's, as Markdown; empty if they were not measured.
    pub(crate) fn summary(&self) -> String {
        let Report { defaults, sweeps, judgement, .. } = &self.report;
        let parts = [(defaults::HEADING, defaults), (sweeps::HEADING, sweeps), (judgement::HEADING, judgement)];
        let parts = parts.map(|(heading, sections)| section::markdown(heading, sections));
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
    }

    /// The text of `report.md`.
    fn to_markdown(&self) -> String {
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

    /// Writes `report.md`, `report.json` and the figures into a folder, and removes those of an earlier evaluation.
    /// Creates the folder if it is missing.
    ///
    /// # Errors
    /// [`Error::File`].
    pub(crate) fn write(&self, out: Destination<'_>) -> Result<(), Error> {
        let path = |name: &str| out.path().join(name);
        for name in listed_in(out.path(), REPORT) {
            // One that stays is replaced, or no figure of the report.
            let _ = fs::remove_file(path(&name));
        }
        for figure in &self.figures {
            write_png(Destination::new(&path(&Figure::file(&figure.name)), true), &figure.picture)?;
        }
        let json = to_json(&self.report).map_err(|e| Error::Mismatch(e.to_string()))?;
        for (name, text) in [(TABLES, self.to_markdown()), (REPORT, json + "\n")] {
            let failed = |e| Error::File { path: path(name), problem: format!("cannot be written ({e})") };
            fs::create_dir_all(out.path()).and_then(|()| fs::write(path(name), text)).map_err(failed)?;
        }
        Ok(())
    }

    /// Checks, before any experiment, that [`write`](Self::write) may write into a folder. It may not if files of
    /// other programs have the names of results.
    ///
    /// # Errors
    /// [`Error::File`].
    pub(crate) fn check(out: Destination<'_>) -> Result<(), Error> {
        if out.path().exists() && !out.path().is_dir() {
            let problem = "is a file; give a folder for the results".to_string();
            return Err(Error::File { path: out.path().to_path_buf(), problem });
        }
        export::check_writable(out.path())?;
        let figures = figures::names(judgement::PAIRS).into_iter().map(|name| Figure::file(&name));
        let names: Vec<String> = figures.chain([TABLES, REPORT].map(String::from)).collect();
        out.check_results(REPORT, &names)
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
