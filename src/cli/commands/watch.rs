//! `parfocal watch`: solves pairs and sweeps of a folder as they arrive.

use std::collections::{HashMap, VecDeque};
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime};

use parfocal::internals::bounded_read;
use serde_json::json;

use crate::cli::batch::on_done::{OnDone, Undelivered};
use crate::cli::batch::outcome::Outcome;
use crate::cli::batch::pairs::{self, Group, Search};
use crate::cli::batch::summary::{BatchSummary, INDEX, Row, SUMMARY};
use crate::cli::batch::tasks::{BatchProgress, Context, Devices, Task};
use crate::cli::commands::batch;
use crate::cli::help::{self, INPUT, OUTPUT};
use crate::cli::inspection::arguments::InspectionArguments;
use crate::cli::inspection::log::LogArgument;
use crate::cli::options::part::within;
use crate::cli::options::solve::SolveArguments;
use crate::cli::output::failure::Failure;

/// Solve pairs and focus sweeps of a folder as they arrive.
#[derive(clap::Args, Debug)]
#[command(after_long_help = after_help())]
pub(crate) struct Arguments {
    /// Folder into which photographs, or folders of them, are put
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    #[command(flatten)]
    options: SolveArguments,
    #[command(flatten)]
    inspection: InspectionArguments,
    #[command(flatten)]
    log: LogArgument,
    /// Folder for a folder of results for each pair, batch.json and index.html; created if missing
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    /// Time without a change of its files after which a pair is solved (s, 0 to 86400)
    #[arg(long, value_name = "SECONDS", help_heading = INPUT, default_value_t = 2.0, value_parser = seconds)]
    settle: f64,
    /// End after this time without arrivals (s, 0 to 86400); without it Ctrl-C ends the program
    #[arg(long, value_name = "SECONDS", help_heading = INPUT, value_parser = seconds)]
    until_idle: Option<f64>,
    /// Program to run for each pair that was solved or failed, with its folder of results as argument
    ///
    /// The environment holds PARFOCAL_NAME, PARFOCAL_OUTPUT and PARFOCAL_STATUS (solved or failed); with --golden also
    /// PARFOCAL_VERDICT (go, no-go or cannot-judge), PARFOCAL_REASONS and PARFOCAL_TIME. No shell is involved. One
    /// program runs at a time. If it fails, a warning is printed and the pairs go on. It is run for the pair again
    /// after a pause of 1 s to 60 s, and by the next start, until it succeeds.
    #[arg(long, value_name = "PROGRAM", help_heading = OUTPUT)]
    on_done: Option<OsString>,
}

fn seconds(text: &str) -> Result<f64, String> {
    within(0.0..=86_400.0, "give seconds, 0 to 86400")(text)
}

fn after_help() -> String {
    format!(
        "{}\n\nA folder for each pair is the safest: in a series of numbered names, a missing photograph shifts all pairs after it.\n\
         Complete results of the same photographs and options are kept; a pair whose files change is solved again.\n\
         A pair that fails is reported, and tried again when its files change. Ctrl-C finishes the current pairs and\n\
         the program of --on-done; a second Ctrl-C ends both at once.\n\n\
         Exit status: 0 all that arrived was solved, 1 a pair failed, FOLDER is gone, or the program of --on-done\n\
         has not succeeded for a pair, 2 wrong usage, 130 ended at once. With --golden: 3 a part is no-go, else 4 a\n\
         part cannot be judged. A pair that fails cannot be judged.\n\n\
         Examples:\n  parfocal watch incoming -o results\n  \
         parfocal watch incoming -o results --on-done ./deliver.sh --until-idle 600",
        help::wrapped(pairs::RULE, help::WIDTH)
    )
}

/// The longest interval between two checks of the folder.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// The time that the folder of a part may lack photographs, at most, before the part cannot be judged.
const GRACE: Duration = Duration::from_secs(30);

/// Solves arriving pairs until Ctrl-C, or until nothing has arrived for a time.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let Arguments { folder, output: out, .. } = arguments;
    let request = arguments.options.request()?;
    if !folder.is_dir() {
        let problem = bounded_read::not_a_path(folder).unwrap_or("there is no such folder to watch; create it");
        return Err(Failure::file(folder, problem));
    }
    let index = request.page.then_some(INDEX);
    batch::check_output(&request, out, SUMMARY, index, &arguments.inspection)?;
    let judge = arguments.inspection.judge()?;
    let log = arguments.log.start(folder, out, batch::start_of(judge.as_ref()))?;
    let stop = batch::stop_on_interrupt();
    let devices = Devices::open(&request.run.engine)?;
    let (device, on_done) = (devices.least()?, arguments.on_done.clone().map(|program| OnDone::new(program, out)));
    let context = Arc::new(Context { request, resume: true, device, judge, on_done, stop });
    let (request, stream) = (&context.request, devices.stream(&context)?);
    let (progress, mut undelivered) =
        (BatchProgress::endless(&request.run), Undelivered::new(context.on_done.as_ref()));
    let mut watched = WatchedFolder::new(arguments);
    let mut failed = None;
    let (mut waiting, mut in_flight, mut rows) = (VecDeque::new(), VecDeque::new(), Vec::<Row>::new());
    // The summary states every part, and takes longer the more there are.
    let (mut last_write, mut is_written, mut write_problem) = (LastRun::default(), true, String::new());
    let interval = POLL_INTERVAL.min(watched.settle.max(Duration::from_millis(10)));
    let summary = |rows, watched: &WatchedFolder| {
        let summary = BatchSummary::new(folder, rows, watched.left_over.clone(), started.elapsed());
        if context.judge.is_some() { summary.with_verdicts() } else { summary }
    };
    loop {
        if context.stop.load(Ordering::Relaxed) {
            waiting.clear();
        } else {
            let settled = watched.settled(|name| is_among(name, [&waiting, &in_flight])).into_iter();
            waiting.extend(settled.map(|(group, at)| Arc::new(Task::new(out, group, request).arrived(at))));
        }
        while waiting.front().is_some_and(|task| stream.push(Arc::clone(task), Duration::ZERO).is_ok()) {
            in_flight.extend(waiting.pop_front());
        }
        let is_at_end = context.stop.load(Ordering::Relaxed) || watched.is_idle();
        if is_at_end && in_flight.is_empty() && waiting.is_empty() {
            break;
        }
        // Reads all other available results, after the first.
        let (mut new, mut limit) = (Vec::new(), if undelivered.is_due() { Duration::ZERO } else { interval });
        while let Some(result) = stream.next(limit).transpose() {
            in_flight.pop_front();
            match result {
                Ok(row) => new.push(row),
                // What was received, and what other devices solve now, is processed first.
                Err(_) => failed = failed.or(devices.check().err()),
            }
            limit = Duration::ZERO;
        }
        if failed.is_some() {
            context.stop.store(true, Ordering::Relaxed);
        }
        new.retain(|row| !matches!(row.outcome, Outcome::NotDone));
        for row in &new {
            progress.show(row);
            log.write("part", json!(row));
            undelivered.pass_on(row);
        }
        if !new.is_empty() {
            rows.retain(|old| new.iter().all(|row| row.name != old.name));
            rows.extend(new);
            (is_written, watched.changed) = (false, Instant::now());
        }
        if undelivered.is_due() {
            undelivered.retry(&rows, |name| is_among(name, [&waiting, &in_flight]));
        }
        if !is_written && (last_write.is_due(9) || in_flight.is_empty() && waiting.is_empty()) {
            let mut so_far = summary(rows, &watched);
            let written = last_write.run(|| so_far.write(request, out, SUMMARY, index));
            (rows, is_written) = (so_far.into_rows(), written.is_ok());
            // It is written again, and the parts go on. At the end it is an error.
            let problem = written.err().map_or_else(String::new, |failure| failure.message());
            if problem != write_problem && !problem.is_empty() {
                let _ = writeln!(io::stderr(), "warning: {problem}");
            }
            write_problem = problem;
        }
    }
    undelivered.end();
    let mut summary = summary(rows, &watched);
    let written = summary.write(request, out, SUMMARY, index);
    log.write("end", summary.end());
    request.run.report.print(&summary.table(&out.join(SUMMARY)), &summary)?;
    written?;
    failed.map_or_else(|| devices.check(), Err)?;
    watched.problem.map_or(Ok(()), |problem| Err(Failure::Failed(problem)))?;
    let (checked, passed_on) = (summary.check(&request.run), undelivered.check());
    if let (Err(_), Err(failure)) = (&checked, &passed_on) {
        let _ = writeln!(io::stderr(), "warning: {}", failure.message());
    }
    checked.and(passed_on)
}

fn is_among(name: &str, tasks: [&VecDeque<Arc<Task>>; 2]) -> bool {
    tasks.into_iter().flatten().any(|task| task.name() == name)
}

/// When something was last done that takes long, and how long it took.
#[derive(Default)]
struct LastRun(Option<(Instant, Duration)>);

impl LastRun {
    /// Whether a pause of `pauses` times as long has passed.
    fn is_due(&self, pauses: u32) -> bool {
        self.0.is_none_or(|(ended, took)| ended.elapsed() >= pauses * took)
    }

    fn run<T>(&mut self, what: impl FnOnce() -> T) -> T {
        let began = Instant::now();
        let done = what();
        self.0 = Some((Instant::now(), began.elapsed()));
        done
    }
}

/// Size and modification time of the files of a pair.
type Files = Vec<(PathBuf, u64, Option<SystemTime>)>;

/// The state of a pair in the folder.
struct Arrival {
    files: Files,
    /// The time of the last change of the files.
    changed: Instant,
    is_taken: bool,
}

/// A watched folder, and its pairs so far.
struct WatchedFolder<'a> {
    search: Search<'a>,
    settle: Duration,
    until_idle: Option<Duration>,
    arrivals: HashMap<String, Arrival>,
    left_over: Vec<String>,
    last_listing: LastRun,
    /// The error of the last listing of the folder, with which the program fails at its end.
    problem: Option<String>,
    /// The time of the last change of a file, or of the last result.
    changed: Instant,
}

impl<'a> WatchedFolder<'a> {
    fn new(arguments: &'a Arguments) -> Self {
        Self {
            search: Search {
                folder: &arguments.folder,
                out: &arguments.output,
                raw: arguments.options.raw(),
                is_judged: arguments.inspection.is_given(),
            },
            settle: Duration::from_secs_f64(arguments.settle),
            until_idle: arguments.until_idle.map(Duration::from_secs_f64),
            arrivals: HashMap::new(),
            left_over: Vec::new(),
            last_listing: LastRun::default(),
            problem: None,
            changed: Instant::now(),
        }
    }

    /// Whether the last listing found no change for the time of `--until-idle`, and no pair is pending.
    fn is_idle(&self) -> bool {
        let is_waiting = self.arrivals.values().any(|arrival| !arrival.is_taken);
        let unchanged = self.last_listing.0.map(|(ended, _)| ended.saturating_duration_since(self.changed));
        self.until_idle.is_some_and(|limit| !is_waiting && unchanged.is_some_and(|time| time >= limit))
    }

    /// Takes the pairs that are not `is_busy` and have files without recent changes, with the time of the last. If the
    /// folder cannot be listed, takes none and warns once.
    fn settled(&mut self, is_busy: impl Fn(&str) -> bool) -> Vec<(Group, Instant)> {
        // A listing takes longer the more parts there are, and arrivals wait for it.
        if !self.last_listing.is_due(2) {
            return Vec::new();
        }
        let mut last_listing = std::mem::take(&mut self.last_listing);
        let settled = last_listing.run(|| self.list(is_busy));
        self.last_listing = last_listing;
        settled
    }

    fn list(&mut self, is_busy: impl Fn(&str) -> bool) -> Vec<(Group, Instant)> {
        let found = self.search.so_far().map_err(|failure| failure.message());
        let problem = found.as_ref().err().cloned();
        if let Some(problem) = problem.as_ref().filter(|_| problem != self.problem) {
            let _ = writeln!(io::stderr(), "warning: {problem}");
        }
        self.problem = problem;
        let Ok(pairs::Grouped { groups, left_over }) = found else { return Vec::new() };
        self.left_over = left_over;
        self.arrivals.retain(|name, _| groups.iter().any(|group| group.name == *name));
        let mut settled = Vec::new();
        let grace = GRACE.min(self.until_idle.unwrap_or(GRACE));
        for group in groups {
            let Some(files) = self.files(&group) else { continue };
            let now = Instant::now();
            let new = Arrival { files: Vec::new(), changed: now, is_taken: false };
            let arrival = self.arrivals.entry(group.name.clone()).or_insert(new);
            if arrival.files != files {
                *arrival = Arrival { files, changed: now, is_taken: false };
                self.changed = now;
            }
            let settle = if group.is_incomplete { self.settle.max(grace) } else { self.settle };
            if !arrival.is_taken && arrival.changed.elapsed() >= settle && !is_busy(&group.name) {
                arrival.is_taken = true;
                settled.push((group, arrival.changed));
            }
        }
        settled
    }

    /// Size and modification time of the files of a pair; `None` if a file is missing.
    fn files(&self, group: &Group) -> Option<Files> {
        let describe = |file: &PathBuf| {
            let name = file.to_string_lossy();
            // The name of a file without a header ends with # and its format.
            let own = name.rsplit_once('#').filter(|_| self.search.raw.is_some()).map(|(own, _)| PathBuf::from(own));
            let found = own.as_ref().unwrap_or(file).metadata().ok()?;
            Some((file.clone(), found.len(), found.modified().ok()))
        };
        group.files.iter().map(describe).collect()
    }
}
