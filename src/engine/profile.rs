//! The profile of a solve: its dispatches with their times, and the phases of the host.

use std::time::Instant;

use super::arguments::Place;

/// The phase in which the host waits for the device.
pub(crate) const SUBMIT_WAIT: &str = "submit-wait";

/// When the device's clock is read. On software devices a reading takes as long as a small dispatch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reading {
    Never,
    /// Between passes of different names.
    Passes,
    /// After every dispatch.
    Dispatches,
}

/// The phases of the host in order.
#[derive(Clone, Debug)]
pub(crate) struct Phases {
    started: Instant,
    /// The phases and their ends, ms since the start.
    pub(crate) ends_ms: Vec<(&'static str, f64)>,
}

impl Default for Phases {
    /// Starts the clock.
    fn default() -> Self {
        Self { started: Instant::now(), ends_ms: Vec::new() }
    }
}

impl Phases {
    /// Ends a phase.
    pub(crate) fn end(&mut self, name: &'static str) {
        self.ends_ms.push((name, self.started.elapsed().as_secs_f64() * 1e3));
    }

    /// The time that the host waited for the device, ms.
    pub(crate) fn waited_ms(&self) -> f64 {
        let ended = self.ends_ms.iter().position(|(name, _)| *name == SUBMIT_WAIT);
        ended.map_or(0.0, |n| self.ends_ms[n].1 - n.checked_sub(1).map_or(0.0, |before| self.ends_ms[before].1))
    }
}

/// A dispatch of a script, and whether it ran.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ran {
    /// Name of the shader.
    pub(crate) pass: &'static str,
    pub(crate) place: Place,
    /// Compulsory traffic: each input element read once, each output element written once.
    pub(crate) bytes: u64,
    /// Whether it had any workgroups.
    pub(crate) executed: bool,
}

/// The profile of one solve.
pub(crate) struct Profile {
    /// All recorded dispatches in order.
    pub(crate) dispatches: Vec<Ran>,
    /// Their ends on the device, ms since the first began; empty on devices without a clock.
    pub(crate) ends_ms: Vec<f64>,
    pub(crate) phases: Phases,
}

impl Profile {
    /// The dispatches that had any workgroups.
    pub(crate) fn executed(&self) -> impl Iterator<Item = &Ran> {
        self.dispatches.iter().filter(|dispatch| dispatch.executed)
    }
}
