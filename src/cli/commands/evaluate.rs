//! `parfocal evaluate`: the experiments of the paper and the targets of the default settings and of sweeps.

use std::path::PathBuf;

use parfocal::evaluate::{Evaluation, Only, Options};

use crate::cli::options::engine::EngineArguments;
use crate::cli::options::output_options::ToldArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Run the experiments of the paper, and measure the default settings and focus sweeps against their targets
///
/// Writes tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder for report.md, report.json and figures/; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT", default_value = "out/evaluate")]
    output: PathBuf,
    /// Folder with a folder for each pair of photographs; the report lists missing ones
    #[arg(long, value_name = "DIR", default_value_os_t = Options::default().data)]
    data: PathBuf,
    /// Use small scenes, few points and reduced photographs: a check of one minute
    #[arg(long)]
    quick: bool,
    /// Run one part only
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<Only>,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
}

const AFTER_HELP: &str = "\
Example:
  parfocal evaluate --only itself --data DIR

Exit status: 0 done (also if targets are missed: see the report), 1 failed, 2 wrong usage.";

/// Evaluates and writes the report.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.force.to(&arguments.output);
    destination::check_folder(&arguments.output)?;
    Evaluation::check(out)?;
    let engine = arguments.engine.open()?;
    let options = Options { data: arguments.data.clone(), quick: arguments.quick, only: arguments.only };
    let evaluation = Evaluation::run(&engine, &options, &mut |line| arguments.told.say(line));
    crate::cli::check_validation(&engine)?;
    evaluation.write(out)?;
    let summary = [evaluation.itself(), evaluation.sweeps(), format!("in {}", arguments.output.display())];
    let summary = summary.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n");
    arguments.told.tell(&summary, || evaluation.to_json())
}
