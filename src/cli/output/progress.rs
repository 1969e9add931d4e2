//! Progress of a solve: a bar on a terminal, lines elsewhere, JSON for programs.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::Progress;
use serde_json::json;

/// Interval between two lines if stderr is not a terminal. A shorter solve prints none.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Time after which the display estimates the time left: before, the estimate would jump.
const ESTIMATE_AFTER: Duration = Duration::from_secs(5);

/// Number of steps of the bar.
const BAR_STEPS: u64 = 1000;

/// The display of progress.
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

/// The progress of a solve. Dropping it ends the display.
pub(crate) struct Bar {
    display: Display,
    started: Instant,
    /// Expected time from the end of the solve to the last result, s.
    writing: f64,
    /// The number of levels, once it is known.
    levels: AtomicU32,
}

enum Display {
    Bar(ProgressBar),
    Lines(Lines),
    Json,
    Nothing,
}

/// A thread that prints a line of the latest progress every few seconds.
struct Lines {
    latest: Arc<Mutex<String>>,
    /// Dropped to end the thread. `None` if no thread could be started, so no lines are printed.
    thread: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Bar {
    /// Makes the display that `mode` requests. Writing the results will take `writing` seconds.
    pub(crate) fn new(mode: ProgressMode, writing: f64) -> Self {
        let display = match mode {
            ProgressMode::Json => Display::Json,
            ProgressMode::Auto if io::stderr().is_terminal() => {
                let bar = ProgressBar::no_length();
                if let Ok(style) = ProgressStyle::with_template("{bar:24} {percent:>3} % {elapsed} {msg}") {
                    bar.set_style(style);
                }
                Display::Bar(bar)
            }
            ProgressMode::Auto => Display::Lines(Lines::new()),
            ProgressMode::None => Display::Nothing,
        };
        Self { display, started: Instant::now(), writing, levels: AtomicU32::new(0) }
    }

    /// A function that displays the progress of a solve.
    pub(crate) fn reporter(self: &Arc<Self>) -> Arc<dyn Fn(Progress) + Send + Sync> {
        let bar = self.clone();
        Arc::new(move |progress| bar.show(progress))
    }

    /// The share of the solve and of the writing, after `elapsed` seconds and this share of the solve.
    fn share_of_all(&self, elapsed: f64, share: f64) -> f64 {
        let all = elapsed / share + self.writing;
        if share > 0.0 && all > 0.0 { elapsed / all } else { share }
    }

    fn show(&self, Progress { done, total, share }: Progress) {
        self.levels.store(total, Ordering::Relaxed);
        let elapsed = self.started.elapsed();
        let level = match share {
            1.0 if self.writing > 0.0 => "writing".to_string(),
            _ => format!("level {done} of {total}"),
        };
        let share = self.share_of_all(elapsed.as_secs_f64(), share);
        self.display(share, [done, total], level);
    }

    /// Displays that the results are written.
    pub(crate) fn finish(&self) {
        self.display(1.0, [self.levels.load(Ordering::Relaxed); 2], "done".to_string());
    }

    fn display(&self, share: f64, [done, total]: [u32; 2], mut level: String) {
        let elapsed = self.started.elapsed();
        let left = (elapsed >= ESTIMATE_AFTER && share > 0.0).then(|| elapsed.as_secs_f64() * (1.0 - share) / share);
        if let Some(left) = left {
            level += &format!(", some {left:.0} s left");
        }
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
                let seconds = (elapsed.as_secs_f64() * 1e3).round() / 1e3;
                let progress = (share * 1e4).round() / 1e4;
                let mut line = json!({ "progress": progress, "level": done, "levels": total, "seconds": seconds });
                if let Some(left) = left {
                    line["seconds_left"] = json!(left.round());
                }
                // If stderr is closed, there is no reader.
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
