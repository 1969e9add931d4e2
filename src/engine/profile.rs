//! What a recording holds, dispatch by dispatch, and what a solve made of it: for [`bench`](crate::bench).

use std::time::Instant;

use crate::engine::stages::state::{LevelState, MAX_LEVELS};

/// One recorded dispatch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Dispatch {
    /// The pass, as its shader is called.
    pub(crate) pass: &'static str,
    pub(crate) place: Place,
    /// Compulsory traffic: every input element read once, every output element written once.
    pub(crate) bytes: u64,
}

/// Where in the method a dispatch stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Place {
    /// 0 the finest.
    pub(crate) level: usize,
    /// Outer iteration of the level, if it belongs to one.
    pub(crate) iteration: Option<u32>,
    /// Whether it comes after the iteration's `step`, which ends a level that has settled.
    after_step: bool,
    /// Whether it belongs to a registration that comes before V is solved for.
    registering: bool,
    /// Whether it brings I2 onto I1's pixels anew, if T has moved.
    if_moved: bool,
}

impl Place {
    /// On a level, before or after its iterations.
    pub(crate) fn level(level: usize) -> Self {
        Self { level, ..Self::default() }
    }

    /// On a level of a registration that comes first.
    pub(crate) fn registering(level: usize) -> Self {
        Self { level, registering: true, ..Self::default() }
    }

    /// In iteration k of the same level.
    pub(crate) fn iteration(self, k: u32) -> Self {
        Self { iteration: Some(k), after_step: false, ..self }
    }

    /// In the same iteration, after its step.
    pub(crate) fn after_step(self) -> Self {
        Self { after_step: true, ..self }
    }

    /// In the same iteration, if T has moved by then.
    pub(crate) fn if_moved(self) -> Self {
        Self { if_moved: true, ..self }
    }

    /// Whether a dispatch here had any workgroups, by what each level did with `outer` iterations at most: in the
    /// solve, and in the registration before it. A level that settles in its very last iteration counts as one that
    /// does not.
    pub(crate) fn executed(self, done: &[[LevelState; MAX_LEVELS]; 2], outer: u32) -> bool {
        let level = done[usize::from(self.registering)][self.level];
        let done = level.iterations;
        if self.if_moved && self.iteration.is_some_and(|k| level.warps >> k.ilog2() & 1 == 0) {
            return false;
        }
        self.iteration.is_none_or(|k| if self.after_step { k < relaxed(done, outer) } else { k < done })
    }
}

/// The iterations of a level in which dV was relaxed: not the one in which it settled.
pub(crate) fn relaxed(done: u32, outer: u32) -> u32 {
    if done < outer { done.saturating_sub(1) } else { done }
}

/// The phase of the host in which the device works.
pub(crate) const SUBMIT_WAIT: &str = "submit-wait";

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
}

/// What one solve did.
pub(crate) struct Profile {
    /// Everything recorded, in order.
    pub(crate) dispatches: Vec<Dispatch>,
    /// Whether each had any workgroups.
    pub(crate) executed: Vec<bool>,
    /// When each ended on the device, ms since the first began; empty where the device has no clock.
    pub(crate) ends_ms: Vec<f64>,
    pub(crate) phases: Phases,
}

impl Profile {
    /// The dispatches that ran over any workgroups.
    pub(crate) fn executed(&self) -> impl Iterator<Item = &Dispatch> {
        self.dispatches.iter().zip(&self.executed).filter(|(_, executed)| **executed).map(|(dispatch, _)| dispatch)
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn a_settled_level_ends_after_its_step() {
        let mut done = [[LevelState::zeroed(); MAX_LEVELS]; 2];
        done[0][1].iterations = 3;
        done[0][1].warps = 0b10;
        done[1][1].iterations = 5;
        let place = Place::level(1);
        assert!(place.executed(&done, 5));
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).executed(&done, 5)).collect();
        assert_eq!(runs, [true, true, true, false, false]);
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).after_step().executed(&done, 5)).collect();
        assert_eq!(runs, [true, true, false, false, false]);
        assert!(Place::registering(1).iteration(4).after_step().executed(&done, 5), "a level that never settled");
        let runs: Vec<bool> = [1, 2, 4].map(|k| place.iteration(k).if_moved().executed(&done, 5)).to_vec();
        assert_eq!(runs, [false, true, false]);
        assert_eq!((relaxed(0, 5), relaxed(3, 5), relaxed(5, 5)), (0, 2, 5));
    }
}
