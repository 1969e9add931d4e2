//! The command line of the program `parfocal`.

mod dropped;
#[cfg(all(test, target_os = "linux"))]
mod fuzz;
mod help;
mod signals;

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
    pub mod numbers;
    pub mod progress;
    pub mod summary;
}

/// The work of a solve, from its files to its results.
mod jobs {
    pub mod pair;
    pub mod results;
    pub mod sweep;
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

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use self::commands::{
    apply, bench, calibrate, compare, depth, inspect, measure, register, repeat, roughness, setup, simulate, solve,
    stack, teach, view, watch,
};
use self::dropped::Dropped;
use self::options::config_file;
use self::output::failure::{self, Failure};

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
    Bench(Box<bench::Arguments>),
    Devices(setup::Devices),
    Config(setup::Config),
    Completions(setup::Completions),
    Man(setup::Manual),
}

/// Runs the program.
pub fn main() -> ExitCode {
    #[cfg(windows)]
    let arguments = wild::args_os();
    #[cfg(not(windows))]
    let arguments = std::env::args_os();
    let mut arguments: Vec<OsString> = arguments.collect();
    let command = command();
    let Some(first) = arguments.get(1) else { return dropped::first_steps() };
    let is_command = first.to_str().is_some_and(|name| command.find_subcommand(name).is_some());
    let dropped = if is_command { None } else { Dropped::of(&arguments[1..]) };
    if let Some(dropped) = &dropped {
        arguments.splice(1.., dropped.arguments());
    }
    let done = parse_and_run(&command, arguments);
    match dropped {
        Some(dropped) => dropped.show(done),
        None => done.map_or_else(Failure::report, |()| ExitCode::SUCCESS),
    }
}

fn parse_and_run(command: &clap::Command, arguments: Vec<OsString>) -> Result<(), Failure> {
    let (matches, origin) = config_file::matches(command, arguments)?;
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|e| failure::exit(e));
    run(cli.command).map_err(|failure| origin.locate(failure))
}

/// The command line for clap, with the layout of help. Against a configuration file, switches can be turned off.
fn command() -> clap::Command {
    help::with_groups(Cli::command().mut_subcommands(|c| help::with_layout(config_file::with_optional_switches(c))))
}

fn run(subcommand: Command) -> Result<(), Failure> {
    // These subcommands finish the current pair on a signal.
    if !matches!(subcommand, Command::Batch(_) | Command::Watch(_)) {
        signals::listen(|status| {
            parfocal::export::abandon();
            std::process::exit(status);
        });
    }
    match subcommand {
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
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Devices(arguments) => setup::devices(&arguments),
        Command::Config(arguments) => setup::config(&arguments, command()),
        Command::Completions(arguments) => setup::completions(&arguments, command()),
        Command::Man(arguments) => setup::manual(&arguments, command()),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_line_is_consistent() {
        super::command().debug_assert();
    }
}
