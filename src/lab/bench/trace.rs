//! A trace of the last solve of each run, with each dispatch, for Perfetto and chrome://tracing.
//!
//! The format is Chrome's Trace Event Format. Times are in µs. Each run has a process for its device and one for its
//! host, and each level has a thread. Device and host have separate clocks: the device's first pass starts when the
//! host submits.

use std::collections::BTreeSet;
use std::io::Write;

use serde_json::{Value, json};

use crate::base::Error;
use crate::engine::record::{Profile, SUBMIT_WAIT};
use crate::files::export::{Destination, FileKind, write_file};

/// The events of a trace.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    events: Vec<Value>,
    runs: usize,
    /// Start of the next run, ms.
    start_ms: f64,
}

/// Time between two runs, ms.
const GAP: f64 = 1.0;

impl Trace {
    /// Adds the profile of a run after the earlier runs.
    pub(super) fn add(&mut self, title: &str, size: [u32; 2], profile: &Profile) {
        let (host, device) = (2 * self.runs + 1, 2 * self.runs + 2);
        self.name("process_name", host, 0, &format!("{title}: host"));
        self.name("process_name", device, 0, &format!("{title}: device"));
        self.name("thread_name", host, 0, "solve");
        let levels: BTreeSet<usize> = profile.dispatches.iter().map(|d| d.place.level).collect();
        for level in levels {
            let [width, height] = size.map(|side| side.div_ceil(1 << level));
            self.name("thread_name", device, level, &format!("level {level}, {width}x{height}"));
        }
        let (mut begin, mut submitted) = (0.0, 0.0);
        for &(name, end) in &profile.phases.ends_ms {
            if name == SUBMIT_WAIT {
                submitted = begin;
            }
            self.span(name, (host, 0), [begin, end], json!({}));
            begin = end;
        }
        let mut last = begin;
        let mut begin = submitted;
        for (dispatch, end) in profile.dispatches.iter().zip(&profile.ends_ms) {
            let (place, end) = (dispatch.place, submitted + end);
            let arguments = json!({
                "level": place.level, "iteration": place.iteration, "bytes": dispatch.bytes, "executed": dispatch.executed,
            });
            self.span(dispatch.pass, (device, place.level), [begin, end], arguments);
            begin = end;
            last = f64::max(last, end);
        }
        self.runs += 1;
        self.start_ms += last + GAP;
    }

    /// Adds a complete event. Its start and end are in ms since the run began.
    fn span(&mut self, name: &str, (process, thread): (usize, usize), [from, to]: [f64; 2], arguments: Value) {
        let (ts, dur) = (1e3 * (self.start_ms + from), 1e3 * (to - from).max(0.0));
        self.events.push(json!({
            "ph": "X", "name": name, "pid": process, "tid": thread, "ts": ts, "dur": dur, "args": arguments,
        }));
    }

    /// Adds an event that names a process or a thread.
    fn name(&mut self, kind: &str, process: usize, thread: usize, name: &str) {
        self.events.push(json!({
            "ph": "M", "name": kind, "pid": process, "tid": thread, "args": { "name": name },
        }));
    }

    /// The trace as JSON.
    pub fn to_json(&self) -> String {
        json!({ "displayTimeUnit": "ms", "traceEvents": self.events }).to_string()
    }

    /// Writes the trace. Creates the folder of the file if it is missing. Replaces an earlier trace; the
    /// [`Destination`] must force the replacement of another file. On failure the file stays unchanged.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn write<'d>(&self, file: impl Into<Destination<'d>>) -> Result<(), Error> {
        write_file(file.into(), FileKind::Trace, |w| writeln!(w, "{}", self.to_json()).map_err(|e| e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::arguments::Place;
    use crate::engine::record::{Phases, Ran};

    fn profile() -> Profile {
        let ran = |pass, place, executed| Ran { pass, place, bytes: 64, executed };
        let mut phases = Phases::default();
        phases.ends_ms = vec![("upload", 1.0), ("start", 1.5), (SUBMIT_WAIT, 5.0), ("collect", 6.0)];
        Profile {
            dispatches: vec![ran("ingest", Place::level(0), true), ran("relax", Place::level(1).iteration(3), false)],
            ends_ms: vec![2.0, 3.0],
            phases,
        }
    }

    #[test]
    fn spans_follow_one_another_and_runs_do_not_overlap() {
        let mut trace = Trace::default();
        trace.add("first", [64, 48], &profile());
        trace.add("second", [64, 48], &profile());
        let all: Value = serde_json::from_str(&trace.to_json()).unwrap();
        let spans: Vec<&Value> = all["traceEvents"].as_array().unwrap().iter().filter(|e| e["ph"] == "X").collect();
        let times: Vec<[f64; 2]> = spans.iter().map(|e| [&e["ts"], &e["dur"]].map(|v| v.as_f64().unwrap())).collect();
        let first = [[0.0, 1e3], [1e3, 500.0], [1.5e3, 3.5e3], [5e3, 1e3], [1.5e3, 2e3], [3.5e3, 1e3]];
        assert_eq!(times[..6], first);
        assert_eq!(times[6], [7e3, 1e3]);
        let relax = spans[5];
        assert_eq!((&relax["name"], &relax["tid"]), (&"relax".into(), &1.into()));
        assert_eq!(relax["args"], json!({ "level": 1, "iteration": 3, "bytes": 64, "executed": false }));
        assert!(spans[4]["args"]["iteration"].is_null());
        let has_name = |name: &str| all["traceEvents"].as_array().unwrap().iter().any(|e| e["args"]["name"] == name);
        assert!(has_name("first: device") && has_name("second: host") && has_name("level 1, 32x24"), "{all}");
    }

    #[test]
    fn without_a_device_clock_the_trace_has_only_the_host() {
        let mut trace = Trace::default();
        trace.add("run", [64, 48], &Profile { ends_ms: Vec::new(), ..profile() });
        assert_eq!(trace.events.iter().filter(|e| e["ph"] == "X").count(), 4);
    }
}
