//! How far a solve has come: a bar on a terminal, a line every few seconds elsewhere, lines of JSON for programs.

use std::io::{self, IsTerminal, Write};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::Progress;
use serde_json::json;

/// How often a line is told where there is no terminal: what is quicker needs none.
const EVERY: Duration = Duration::from_secs(5);

/// Steps of the bar.
const BAR_STEPS: u64 = 1000;

/// Whom it is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProgressName {
    /// A bar on a terminal, elsewhere a line every five seconds
    #[default]
    Auto,
    /// A line of JSON on stderr for each step, for programs
    Json,
    /// Not at all
    None,
}

/// What tells of progress until it is dropped.
pub(crate) struct Bar {
    shown: Shown,
    started: Instant,
}

enum Shown {
    Bar(ProgressBar),
    Lines(Lines),
    Json,
    Nothing,
}

/// A line every few seconds, of how far it was last heard to be.
struct Lines {
    heard: Arc<Mutex<String>>,
    /// Dropped to end the thread; no thread, no lines.
    thread: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Bar {
    /// As is asked for; nothing where a person is told nothing.
    pub(crate) fn new(how: ProgressName, is_quiet: bool) -> Self {
        let shown = match how {
            ProgressName::Json => Shown::Json,
            ProgressName::Auto if !is_quiet && io::stderr().is_terminal() => {
                let bar = ProgressBar::no_length();
                if let Ok(style) = ProgressStyle::with_template("{bar:24} {percent:>3} % {elapsed} {msg}") {
                    bar.set_style(style);
                }
                Shown::Bar(bar)
            }
            ProgressName::Auto if !is_quiet => Shown::Lines(Lines::new()),
            _ => Shown::Nothing,
        };
        Self { shown, started: Instant::now() }
    }

    /// A function that shows the progress of a solve.
    pub(crate) fn reporter(self: &Arc<Self>) -> Arc<dyn Fn(Progress) + Send + Sync> {
        let bar = self.clone();
        Arc::new(move |progress| bar.show(progress))
    }

    fn show(&self, Progress { done, total, share }: Progress) {
        let level = format!("level {done} of {total}");
        match &self.shown {
            Shown::Bar(bar) => {
                bar.set_length(BAR_STEPS);
                bar.set_message(level);
                bar.set_position((share * BAR_STEPS as f64).round() as u64);
            }
            Shown::Lines(lines) => {
                if let Ok(mut heard) = lines.heard.lock() {
                    *heard = format!("{:.0} %, {level}", 100.0 * share);
                }
            }
            Shown::Json => {
                let seconds = (self.started.elapsed().as_secs_f64() * 1e3).round() / 1e3;
                let line = json!({ "progress": (share * 1e4).round() / 1e4, "level": done, "levels": total, "seconds": seconds });
                // Nobody is left to be told where stderr is closed.
                let _ = writeln!(io::stderr(), "{line}");
            }
            Shown::Nothing => {}
        }
    }
}

impl Lines {
    fn new() -> Self {
        let heard = Arc::new(Mutex::new("the first level".to_string()));
        let (ended, end) = channel::<()>();
        let (told, started) = (heard.clone(), Instant::now());
        let thread = thread::Builder::new().spawn(move || {
            while end.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                let heard = told.lock().map(|heard| heard.clone()).unwrap_or_default();
                let _ = writeln!(io::stderr(), "solving        {heard}, {:.0} s", started.elapsed().as_secs_f64());
            }
        });
        Self { heard, thread: thread.ok().map(|thread| (ended, thread)) }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        match &mut self.shown {
            Shown::Bar(bar) => bar.finish_and_clear(),
            Shown::Lines(lines) => {
                if let Some((ended, thread)) = lines.thread.take() {
                    drop(ended);
                    let _ = thread.join();
                }
            }
            _ => {}
        }
    }
}
