//! `parfocal evaluate`: the paper's experiments, and bounds of the default settings and of sweeps, as tables and figures.

use std::path::PathBuf;

use clap::ValueEnum;
use parfocal::evaluate::{self, Evaluation, Options};

use crate::cli::options::engine::EngineArguments;
use crate::cli::options::output_options::ToldArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Run the paper's experiments with all systems, on scenes and photographs, and measure what is demanded of the default
/// settings and of focus sweeps; write tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder for report.md, report.json and figures/; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT", default_value = "out/evaluate")]
    output: PathBuf,
    /// Folder with the pairs of photographs, each in a folder of its own; what is absent is named in the report
    #[arg(long, value_name = "DIR", default_value_os_t = Options::default().data)]
    data: PathBuf,
    /// Small scenes, few points, reduced photographs: shows in a minute that everything runs
    #[arg(long)]
    quick: bool,
    /// One part alone
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<Only>,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    engine: EngineArguments,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Only {
    /// The paper's experiments: some 15 minutes on two processor cores without a GPU
    Paper,
    /// What the default settings are to reach by themselves, each bound beside its figure, also on stderr: some 5
    /// minutes. In DIR: part/57, dual-pixel
    Itself,
    /// What focus sweeps are to reach, likewise: generated stacks of 6 to 41 frames, beside shape from focus, and a simulated
    /// sweep: some 5 minutes. In DIR: cou
    Sweeps,
}

impl From<Only> for evaluate::Only {
    fn from(only: Only) -> Self {
        match only {
            Only::Paper => Self::Paper,
            Only::Itself => Self::Itself,
            Only::Sweeps => Self::Sweeps,
        }
    }
}

const AFTER_HELP: &str = "\
Example:
  parfocal evaluate --only itself --data DIR

Exit status: 0 done (whether or not targets and bounds are met: see the report), 1 failed, 2 wrong usage.";

/// Evaluates and writes. Cheap checks come before dear ones.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.force.to(&arguments.output);
    destination::check_folder(&arguments.output)?;
    Evaluation::check(out)?;
    let engine = arguments.engine.open()?;
    let options =
        Options { data: arguments.data.clone(), quick: arguments.quick, only: arguments.only.map(Into::into) };
    let evaluation = Evaluation::run(&engine, &options, &mut |line| arguments.told.say(line));
    crate::cli::check_validation(&engine)?;
    evaluation.write(out)?;
    let summary = [evaluation.itself(), evaluation.sweeps(), format!("in {}", arguments.output.display())];
    let summary = summary.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n");
    arguments.told.tell(&summary, || evaluation.to_json())
}
