//! The laboratory: experiments with bounds on what parfocal measures, for `tools/evaluate`; a model of GPUs, for
//! `tools/gpu-model`.

mod beside_sweeps;
mod contact_sheet;
mod defaults;
mod errors;
mod evaluate;
mod figures;
mod gpu_model;
mod judgement;
mod pairs;
mod registration;
mod robustness;
mod section;
mod shape_from_focus;
mod sweeps;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Experiments with bounds on what parfocal measures, and a model of GPUs
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Evaluate(evaluate::Arguments),
    GpuModel(gpu_model::Arguments),
}

fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::GpuModel(arguments) => gpu_model::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::FAILURE
        }
    }
}
