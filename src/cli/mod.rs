//! The command line of the program `parfocal`.

#[cfg(all(test, target_os = "linux"))]
mod fuzz;
mod help;

/// The subcommands, one per file: their options and actions.
mod commands {
    pub mod apply;
    pub mod batch;
    pub mod bench;
    pub mod calibrate;
    pub mod compare;
    pub mod depth;
    pub mod inspect;
    pub mod measure;
    pub mod register;
    pub mod repeat;
    pub mod roughness;
    pub mod setup;
    pub mod simulate;
    pub mod solve;
    pub mod stack;
    pub mod teach;
    pub mod view;
    pub mod watch;
}

/// The options that subcommands share, and the file of options.
mod options {
    pub mod config_file;
    pub mod exports;
    pub mod lens;
    pub mod part;
    pub mod photographs;
    pub mod run;
    pub mod series;
    pub mod settings;
    pub mod solve;
    pub mod study_table;
}

/// Results, progress, summaries and errors.
mod output {
    pub mod destination;
    pub mod failure;
    pub mod progress;
    pub mod summary;
}

/// Batches of pairs and sweeps: how they are found and solved, and their summary.
mod batch {
    pub mod manifest;
    pub mod on_done;
    pub mod outcome;
    pub mod pairs;
    pub mod summary;
    pub mod tasks;
}

/// Inspections of parts: golden parts, the judgement, and the verdicts of a batch.
mod inspection {
    pub mod arguments;
    pub mod golden;
    pub mod judge;
    pub mod log;
    pub mod verdict;
}

use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::thread;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use self::commands::{
    apply, bench, calibrate, compare, depth, inspect, measure, register, repeat, roughness, setup, simulate, solve,
    stack, teach, view, watch,
};
use self::options::config_file;
use self::output::failure::{self, Failure};

/// Name of the environment variable that enables the Vulkan validation layer.
const VALIDATE: &str = "PARFOCAL_VALIDATE";

/// Depth from defocus on the GPU: relative blur and registration of two photographs, recovered together.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, about, after_long_help = help::AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Solve(Box<solve::Arguments>),
    Batch(Box<commands::batch::Arguments>),
    Watch(Box<watch::Arguments>),
    Stack(Box<stack::Arguments>),
    Simulate(Box<simulate::Arguments>),
    Depth(depth::Arguments),
    Calibrate(Box<calibrate::Arguments>),
    Measure(measure::Arguments),
    Roughness(roughness::Arguments),
    Repeat(repeat::Arguments),
    View(view::Arguments),
    Open(view::PageArguments),
    Compare(compare::Arguments),
    Inspect(Box<inspect::Arguments>),
    Teach(teach::Arguments),
    Register(Box<register::Arguments>),
    Apply(apply::Arguments),
    Evaluate(bench::EvaluateArguments),
    Bench(Box<bench::Arguments>),
    Devices(setup::Devices),
    Config(setup::Config),
    Completions(setup::Completions),
    Man(setup::Manual),
}

/// Runs the program.
pub fn main() -> ExitCode {
    match config_file::matches(&command(), std::env::args_os().collect()) {
        Err(failure) => failure.report(),
        Ok((matches, origin)) => {
            let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|e| failure::exit(e));
            run(cli.command)
                .map_err(|failure| origin.locate(failure))
                .map_or_else(Failure::report, |()| ExitCode::SUCCESS)
        }
    }
}

/// The command line for clap, with the layout of help. Against a configuration file, switches can be turned off.
fn command() -> clap::Command {
    help::with_groups(Cli::command().mut_subcommands(|c| help::with_layout(config_file::with_optional_switches(c))))
}

fn run(command: Command) -> Result<(), Failure> {
    // These subcommands finish the current pair on a signal.
    if !matches!(command, Command::Batch(_) | Command::Watch(_)) {
        listen(|status| {
            parfocal::export::abandon();
            std::process::exit(status);
        });
    }
    match command {
        Command::Solve(arguments) => solve::run(&arguments),
        Command::Batch(arguments) => commands::batch::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Stack(arguments) => stack::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Depth(arguments) => depth::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Roughness(arguments) => roughness::run(&arguments),
        Command::Repeat(arguments) => repeat::run(&arguments),
        Command::View(arguments) => view::run(&arguments),
        Command::Open(arguments) => view::open(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Teach(arguments) => teach::run(&arguments),
        Command::Register(arguments) => register::run(&arguments),
        Command::Apply(arguments) => apply::run(&arguments),
        Command::Evaluate(arguments) => bench::evaluate(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Devices(arguments) => setup::devices(&arguments),
        Command::Config(arguments) => setup::config(&arguments),
        Command::Completions(arguments) => setup::completions(&arguments),
        Command::Man(arguments) => setup::manual(&arguments),
    }
}

/// Exit status after Ctrl-C.
const INTERRUPTED: i32 = 130;
/// Exit status after SIGTERM.
const TERMINATED: i32 = 143;

/// Calls `end` with the exit status on each Ctrl-C and SIGTERM. If no listening thread can be started, the signals end
/// the program as usual, and the next run removes temporary files. SIGHUP keeps its default action, so that nohup
/// works.
fn listen(end: impl Fn(i32) + Clone + Send + 'static) {
    // The crate `ctrlc` installs its handler before it fails to start its thread.
    if thread::Builder::new().spawn(|| ()).is_err() {
        return;
    }
    #[cfg(unix)]
    listen_for_term(end.clone());
    // A signal that is ignored, as for background jobs of a script, stays ignored.
    let _ = ctrlc::try_set_handler(move || end(INTERRUPTED));
}

/// Blocks SIGTERM in all threads except one, which waits for it.
#[cfg(unix)]
fn listen_for_term(end: impl Fn(i32) + Send + 'static) {
    use nix::sys::signal::{SigSet, Signal};

    let term = SigSet::from(Signal::SIGTERM);
    if term.thread_block().is_err() {
        return;
    }
    let wait = move || {
        while term.wait().is_ok() {
            end(TERMINATED);
        }
    };
    if thread::Builder::new().name("signals".to_string()).spawn(wait).is_err() {
        let _ = term.thread_unblock();
    }
}

/// Whether two paths refer to the same existing file.
fn same_file(a: &Path, b: &Path) -> bool {
    let [(a, _), (b, _)] = [a, b].map(parfocal::image_io::split_page);
    matches!((fs::canonicalize(a), fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}

/// Whether the environment requests the validation layer.
fn is_validation_requested() -> bool {
    std::env::var_os(VALIDATE).is_some_and(|value| !value.is_empty() && value != "0")
}

/// Fails if the validation layer has reported a message.
fn check_validation(engine: &parfocal::Engine) -> Result<(), Failure> {
    match engine.validation_messages().as_slice() {
        [] => Ok(()),
        messages => Err(Failure::Failed(format!("validation reported: {}", messages.join("; ")))),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_line_is_consistent() {
        super::command().debug_assert();
    }
}
