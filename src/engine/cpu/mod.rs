//! The CPU device: scripts run by the CPU references of their stages, in single precision, on all processors.

pub(super) mod pair;
pub(super) mod sweep;

use super::script::{Action, Dispatch, Entry, Executable};
use super::stages::Number;
use super::stages::pass::Memory;
use crate::base::Error;

/// Runs entries of a script. `proceed` is called before each, and ends the run by an error.
pub(crate) fn run<'a, N: Executable>(
    entries: impl IntoIterator<Item = &'a Entry>,
    memory: &mut Memory<N>,
    proceed: &mut dyn FnMut(&Entry) -> Result<(), Error>,
) -> Result<(), Error> {
    for entry in entries {
        proceed(entry)?;
        match &entry.action {
            Action::Dispatch(dispatch) if runs(dispatch, memory) => {
                #[cfg(test)]
                observer::show(dispatch, memory);
                N::run(dispatch, memory);
            }
            Action::Dispatch(_) => {}
            Action::Copy { from, to, levels } => memory.copy(*from, *to, *levels),
            Action::Clear { image, size, layers } => memory.clear(*image, *size, layers.clone()),
            // The results are read from the blur stacks.
            Action::Download { .. } => {}
        }
    }
    Ok(())
}

/// Whether a dispatch has any workgroups.
fn runs<N: Number>(dispatch: &Dispatch, memory: &Memory<N>) -> bool {
    dispatch.grid.word().is_none_or(|word| memory.runs(word))
}

/// What a test does with each dispatch that its thread runs.
#[cfg(test)]
pub(super) mod observer {
    use std::cell::RefCell;

    use super::*;
    use crate::engine::slot::Slot;

    /// Gets a dispatch before it runs, and a function that copies what it can read.
    type Observer = Box<dyn FnMut(&Dispatch, &dyn Fn() -> Memory<f64>)>;

    thread_local! {
        static OBSERVER: RefCell<Option<Observer>> = const { RefCell::new(None) };
    }

    /// Runs a function whose dispatches are observed.
    pub(in crate::engine) fn observing<T>(observer: Observer, run: impl FnOnce() -> T) -> T {
        OBSERVER.set(Some(observer));
        let result = run();
        OBSERVER.set(None);
        result
    }

    pub(super) fn show<N: Number>(dispatch: &Dispatch, memory: &Memory<N>) {
        OBSERVER.with_borrow_mut(|observer| {
            if let Some(observer) = observer {
                observer(dispatch, &|| memory.part(&[&dispatch.slots[..], &[Slot::State, Slot::Arguments]].concat()));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use crate::base::Settings;
    use crate::base::workers::no_threads;
    use crate::engine::{Engine, EngineOptions, testing};
    use crate::lab::scene::{Preset, Scene, SweepScene};
    use crate::solve::sweep::{SweepOptions, SweepSolver};
    use crate::solve::{PairSolver, SolveOptions};

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let [i1, i2] = testing::pair([150, 131]);
        let scene = Scene { width: 150, height: 131, noise: 0.003, ..Preset::Card.scene() };
        let frames = SweepScene::new(scene, 5).render().unwrap().frames;
        let solve = || {
            let options = EngineOptions { device: Some("CPU".into()), ..EngineOptions::default() };
            let engine = Engine::new(&options).unwrap();
            let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
            let solution = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
            let mut solver = SweepSolver::for_frames(&engine, &frames, &SweepOptions::default()).unwrap();
            let sweep = solver.solve(&frames, &SolveOptions::default()).unwrap();
            let numbers = [&solution.relative_blur, &sweep.focus, &sweep.fused].map(|n| n.iter().map(|v| v.to_bits()));
            numbers.into_iter().flatten().collect::<Vec<_>>()
        };
        assert!(solve() == no_threads::run(solve));
    }
}
