//! `parfocal batch`: many pairs and sweeps, one after the other, while the next is read and the last is written.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use parfocal::export::{FileKind, abandon, write_named};

use crate::cli::batch::batch_summary::{INDEX, SUMMARY, Tally};
use crate::cli::batch::pairs;
use crate::cli::batch::pairs_bar::PairsBar;
use crate::cli::batch::pipeline::{self, Bench};
use crate::cli::batch::shard::Shard;
use crate::cli::batch::task::{Named, Shared};
use crate::cli::help;
use crate::cli::jobs::request::Request;
use crate::cli::options::headings::OUTPUT;
use crate::cli::options::solve_options::SolveOptions;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;
use crate::cli::signals;

/// Solve many pairs and focus sweeps: those of a folder, or of a list.
#[derive(clap::Args, Debug)]
#[command(after_long_help = after_help())]
pub(crate) struct Arguments {
    /// Folder of photographs or of folders, or list of pairs and sweeps, as CSV or JSON lines
    #[arg(value_name = "DIR|MANIFEST")]
    source: PathBuf,
    #[command(flatten)]
    options: SolveOptions,
    /// Folder for a folder of results for each pair, and batch.json; made if it is missing
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    /// Leave out pairs whose results are there, whole, and of the same photographs and options
    #[arg(long, help_heading = OUTPUT)]
    resume: bool,
    /// Solve the I-th of N shares, I from 1, for N processes or machines over one folder of results
    ///
    /// The first pair is of share 1, the second of share 2, and so on. The summary is batch-I-of-N.json; when all are
    /// done, the same batch with --resume and without --shard solves what is missing and writes batch.json and
    /// index.html.
    #[arg(long, value_name = "I/N", help_heading = OUTPUT)]
    shard: Option<Shard>,
}

fn after_help() -> String {
    format!(
        "{}\n\nA pair that fails is reported and the others go on. Ctrl-C finishes the pair at hand and writes the summary;\n\
         a second one ends at once.\n\nExit status: 0 all done, 1 a pair failed, 2 wrong usage, 130 ended by Ctrl-C.\n\n\
         Examples:\n  parfocal batch shots -o results --regularization 0.001\n  parfocal batch list.csv -o results --resume",
        help::wrapped(pairs::RULE, help::WIDTH)
    )
}

/// Solves all pairs and says what came of each.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let (source, out) = (&arguments.source, &arguments.output);
    let request = arguments.options.request()?;
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let summary = arguments.shard.map_or_else(|| SUMMARY.to_string(), Shard::summary);
    destination::check_folder(out)?;
    request.force.to(out).check_named(FileKind::Batch, &[&summary])?;
    let has_page = request.page && arguments.shard.is_none();
    if has_page {
        request.force.to(out).check_named(FileKind::BatchPage, &[INDEX])?;
    }
    let found = pairs::find(source, out, arguments.options.raw())?;
    let jobs: Vec<Named> = shard.of(found.groups).map(|group| Named::new(out, group)).collect();
    jobs.iter().try_for_each(|named| named.check(&request))?;
    let stop = on_interrupt();
    let (mut benches, device) = Bench::open(&request.run.engine)?;
    let shared = Shared { request, resume: arguments.resume, device, stop, on_done: None };
    let Request { run, force, .. } = &shared.request;
    let bar = PairsBar::new(jobs.len(), run);
    let (rows, ended) = pipeline::work_off(&mut benches, &jobs, &shared, &bar)?;
    drop(bar);
    let interrupted = shared.stop.load(Ordering::Relaxed);
    let tally = Tally::new(source, rows, found.left_over, interrupted, started.elapsed());
    let json = tally.to_json()?;
    write_named(force.to(out), &summary, FileKind::Batch, format!("{json}\n").as_bytes())?;
    if has_page {
        write_named(force.to(out), INDEX, FileKind::BatchPage, tally.page(out).as_bytes())?;
    }
    run.told.tell(&tally.table(&out.join(&summary)), || Ok(json))?;
    ended?;
    tally.check(run.strict)
}

/// A flag that the first Ctrl-C or SIGTERM sets; the second removes what is half written and ends the program.
pub(crate) fn on_interrupt() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    signals::listen(move |status| {
        if flag.swap(true, Ordering::Relaxed) {
            abandon();
            std::process::exit(status);
        }
        let _ = writeln!(io::stderr(), "\nfinishing the pair at hand; Ctrl-C again ends at once");
    });
    stop
}
