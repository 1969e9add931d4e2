//! Progress of a solve and of a batch: a bar on a terminal, lines elsewhere, JSON for programs.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::Progress;
use serde_json::json;

use crate::cli::batch::summary::{Outcome, Row};
use crate::cli::options::output::RunArguments;
use crate::cli::output::failure::plain;

/// The time between two lines without a terminal. Shorter solves need none.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Steps of the bar.
const BAR_STEPS: u64 = 1000;

/// How progress is display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProgressMode {
    /// A bar on a terminal, elsewhere a line every five seconds
    #[default]
    Auto,
    /// A line of JSON on stderr for each step, for programs
    Json,
    /// Not at all
    None,
}

/// Progress of a solve, until it is dropped.
pub(crate) struct Bar {
    display: Display,
    started: Instant,
}

enum Display {
    Bar(ProgressBar),
    Lines(Lines),
    Json,
    Nothing,
}

/// A line of the latest progress every few seconds.
struct Lines {
    latest: Arc<Mutex<String>>,
    /// The sender is dropped to end the thread. Without a thread there are no lines.
    thread: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Bar {
    /// A bar as `mode` requests; none if `is_quiet`.
    pub(crate) fn new(mode: ProgressMode, is_quiet: bool) -> Self {
        let display = match mode {
            ProgressMode::Json => Display::Json,
            ProgressMode::Auto if !is_quiet && io::stderr().is_terminal() => {
                let bar = ProgressBar::no_length();
                if let Ok(style) = ProgressStyle::with_template("{bar:24} {percent:>3} % {elapsed} {msg}") {
                    bar.set_style(style);
                }
                Display::Bar(bar)
            }
            ProgressMode::Auto if !is_quiet => Display::Lines(Lines::new()),
            _ => Display::Nothing,
        };
        Self { display, started: Instant::now() }
    }

    /// A function that shows the progress of a solve.
    pub(crate) fn reporter(self: &Arc<Self>) -> Arc<dyn Fn(Progress) + Send + Sync> {
        let bar = self.clone();
        Arc::new(move |progress| bar.show(progress))
    }

    fn show(&self, Progress { done, total, share }: Progress) {
        let level = format!("level {done} of {total}");
        match &self.display {
            Display::Bar(bar) => {
                bar.set_length(BAR_STEPS);
                bar.set_message(level);
                bar.set_position((share * BAR_STEPS as f64).round() as u64);
            }
            Display::Lines(lines) => {
                if let Ok(mut latest) = lines.latest.lock() {
                    *latest = format!("{:.0} %, {level}", 100.0 * share);
                }
            }
            Display::Json => {
                let seconds = (self.started.elapsed().as_secs_f64() * 1e3).round() / 1e3;
                let line = json!({ "progress": (share * 1e4).round() / 1e4, "level": done, "levels": total, "seconds": seconds });
                // A closed stderr has no reader.
                let _ = writeln!(io::stderr(), "{line}");
            }
            Display::Nothing => {}
        }
    }
}

impl Lines {
    fn new() -> Self {
        let latest = Arc::new(Mutex::new("the first level".to_string()));
        let (ended, end) = channel::<()>();
        let (shared, started) = (latest.clone(), Instant::now());
        let thread = thread::Builder::new().spawn(move || {
            while end.recv_timeout(LINE_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                let latest = shared.lock().map(|latest| latest.clone()).unwrap_or_default();
                let _ = writeln!(io::stderr(), "solving        {latest}, {:.0} s", started.elapsed().as_secs_f64());
            }
        });
        Self { latest, thread: thread.ok().map(|thread| (ended, thread)) }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        match &mut self.display {
            Display::Bar(bar) => bar.finish_and_clear(),
            Display::Lines(lines) => {
                if let Some((ended, thread)) = lines.thread.take() {
                    drop(ended);
                    let _ = thread.join();
                }
            }
            _ => {}
        }
    }
}

/// Progress of a batch: a bar on a terminal, else a line for each pair.
pub(crate) struct BatchProgress {
    bar: ProgressBar,
    lines: bool,
    /// Whether to print a line of JSON for each pair.
    json: bool,
    /// The number of pairs; 0 if unknown.
    pairs: usize,
    done: AtomicUsize,
}

impl BatchProgress {
    /// Progress of an unknown number of pairs: a line for each.
    pub(crate) fn endless(run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet(), run.is_json());
        Self { bar: ProgressBar::hidden(), lines: !quiet && !json, json, pairs: 0, done: AtomicUsize::new(0) }
    }

    /// Progress of a number of pairs.
    pub(crate) fn new(pairs: usize, run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet() || run.is_json(), run.is_json());
        let terminal = io::stderr().is_terminal();
        let bar = if terminal && !quiet { ProgressBar::new(pairs as u64) } else { ProgressBar::hidden() };
        let template = "{pos}/{len} {bar:24} {elapsed}, {rate}, {eta} left  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key(
                "rate",
                |state: &indicatif::ProgressState, text: &mut dyn std::fmt::Write| {
                    let _ = match state.per_sec() {
                        rate if rate > 0.0 => write!(text, "{:.1} s a pair", 1.0 / rate),
                        _ => write!(text, "- s a pair"),
                    };
                },
            ));
        }
        bar.tick();
        Self { bar, lines: !terminal && !quiet, json, pairs, done: AtomicUsize::new(0) }
    }

    /// Counts and shows the outcome of a pair.
    pub(crate) fn show(&self, row: &Row) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if matches!(row.outcome(), Outcome::Kept(_)) {
            // Kept results take no time and must not change the estimate.
            self.bar.dec_length(1);
        } else {
            self.bar.inc(1);
        }
        self.bar.set_message(plain(row.name()));
        if self.json {
            let mut line = json!({ "name": row.name(), "status": row.outcome().status() });
            if self.pairs > 0 {
                (line["done"], line["of"]) = (done.into(), self.pairs.into());
            }
            let _ = writeln!(io::stderr(), "{line}");
            return;
        }
        let line = match self.pairs {
            0 => row.line(),
            pairs => format!("{done}/{pairs} {}", row.line()),
        };
        if self.lines {
            let _ = writeln!(io::stderr(), "{line}");
        } else if matches!(row.outcome(), Outcome::Failed { .. }) {
            self.bar.println(line);
        }
    }
}

impl Drop for BatchProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
