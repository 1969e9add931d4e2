//! What a solve did, dispatch by dispatch: for [`bench`](crate::internals::bench).

use std::time::Instant;

use super::arguments::Place;

/// The phase of the host in which the device works.
pub(crate) const SUBMIT_WAIT: &str = "submit-wait";

/// When a solve reads the device's clock. A reading takes as long as a small dispatch on software devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reading {
    Never,
    /// Where a pass follows one of another name.
    Passes,
    /// After every dispatch.
    Dispatches,
}

/// What the host did, one after the other.
#[derive(Clone, Debug)]
pub(crate) struct Phases {
    started: Instant,
    /// Each phase and when it ended, ms since the start.
    pub(crate) ends_ms: Vec<(&'static str, f64)>,
}

impl Default for Phases {
    /// Starts now.
    fn default() -> Self {
        Self { started: Instant::now(), ends_ms: Vec::new() }
    }
}

impl Phases {
    /// The phase of this name ends here.
    pub(crate) fn end(&mut self, name: &'static str) {
        self.ends_ms.push((name, self.started.elapsed().as_secs_f64() * 1e3));
    }

    /// How long the host waited for the device, ms; 0 where it did not.
    pub(crate) fn waited_ms(&self) -> f64 {
        let ended = self.ends_ms.iter().position(|(name, _)| *name == SUBMIT_WAIT);
        ended.map_or(0.0, |n| self.ends_ms[n].1 - n.checked_sub(1).map_or(0.0, |before| self.ends_ms[before].1))
    }
}

/// One dispatch of a script, and what became of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ran {
    /// The pass, as its shader is called.
    pub(crate) pass: &'static str,
    pub(crate) place: Place,
    /// Compulsory traffic: every input element read once, every output element written once.
    pub(crate) bytes: u64,
    /// Whether it had any workgroups.
    pub(crate) executed: bool,
}

/// What one solve did.
pub(crate) struct Profile {
    /// Everything recorded, in order.
    pub(crate) dispatches: Vec<Ran>,
    /// When each ended on the device, ms since the first began; empty where the device has no clock.
    pub(crate) ends_ms: Vec<f64>,
    pub(crate) phases: Phases,
}

impl Profile {
    /// The dispatches that ran over any workgroups.
    pub(crate) fn executed(&self) -> impl Iterator<Item = &Ran> {
        self.dispatches.iter().filter(|dispatch| dispatch.executed)
    }
}
