//! `parfocal watch`: pairs and sweeps of a folder as they arrive.

use std::collections::HashMap;
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use parfocal::export::{FileKind, write_named};
use parfocal::image_io::RawFormat;

use crate::cli::batch::batch_summary::{INDEX, Outcome, Row, SUMMARY, Tally};
use crate::cli::batch::on_done::OnDone;
use crate::cli::batch::pairs::{self, Group};
use crate::cli::batch::pairs_bar::PairsBar;
use crate::cli::batch::pipeline::{self, Bench};
use crate::cli::batch::task::{Named, Shared};
use crate::cli::commands::batch;
use crate::cli::help;
use crate::cli::jobs::request::Request;
use crate::cli::options::headings::{INPUT, OUTPUT};
use crate::cli::options::solve_options::SolveOptions;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

/// Solve pairs and focus sweeps of a folder as they arrive.
#[derive(clap::Args, Debug)]
#[command(after_long_help = after_help())]
pub(crate) struct Arguments {
    /// Folder into which photographs, or folders of them, are put
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    #[command(flatten)]
    options: SolveOptions,
    /// Folder for a folder of results for each pair, batch.json and index.html; made if it is missing
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    /// A pair is taken when size and time of its files have not changed for so long, seconds
    #[arg(long, value_name = "SECONDS", help_heading = INPUT, default_value_t = 2.0, value_parser = seconds)]
    settle: f64,
    /// End when nothing has arrived for so long, seconds; without it Ctrl-C ends it
    #[arg(long, value_name = "SECONDS", help_heading = INPUT, value_parser = seconds)]
    until_idle: Option<f64>,
    /// Program to run of each pair that was solved or failed, with its folder of results as argument
    ///
    /// PARFOCAL_NAME, PARFOCAL_OUTPUT and PARFOCAL_STATUS (solved or failed) are in its environment. It is not given to a shell; the next result
    /// is written when it has ended. Where it fails that is told, and the pairs go on.
    #[arg(long, value_name = "PROGRAM", help_heading = OUTPUT)]
    on_done: Option<OsString>,
}

fn seconds(text: &str) -> Result<f64, String> {
    let in_range = |seconds: &f64| (0.0..=86_400.0).contains(seconds);
    text.parse().ok().filter(in_range).ok_or_else(|| "give seconds, 0 to 86400".to_string())
}

fn after_help() -> String {
    format!(
        "{}\n\nA folder for each pair is the surest: of names that end with numbers, one that never arrives shifts all that follow.\n\
         Results that are there, whole, and of the same photographs and options are kept; a pair whose files change is solved again.\n\
         One that fails is reported and tried again when its files change. Ctrl-C finishes the pair at hand.\n\n\
         Exit status: 0 all that arrived was solved, 1 a pair failed, 2 wrong usage.\n\n\
         Examples:\n  parfocal watch incoming -o results\n  parfocal watch incoming -o results --on-done ./judge.sh --until-idle 600",
        help::wrapped(pairs::RULE, help::WIDTH)
    )
}

/// How often the folder is looked at, at least.
const EVERY: Duration = Duration::from_millis(500);

/// Size and time of the files of a pair.
type Look = Vec<(PathBuf, u64, Option<SystemTime>)>;

/// Pairs of a folder as they were last seen.
struct Seen {
    look: Look,
    since: Instant,
    is_done: bool,
}

/// Solves what arrives until it is told to end.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let Arguments { folder, output: out, .. } = arguments;
    let request = arguments.options.request()?;
    if !folder.is_dir() {
        return Err(Failure::Failed(format!("{}: there is no such folder to watch; make it", folder.display())));
    }
    destination::check_folder(out)?;
    request.force.to(out).check_named(FileKind::Batch, &[SUMMARY])?;
    if request.page {
        request.force.to(out).check_named(FileKind::BatchPage, &[INDEX])?;
    }
    let stop = batch::on_interrupt();
    let (mut benches, device) = Bench::open(&request.run.engine)?;
    let on_done = arguments.on_done.clone().map(OnDone);
    let shared = Shared { request, resume: true, device, stop, on_done };
    let bar = PairsBar::endless(&shared.request.run);
    let (mut watched, mut rows) = (Watched::new(arguments), Vec::new());
    while !shared.stop.load(Ordering::Relaxed) && !watched.is_idle() {
        let arrived: Vec<Named> = watched.arrived().into_iter().map(|group| Named::new(out, group)).collect();
        if arrived.is_empty() {
            thread::sleep(EVERY.min(watched.settle.max(Duration::from_millis(10))));
            continue;
        }
        let (mut able, mut new) = (Vec::new(), Vec::new());
        for named in arrived {
            match named.check(&shared.request) {
                Ok(()) => able.push(named),
                Err(failure) => new.push(named.row(Outcome::Failed { error: failure.message() })),
            }
        }
        new.iter().for_each(|row| bar.show(row));
        let (worked, ended) = pipeline::work_off(&mut benches, &able, &shared, &bar)?;
        new.extend(worked.into_iter().filter(|row| !matches!(row.outcome(), Outcome::NotDone)));
        rows.retain(|old: &Row| new.iter().all(|row| row.name() != old.name()));
        rows.extend(new);
        rows = summarised(arguments, &shared.request, rows, &watched.left_over, started)?;
        // Meanwhile nobody looked.
        watched.changed = Instant::now();
        ended?;
    }
    let tally = Tally::new(folder, rows, watched.left_over, false, started.elapsed());
    let json = tally.to_json()?;
    shared.request.run.told.tell(&tally.table(&out.join(SUMMARY)), || Ok(json))?;
    tally.check(shared.request.run.strict)
}

/// Writes what came of all so far; gives the rows back.
fn summarised(
    arguments: &Arguments,
    request: &Request,
    rows: Vec<Row>,
    left_over: &[String],
    started: Instant,
) -> Result<Vec<Row>, Failure> {
    let out = &arguments.output;
    let tally = Tally::new(&arguments.folder, rows, left_over.to_vec(), false, started.elapsed());
    write_named(request.force.to(out), SUMMARY, FileKind::Batch, format!("{}\n", tally.to_json()?).as_bytes())?;
    if request.page {
        write_named(request.force.to(out), INDEX, FileKind::BatchPage, tally.page(out).as_bytes())?;
    }
    Ok(tally.into_rows())
}

/// A folder, and what was seen in it.
struct Watched<'a> {
    folder: &'a Path,
    out: &'a Path,
    raw: Option<RawFormat>,
    settle: Duration,
    until_idle: Option<Duration>,
    seen: HashMap<String, Seen>,
    left_over: Vec<String>,
    /// Why nothing could be found when it was last looked for.
    problem: Option<String>,
    changed: Instant,
}

impl<'a> Watched<'a> {
    fn new(arguments: &'a Arguments) -> Self {
        Self {
            folder: &arguments.folder,
            out: &arguments.output,
            raw: arguments.options.raw(),
            settle: Duration::from_secs_f64(arguments.settle),
            until_idle: arguments.until_idle.map(Duration::from_secs_f64),
            seen: HashMap::new(),
            left_over: Vec::new(),
            problem: None,
            changed: Instant::now(),
        }
    }

    /// Whether nothing has changed for as long as that ends it, and nothing waits.
    fn is_idle(&self) -> bool {
        let waits = self.seen.values().any(|seen| !seen.is_done);
        self.until_idle.is_some_and(|limit| !waits && self.changed.elapsed() >= limit)
    }

    /// What has settled and was not taken yet. Where names contradict each other, or the folder cannot be listed, that is told once, and nothing is taken.
    fn arrived(&mut self) -> Vec<Group> {
        let found = pairs::so_far(self.folder, self.out, self.raw).map_err(|failure| failure.message());
        let problem = found.as_ref().err().cloned();
        if let Some(problem) = problem.as_ref().filter(|_| problem != self.problem) {
            let _ = writeln!(io::stderr(), "warning: {problem}");
        }
        self.problem = problem;
        let Ok(pairs::Grouped { groups, left_over }) = found else { return Vec::new() };
        self.left_over = left_over;
        self.seen.retain(|name, _| groups.iter().any(|group| group.name == *name));
        let mut arrived = Vec::new();
        for group in groups {
            let Some(look) = self.look(&group) else { continue };
            let seen = self.seen.entry(group.name.clone());
            let seen = seen.or_insert_with(|| Seen { look: Vec::new(), since: Instant::now(), is_done: false });
            if seen.look != look {
                (*seen, self.changed) = (Seen { look, since: Instant::now(), is_done: false }, Instant::now());
            }
            if !seen.is_done && seen.since.elapsed() >= self.settle {
                seen.is_done = true;
                arrived.push(group);
            }
        }
        arrived
    }

    /// Size and time of its files; `None` where one is gone.
    fn look(&self, group: &Group) -> Option<Look> {
        let of = |file: &PathBuf| {
            let name = file.to_string_lossy();
            // Of a file without a header what follows # is its format.
            let own = name.rsplit_once('#').filter(|_| self.raw.is_some()).map(|(own, _)| PathBuf::from(own));
            let found = own.as_ref().unwrap_or(file).metadata().ok()?;
            Some((file.clone(), found.len(), found.modified().ok()))
        };
        group.files.iter().map(of).collect()
    }
}
