//! `parfocal evaluate`: experiments with bounds, as tables and figures.

use std::path::PathBuf;

use parfocal::internals::evaluate::{Evaluation, Options, Part};

use crate::cli::options::device::EngineArguments;
use crate::cli::options::output::ReportArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Run the paper's experiments by all methods on scenes and photographs, measure the default settings and focus sweeps
/// against their bounds, and write tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder for report.md, report.json and the figures; created if missing, an earlier evaluation in it replaced
    #[arg(short, long, value_name = "OUT", default_value = "out/evaluate")]
    output: PathBuf,
    /// Folder of the photographs, each pair in a folder of its own; absent ones are named in the report
    #[arg(long, value_name = "DIR", default_value_os_t = Options::default().data)]
    data: PathBuf,
    /// Small scenes, few cases, reduced photographs: shows in a minute that everything runs
    #[arg(long)]
    quick: bool,
    /// The only part to run
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<Part>,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
}

const AFTER_HELP: &str = "\
Example:
  parfocal evaluate --only defaults --data DIR

Exit status: 0 done (whether or not the bounds are met: see the report), 1 failed, 2 wrong usage.";

/// Evaluates and writes the report. Checks of the outputs come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.force.to(&arguments.output);
    destination::check_folder(&arguments.output)?;
    Evaluation::check(out)?;
    let engine = arguments.engine.open()?;
    let options = Options { data: arguments.data.clone(), quick: arguments.quick, only: arguments.only };
    let evaluation = Evaluation::run(&engine, &options, &mut |line| arguments.report.print_line(line));
    crate::cli::check_validation(&engine)?;
    evaluation.write(out)?;
    let summary = [evaluation.summary(), format!("in {}", arguments.output.display())];
    let summary = summary.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n");
    arguments.report.print(&summary, || evaluation.to_json())
}
