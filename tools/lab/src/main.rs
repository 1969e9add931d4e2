//! The laboratory: experiments with bounds on what parfocal measures. `tools/evaluate` runs it.

mod contact_sheet;
mod defaults;
mod errors;
mod evaluate;
mod figures;
mod judgement;
mod pairs;
mod registration;
mod robustness;
mod section;
mod shape_from_focus;
mod sweeps;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use parfocal::{Engine, EngineOptions, export::Destination, internals::key_points};

use crate::evaluate::{Evaluation, Options, Part};

/// Experiments with bounds on what parfocal measures.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Evaluate(EvaluateArguments),
}

/// Run the paper's experiments by all methods on scenes and photographs, measure the default settings, focus sweeps and
/// inputs that do not fit the model against their bounds, and write tables and figures.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Exit status: 0 done (whether or not the bounds are met: see the report), 1 failed, 2 wrong usage.")]
struct EvaluateArguments {
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

fn main() -> ExitCode {
    let Command::Evaluate(arguments) = Cli::parse().command;
    match evaluate(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::FAILURE
        }
    }
}

/// Evaluates and writes the report. Checks of the outputs come first.
fn evaluate(arguments: EvaluateArguments) -> Result<(), String> {
    let EvaluateArguments { output, data, quick, only, force, device } = arguments;
    let (out, message) = (Destination::new(&output, force), |e: parfocal::Error| e.to_string());
    Evaluation::check(out).map_err(message)?;
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    let options = EngineOptions {
        device: device.or_else(|| variable("PARFOCAL_DEVICE")),
        validation: variable("PARFOCAL_VALIDATE").is_some_and(|value| value != "0"),
        key_points: Some(key_points),
        ..EngineOptions::default()
    };
    let engine = Engine::new(&options).map_err(message)?;
    let evaluation = Evaluation::run(&engine, &Options { data, quick, only }, &mut |line| eprintln!("{line}"));
    match engine.validation_messages().as_slice() {
        [] => {}
        messages => return Err(format!("validation reported: {}", messages.join("; "))),
    }
    evaluation.write(out).map_err(message)?;
    eprintln!("{}in {}", evaluation.summary(), output.display());
    Ok(())
}
