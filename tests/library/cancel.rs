//! Solves that are called off: they end soon, and what they used is good for the next.

use std::time::Duration;

use parfocal::focus_stack::{SweepOptions, solve_sweep};
use parfocal::{Cancel, Error, Frame, Scope, Settings, Similarity, Solver};

use crate::common::TestEngine;
use crate::common::scene::pair;

const SIZE: [u32; 2] = [256, 192];

fn frames() -> [Frame; 2] {
    pair(SIZE, Similarity::new(0.4, -0.3, 0.05, 1.0), |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, 3)
}

/// Levels that never settle.
fn long() -> Settings {
    Settings { outer_iterations: 400, ..Settings::default() }
}

#[test]
fn a_ticket_that_is_called_off_frees_its_slot() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let mut solver = Solver::with_slots(2, &engine, SIZE, [i1.format(); 2], &Settings::default()).unwrap();
    let expected = solver.solve(&i1, &i2).unwrap();
    let [called_off, goes_on] = [0, 1].map(|slot| solver.submit(slot, &i1, &i2).unwrap());
    solver.cancel(&called_off).unwrap();
    assert!(matches!(solver.wait(&called_off, Duration::MAX), Err(Error::Cancelled)));
    assert!(solver.poll(&called_off).unwrap(), "the device has left it");
    let view = solver.wait(&goes_on, Duration::MAX).unwrap().unwrap();
    assert!(
        view.converged
            && view.relative_blur().iter().zip(&expected.relative_blur).all(|(a, b)| a.to_bits() == b.to_bits())
    );
    // The slot is as good as it was.
    let again = solver.submit(0, &i1, &i2).unwrap();
    assert!(matches!(solver.cancel(&called_off), Err(Error::Mismatch(_))), "another pair has the slot");
    let view = solver.wait(&again, Duration::MAX).unwrap().unwrap();
    assert!(view.relative_blur().iter().zip(&expected.relative_blur).all(|(a, b)| a.to_bits() == b.to_bits()));
}

#[test]
fn a_solve_is_called_off_from_another_thread_and_iterates_no_more() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let mut solver = Solver::for_pair(&engine, &i1, &i2, &long()).unwrap();
    let cancel = Cancel::default();
    solver.set_cancel(cancel.clone());
    let mut levels = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(30));
            cancel.cancel();
        });
        let solved = solver.solve_with(&i1, &i2, &mut |progress| levels.push(progress.done));
        assert!(matches!(solved, Err(Error::Cancelled)), "{:?}", solved.map(|s| s.levels.len()));
    });
    assert!(matches!(solver.solve(&i1, &i2), Err(Error::Cancelled)), "all that begins with it");
    solver.set_cancel(Cancel::default());
    assert!(solver.register(&i1, &i2).is_ok());
}

#[test]
fn parts_of_the_frame_large_pairs_and_sweeps_are_called_off_by_who_is_told_how_far_they_are() {
    let (engine, frames) = (TestEngine::new(), frames());
    let [i1, i2] = &frames;
    for region in [None, Some(parfocal::Region { x: 20, y: 20, width: 100, height: 100 })] {
        let scope = Scope { region, ..Scope::default() };
        let (cancel, mut kept) = (scope.cancel.clone(), None);
        let solved = scope.solve(&engine, &mut kept, [i1, i2], &Settings::default(), &mut |_| cancel.cancel());
        assert!(matches!(solved, Err(Error::Cancelled)));
        let fresh = Scope { cancel: Cancel::default(), ..scope };
        assert!(fresh.solve(&engine, &mut kept, [i1, i2], &Settings::default(), &mut |_| ()).unwrap().converged);
    }
    let sweep: Vec<Frame> =
        [0.2, 0.6, 1.0].map(|v| pair(SIZE, Similarity::IDENTITY, |_| [v, v], 0.0, 5)[0].clone()).to_vec();
    let options = SweepOptions::default();
    let cancel = options.scope.cancel.clone();
    let mut told = 0;
    let solved = solve_sweep(&engine, &sweep, &options, &mut |_, _| {
        told += 1;
        cancel.cancel();
    });
    assert!(matches!(solved, Err(Error::Cancelled)) && told == 1);
}
