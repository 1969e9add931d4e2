//! One engine for every experiment, and the solvers that were used last.

use crate::base::{Decode, Error, Frame, Homography, Kernel, Method, Settings};
use crate::engine::{Engine, Registered, Solution};
use crate::solve::{PairSolver, SolveOptions};

/// The systems that are compared, as the paper orders them.
pub(super) const SYSTEMS: [Method; 3] = [Method::Appearance, Method::Sift, Method::Unified];

/// Solvers that are kept: one for each system.
const KEPT: usize = SYSTEMS.len();

/// Solves pairs, reusing solvers, and tells what it does.
pub(super) struct Bench<'a> {
    engine: &'a Engine,
    pub(super) quick: bool,
    say: &'a mut dyn FnMut(&str),
    solvers: Vec<PairSolver>,
}

impl<'a> Bench<'a> {
    pub(super) fn new(engine: &'a Engine, quick: bool, say: &'a mut dyn FnMut(&str)) -> Self {
        Self { engine, quick, say, solvers: Vec::new() }
    }

    /// The device, for what is more than a pair.
    pub(super) fn engine(&self) -> &'a Engine {
        self.engine
    }

    /// Tells what is being done.
    pub(super) fn say(&mut self, line: &str) {
        (self.say)(line);
    }

    /// Solves a pair; a failure is a sentence.
    pub(super) fn solve(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Solution, String> {
        self.solver(settings)
            .and_then(|solver| solver.solve([i1, i2], &SolveOptions::default()))
            .map_err(|e| e.to_string())
    }

    /// Registers a pair and no more.
    pub(super) fn register(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Registered, String> {
        self.solver(settings)
            .and_then(|solver| solver.register([i1, i2], &SolveOptions::default()))
            .map_err(|e| e.to_string())
    }

    fn solver(&mut self, settings: &Settings) -> Result<&mut PairSolver, Error> {
        let solver = match self.solvers.iter().position(|solver| solver.settings() == settings) {
            Some(place) => self.solvers.remove(place),
            None => PairSolver::new(self.engine, settings)?,
        };
        if self.solvers.len() == KEPT {
            self.solvers.remove(0);
        }
        self.solvers.push(solver);
        let last = self.solvers.len() - 1;
        Ok(&mut self.solvers[last])
    }
}

/// The defaults with a method and a kernel.
pub(super) fn settings(method: Method, kernel: &Kernel) -> Settings {
    Settings { method, kernel: kernel.clone(), decode: Decode::None, ..Settings::default() }
}

/// No registration: T stays at identity.
pub(super) fn unregistered(kernel: &Kernel) -> Settings {
    Settings { start: Homography::IDENTITY, ..settings(Method::Aligned, kernel) }
}
