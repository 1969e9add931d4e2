//! The CPU device: scripts run by the CPU references of their stages, in single precision, on all processors.

pub(super) mod pair;
pub(super) mod sweep;

use super::script::{Action, Dispatch, Entry, Executable};
use super::stages::pass::{Memory, Pass};
use super::stages::{Number, convolve, relax, relax_grid};
use super::vulkan::Variant;
use crate::base::Error;

/// Runs entries of a script. `proceed` is called before each, or after those that run together with the one before, and
/// ends the run by an error.
pub(crate) fn run<'a, N: Executable>(
    entries: impl IntoIterator<Item = &'a Entry>,
    memory: &mut Memory<N>,
    proceed: &mut dyn FnMut(&Entry) -> Result<(), Error>,
) -> Result<(), Error> {
    let entries: Vec<&Entry> = entries.into_iter().collect();
    let mut n = 0;
    while let Some(entry) = entries.get(n) {
        proceed(entry)?;
        let mut count = 1;
        match &entry.action {
            Action::Dispatch(dispatch) if !runs(dispatch, memory) => {}
            Action::Dispatch(dispatch) => match run_several(&entries[n..], memory) {
                0 => N::run(dispatch, memory),
                several => count = several,
            },
            Action::Copy { from, to, levels } => memory.copy(*from, *to, *levels),
            Action::Clear { image, size, layers } => memory.clear(*image, *size, layers.clone()),
            // The results are read from the blur stacks.
            Action::Download { .. } => {}
        }
        entries[n + 1..n + count].iter().try_for_each(|entry| proceed(entry))?;
        n += count;
    }
    Ok(())
}

/// Runs the first dispatches at once, so that rows stay in the cache: a filter along x and one along y, or all
/// relaxation sweeps of a level or of a grid. Returns how many they are; 0 for others.
fn run_several<N: Number>(entries: &[&Entry], memory: &mut Memory<N>) -> usize {
    if let [x, y, ..] = first_of::<convolve::Bindings, N>(entries, memory)[..] {
        return if convolve::run_both([x, y], memory) { 2 } else { 0 };
    }
    match relax::run_all(&first_of(entries, memory), memory) {
        0 => relax_grid::run_all(&first_of(entries, memory), memory),
        count => count,
    }
}

/// The first dispatches, those of one pass.
fn first_of<P: Pass, N: Number>(entries: &[&Entry], memory: &Memory<N>) -> Vec<(P, P::Constants, Variant)> {
    let of_pass = |entry: &&Entry| match &entry.action {
        Action::Dispatch(dispatch) if runs(dispatch, memory) => dispatch.of(),
        _ => None,
    };
    entries.iter().map_while(of_pass).collect()
}

/// Whether a dispatch has any workgroups.
fn runs<N: Number>(dispatch: &Dispatch, memory: &Memory<N>) -> bool {
    dispatch.grid.word().is_none_or(|word| memory.runs(word))
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
