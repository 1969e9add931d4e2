//! One engine for every experiment, and the solvers that were used last.

use crate::base::{Decode, Error, Format, Frame, Homography, Kernel, Method, Settings};
use crate::engine::{Engine, PairSolver, Registered, Solution};

/// The systems that are compared, as the paper orders them.
pub(super) const SYSTEMS: [Method; 3] = [Method::Appearance, Method::Sift, Method::Unified];

/// What a solver was prepared for.
#[derive(PartialEq)]
struct Key {
    size: [u32; 2],
    formats: [Format; 2],
    settings: Settings,
}

/// Solvers that are kept: one for each system.
const KEPT: usize = SYSTEMS.len();

/// Solves pairs, reusing solvers, and tells what it does.
pub(super) struct Bench<'a> {
    engine: &'a Engine,
    pub(super) quick: bool,
    say: &'a mut dyn FnMut(&str),
    solvers: Vec<(Key, PairSolver)>,
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
        self.solver([i1, i2], settings).and_then(|solver| solver.solve(i1, i2)).map_err(|e| e.to_string())
    }

    /// Registers a pair and no more.
    pub(super) fn register(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Registered, String> {
        self.solver([i1, i2], settings).and_then(|solver| solver.register(i1, i2)).map_err(|e| e.to_string())
    }

    fn solver(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<&mut PairSolver, Error> {
        let key =
            Key { size: [i1.width(), i1.height()], formats: [i1.format(), i2.format()], settings: settings.clone() };
        if let Some(place) = self.solvers.iter().position(|(k, _)| *k == key) {
            let found = self.solvers.remove(place);
            self.solvers.push(found);
        } else {
            if self.solvers.len() == KEPT {
                self.solvers.remove(0);
            }
            let solver = PairSolver::for_pair(self.engine, i1, i2, settings)?;
            self.solvers.push((key, solver));
        }
        // The one just found or made stands last.
        let last = self.solvers.len() - 1;
        Ok(&mut self.solvers[last].1)
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
