//! `parfocal batch`: solves many pairs and sweeps.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use parfocal::export::{FileKind, abandon};
use serde_json::{Value, json};

use crate::cli::batch::on_done::end_program;
use crate::cli::batch::outcome::Outcome;
use crate::cli::batch::pairs::{self, Search};
use crate::cli::batch::summary::{BatchSummary, INDEX, Row, SUMMARY, of_share, verdict_files};
use crate::cli::batch::tasks::{BatchProgress, Context, Devices, Task};
use crate::cli::help::{self, OUTPUT};
use crate::cli::inspection::arguments::InspectionArguments;
use crate::cli::inspection::judge::Judge;
use crate::cli::inspection::log::LogArgument;
use crate::cli::options::solve::{Request, SolveArguments};
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;
use crate::cli::signals;

/// Solve many pairs and focus sweeps: those of a folder, or of a list.
#[derive(clap::Args, Debug)]
#[command(after_long_help = after_help())]
pub(crate) struct Arguments {
    /// Folder of photographs or of folders, or list of pairs and sweeps as CSV or JSON lines
    #[arg(value_name = "DIR|MANIFEST")]
    source: PathBuf,
    #[command(flatten)]
    options: SolveArguments,
    #[command(flatten)]
    inspection: InspectionArguments,
    #[command(flatten)]
    log: LogArgument,
    /// Folder for a folder of results for each pair, and batch.json; created if missing
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    /// Keep complete results of the same photographs and options
    #[arg(long, help_heading = OUTPUT)]
    resume: bool,
    /// Solve share I of N (I from 1), for N processes or machines with one folder of results
    ///
    /// The first pair belongs to share 1, the second to share 2, and so on. The summary is batch-I-of-N.json. When all
    /// are done, the same batch with --resume and without --shard solves what is missing and writes batch.json and
    /// index.html.
    #[arg(long, value_name = "I/N", help_heading = OUTPUT)]
    shard: Option<Shard>,
}

fn after_help() -> String {
    format!(
        "{}\n\nA pair that fails is reported and the others go on. Ctrl-C finishes the current pairs and writes the\n\
         summary; a second Ctrl-C ends the program at once.\n\n\
         Exit status: 0 all done, 1 a pair failed, 2 wrong usage, 130 ended by Ctrl-C. With --golden: 3 a part is\n\
         no-go, else 4 a part cannot be judged. A pair that fails cannot be judged.\n\n\
         Examples:\n  parfocal batch shots -o results --regularization 0.001\n  parfocal batch list.csv -o results --resume",
        help::wrapped(pairs::RULE, help::WIDTH)
    )
}

/// Solves all pairs and sweeps and reports each.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let (source, out) = (&arguments.source, &arguments.output);
    let request = arguments.options.request()?;
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let file = arguments.shard.map_or_else(|| SUMMARY.to_string(), Shard::summary);
    let index = (request.page && arguments.shard.is_none()).then_some(INDEX);
    check_output(&request, out, &file, index, &arguments.inspection)?;
    let judge = arguments.inspection.judge()?;
    let search = Search { folder: source, out, raw: arguments.options.raw(), is_judged: judge.is_some() };
    let mut found = search.find()?;
    let groups = std::mem::take(&mut found.groups);
    let tasks: Vec<_> = shard.of(groups).map(|group| Arc::new(Task::new(out, group, &request))).collect();
    Task::check_all(&tasks)?;
    let log = arguments.log.start(source, out, start_of(judge.as_ref()))?;
    let end = |request: &Request, judge: Option<&Judge>, rows, is_interrupted| {
        let summary = BatchSummary::new(source, rows, found.left_over.clone(), started.elapsed());
        let mut summary = if judge.is_some() { summary.with_verdicts() } else { summary };
        if is_interrupted {
            summary.interrupt();
        }
        log.write("end", summary.end());
        summary.write(request, out, &file, index)?;
        request.run.report.print(&summary.table(&out.join(&file)), &summary)?;
        Ok::<_, Failure>(summary)
    };
    // Without a pair that can be solved, no device is needed.
    let refusals: Option<Vec<Row>> = tasks.iter().map(|task| task.refusal(judge.as_ref(), &request)).collect();
    if let Some(rows) = refusals.filter(|rows| !rows.is_empty()) {
        rows.iter().for_each(|row| log.write("part", json!(row)));
        return end(&request, judge.as_ref(), rows, false)?.check(&request.run);
    }
    let stop = stop_on_interrupt();
    let devices = Devices::open(&request.run.engine)?;
    let (resume, device) = (arguments.resume, devices.least()?);
    let context = Arc::new(Context { request, resume, device, judge, on_done: None, stop });
    let (request, mut stream) = (&context.request, devices.stream(&context)?);
    let progress = BatchProgress::new(tasks.len(), &request.run);
    let rows = tasks.iter().zip(stream.map(tasks.iter().cloned())).map(|(task, result)| {
        let row = result.unwrap_or_else(|_| task.row(Outcome::NotDone));
        if !matches!(row.outcome, Outcome::NotDone) {
            progress.show(&row);
            log.write("part", json!(&row));
        }
        row
    });
    let rows = rows.collect();
    drop((progress, stream));
    let is_interrupted = context.stop.load(Ordering::Relaxed);
    let summary = end(request, context.judge.as_ref(), rows, is_interrupted)?;
    devices.check()?;
    summary.check(&request.run)
}

/// Refuses an output folder where the summary or the index page cannot be written.
pub(crate) fn check_output(
    request: &Request,
    out: &Path,
    summary: &str,
    index: Option<&str>,
    inspection: &InspectionArguments,
) -> Result<(), Failure> {
    destination::check_folder(out)?;
    inspection.check_output(out)?;
    request.force.to(out).check_named(FileKind::Batch, &[summary])?;
    if inspection.is_given() {
        let [table, cases] = verdict_files(summary);
        request.force.to(out).check_named(FileKind::VerdictTable, &[table])?;
        request.force.to(out).check_named(FileKind::Junit, &[cases])?;
    }
    Ok(request.force.to(out).check_named(FileKind::BatchPage, index.as_slice())?)
}

/// The first line of a log: the golden parts and limits.
pub(crate) fn start_of(judge: Option<&Judge>) -> Value {
    judge.map_or_else(|| json!({}), |judge| json!({ "golden": judge.golden(), "limits": judge.limits() }))
}

/// A flag that the first Ctrl-C or SIGTERM sets. The second signal removes temporary files, ends the program of
/// `--on-done`, and ends this program.
pub(crate) fn stop_on_interrupt() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    signals::listen(move |status| {
        if flag.swap(true, Ordering::Relaxed) {
            end_program();
            abandon();
            std::process::exit(status);
        }
        let _ = writeln!(io::stderr(), "\nfinishing the current pairs; Ctrl-C again ends the program at once");
    });
    stop
}

/// One share of a batch, for several processes or machines.
#[derive(Clone, Copy, Debug)]
struct Shard {
    /// Number of the share, from 1.
    index: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            _ => Err("give I/N, share I of N, as in 2/8".to_string()),
        }
    }
}

impl Shard {
    /// The share that has all pairs.
    const WHOLE: Self = Self { index: 1, count: 1 };

    /// The pairs of the share. The first of three shares has the first, the fourth, the seventh pair, and so on.
    fn of<T>(self, all: Vec<T>) -> impl Iterator<Item = T> {
        all.into_iter().skip(self.index - 1).step_by(self.count)
    }

    /// The file of the summary.
    fn summary(self) -> String {
        of_share(self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_disjoint_and_complete() {
        let share = |text: &str| text.parse::<Shard>().unwrap().of((0..7).collect()).collect::<Vec<_>>();
        assert_eq!([share("1/3"), share("2/3"), share("3/3")], [vec![0, 3, 6], vec![1, 4], vec![2, 5]]);
        assert_eq!((share("1/1").len(), share("8/9").len()), (7, 0));
        for text in ["0/3", "4/3", "x", "1/", "/2", "1/2/3", "-1/3", "1.5/2"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
