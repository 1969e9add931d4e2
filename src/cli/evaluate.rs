//! `parfocal evaluate`: the paper's experiments, as tables and figures.

use std::path::PathBuf;

use parfocal::evaluate::{Evaluation, Options};

use super::engine::EngineArguments;
use super::failure::Failure;
use super::output::{self, ForceArgument};
use super::told::ToldArguments;

/// Run the paper's experiments with all systems, on scenes and photographs, and write tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(super) struct Arguments {
    /// Folder for report.md, report.json and figures/; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT", default_value = "out/evaluate")]
    output: PathBuf,
    /// Folder with the pairs of photographs, each in a folder of its own; what is absent is named in the report
    #[arg(long, value_name = "DIR", default_value_os_t = Options::default().data)]
    data: PathBuf,
    /// Small scenes, few points, reduced photographs: shows in a minute that everything runs
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
}

const AFTER_HELP: &str = "\
The full run takes some 15 minutes on two processor cores without a GPU.

Exit status: 0 done (whether or not the targets are met: see the report), 1 failed, 2 wrong usage.";

/// Evaluates and writes. Cheap checks come before dear ones.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.force.to(&arguments.output);
    output::check_folder(&arguments.output)?;
    Evaluation::check(out)?;
    let engine = arguments.engine.open()?;
    let options = Options { data: arguments.data.clone(), quick: arguments.quick };
    let evaluation = Evaluation::run(&engine, &options, &mut |line| arguments.told.say(line));
    super::check_validation(&engine)?;
    evaluation.write(out)?;
    arguments.told.tell(&format!("in {}", arguments.output.display()), || evaluation.to_json())
}
