//! `parfocal solve`: recovers relative blur and registration of two photographs, from their files to their results.

use std::path::PathBuf;

use parfocal::{PairSolver, SolveOptions};

use crate::cli::help::{AFTER_HELP, OUTPUT};
use crate::cli::jobs::pair::PairJob;
use crate::cli::options::photographs::{self, PairArguments};
use crate::cli::options::run::check_validation;
use crate::cli::options::solve::SolveArguments;
use crate::cli::output::failure::Failure;
use crate::cli::output::summary::summary;

/// Recover relative blur and registration of two photographs of one scene, focused at two distances.
#[derive(clap::Args, Clone, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pair: PairArguments,
    #[command(flatten)]
    options: SolveArguments,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
}

/// Solves a pair and writes the results. Inexpensive checks come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = arguments.options.request()?;
    let job = PairJob {
        files: arguments.pair.files().map(|file| photographs::with_format(file, arguments.options.raw())),
        out: arguments.output.clone(),
    };
    job.check(&request)?;
    let mut engine = None;
    let read = job.read(&request, |_| Ok(false), || request.run.info(&mut engine))?;
    let Some(photographs) = read else { return Ok(()) };
    let engine = request.run.engine(engine)?;
    let frames = photographs.frames.each_ref();
    let bar = request.bar(&photographs.frames);
    let options = SolveOptions { progress: Some(bar.reporter()), ..photographs.scope.clone() };
    let solution = PairSolver::new(&engine, &photographs.settings)
        .and_then(|mut solver| solver.solve(frames, &options))
        .map_err(|e| Failure::of_solve(e, &job.files[0]))?;
    check_validation(&engine)?;
    let report = job.write(&request, engine.info(), &photographs, &solution)?;
    bar.finish();
    drop((options, bar));
    request.run.report.print(&summary(&report, request.palette, &job.out), &report)?;
    request.run.check_strict(report.converged, &report.warnings)
}
