//! `parfocal evaluate`: the paper's experiments, as tables and figures.

use std::io::{self, Write};
use std::path::PathBuf;

use parfocal::evaluate::{Evaluation, Options};

use super::engine::EngineArguments;
use super::failure::{Failure, print};
use super::output::{self, ForceArgument};

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
    /// Print report.json on stdout too
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
    /// Print nothing on stderr but errors
    #[arg(long)]
    quiet: bool,
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
    let mut say = |line: &str| {
        if !arguments.quiet {
            // Nobody is left to be told where stderr is closed.
            let _ = writeln!(io::stderr(), "{line}");
        }
    };
    let evaluation = Evaluation::run(&engine, &options, &mut say);
    super::check_validation(&engine)?;
    evaluation.write(out)?;
    say(&format!("in {}", arguments.output.display()));
    if arguments.json {
        print(&evaluation.to_json().map_err(|e| Failure::Failed(e.to_string()))?)?;
    }
    Ok(())
}
