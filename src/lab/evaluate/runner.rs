//! One engine for all experiments, and the most recent solvers.

use super::section::Case;
use crate::base::{Decode, Error, Frame, Homography, Kernel, Method, Settings};
use crate::engine::{Engine, Registered, Solution};
use crate::solve::{PairSolver, SolveOptions};

/// The compared methods, in the paper's order.
pub(super) const METHODS: [Method; 3] = [Method::Appearance, Method::Sift, Method::Unified];

/// Number of solvers that are kept, one for each method.
const MOST_SOLVERS: usize = METHODS.len();

/// Solves pairs with reused solvers, and logs the current work.
pub(super) struct Runner<'a> {
    pub(super) engine: &'a Engine,
    /// Small scenes and few cases.
    pub(super) quick: bool,
    log: &'a mut dyn FnMut(&str),
    /// The kept solvers; the last one was used last.
    solvers: Vec<PairSolver>,
}

impl<'a> Runner<'a> {
    pub(super) fn new(engine: &'a Engine, quick: bool, log: &'a mut dyn FnMut(&str)) -> Self {
        Self { engine, quick, log, solvers: Vec::new() }
    }

    pub(super) fn log(&mut self, line: &str) {
        (self.log)(line);
    }

    /// Measures one case; an error becomes a case without values.
    pub(super) fn case(
        &mut self,
        section: &str,
        name: impl Into<String>,
        measure: impl FnOnce(&mut Self, Case) -> Result<Case, String>,
    ) -> Case {
        let name = name.into();
        self.log(&format!("{section}: {name}"));
        measure(self, Case::new(name.clone())).unwrap_or_else(|e| Case::failed(name, e))
    }

    pub(super) fn solve(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Solution, String> {
        self.solver(settings).and_then(|s| s.solve([i1, i2], &SolveOptions::default())).map_err(|e| e.to_string())
    }

    pub(super) fn register(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Registered, String> {
        self.solver(settings).and_then(|s| s.register([i1, i2], &SolveOptions::default())).map_err(|e| e.to_string())
    }

    fn solver(&mut self, settings: &Settings) -> Result<&mut PairSolver, Error> {
        let solver = match self.solvers.iter().position(|solver| solver.settings() == settings) {
            Some(place) => self.solvers.remove(place),
            None => {
                // Drops the oldest solver before preparing the next, to free its memory.
                if self.solvers.len() == MOST_SOLVERS {
                    self.solvers.remove(0);
                }
                PairSolver::new(self.engine, settings)?
            }
        };
        self.solvers.push(solver);
        let last = self.solvers.len() - 1;
        Ok(&mut self.solvers[last])
    }
}

/// The default settings with a method and a kernel, with samples as stored.
pub(super) fn settings(method: Method, kernel: &Kernel) -> Settings {
    Settings { method, kernel: kernel.clone(), decode: Decode::None, ..Settings::default() }
}

/// Settings that hold T at the identity.
pub(super) fn unregistered(kernel: &Kernel) -> Settings {
    Settings { start: Homography::IDENTITY, ..settings(Method::Aligned, kernel) }
}
