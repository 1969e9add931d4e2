//! Solves that are called off: they end soon, and what they used is good for the next.

use std::time::{Duration, Instant};

use parfocal::sweep::{SweepOptions, solve_sweep};
use parfocal::{
    CancellationToken, Engine, EngineOptions, Error, Frame, PairSolver, Settings, SolveOptions, frame::Source,
    transform::Similarity,
};

use crate::common::scene::{pair, slanted};
use crate::common::{TestEngine, options};

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
    let mut solver = PairSolver::with_slots(2, &engine, SIZE, [i1.format(); 2], &Settings::default()).unwrap();
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
fn a_solve_is_called_off_from_another_thread() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &long()).unwrap();
    let cancel = CancellationToken::default();
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
    solver.set_cancel(CancellationToken::default());
    assert!(solver.register(&i1, &i2).is_ok());
}

#[test]
fn what_called_an_earlier_pair_off_says_nothing_to_the_next_and_results_half_way_are_never_lent() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default()).unwrap();
    let earlier = CancellationToken::default();
    solver.set_cancel(earlier.clone());
    solver.solve(&i1, &i2).unwrap();
    solver.set_cancel(CancellationToken::default());
    let ticket = solver.submit(0, &i1, &i2).unwrap();
    earlier.cancel();
    assert!(solver.wait(&ticket, Duration::MAX).unwrap().unwrap().converged);
    // Whatever comes after a pair that was called off, its results are not there.
    let rows = vec![0xff; 4 * (SIZE[0] * SIZE[1]) as usize];
    let no_numbers = Source::Rows { bytes: &rows, pitch: 0 };
    for cancels_the_next in [false, true] {
        let cancel = CancellationToken::default();
        solver.set_cancel(cancel.clone());
        let called_off = solver.submit(0, &i1, &i2).unwrap();
        if cancels_the_next {
            cancel.cancel();
            assert!(matches!(solver.submit(0, &i1, &i2), Err(Error::Cancelled)));
        } else {
            solver.cancel(&called_off).unwrap();
            assert!(matches!(solver.submit_sources(0, [no_numbers; 2], &[]), Err(Error::Mismatch(_))));
        }
        assert!(matches!(solver.wait(&called_off, Duration::MAX), Err(Error::Mismatch(_))));
    }
}

#[test]
fn parts_of_the_frame_large_pairs_and_sweeps_are_called_off_by_who_is_told_how_far_they_are() {
    let (engine, frames) = (TestEngine::new(), frames());
    let [i1, i2] = &frames;
    for region in [None, Some(parfocal::Region { x: 20, y: 20, width: 100, height: 100 })] {
        let scope = SolveOptions { region, ..SolveOptions::default() };
        let (cancel, mut kept) = (scope.cancel.clone(), None);
        let solved = scope.solve(&engine, &mut kept, [i1, i2], &Settings::default(), &mut |_| cancel.cancel());
        assert!(matches!(solved, Err(Error::Cancelled)));
        let fresh = SolveOptions { cancel: CancellationToken::default(), ..scope };
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

/// How soon a solve of 1 Mpx ends that is called off: for figures, `cargo test --test library how_soon_a_solve_ends -- --ignored --nocapture`
#[test]
#[ignore = "it measures"]
fn how_soon_a_solve_ends() {
    let engine = Engine::new(&EngineOptions { validation: false, timed: false, ..options() }).unwrap();
    let size = [1024, 1024];
    let [i1, i2] = pair(size, Similarity::new(0.4, -0.3, 0.05, 1.0), slanted(size[0]), 0.002, 3);
    let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default()).unwrap();
    let mut whole = 0.0;
    for _ in 0..3 {
        let began = Instant::now();
        solver.solve(&i1, &i2).unwrap();
        whole = began.elapsed().as_secs_f64();
    }
    println!("a solve takes {whole:.2} s");
    for share in [0.05, 0.2, 0.4, 0.6, 0.8] {
        let ticket = solver.submit(0, &i1, &i2).unwrap();
        std::thread::sleep(Duration::from_secs_f64(share * whole));
        let began = Instant::now();
        solver.cancel(&ticket).unwrap();
        assert!(matches!(solver.wait(&ticket, Duration::MAX), Err(Error::Cancelled)));
        println!("called off after {share:.2} of it: ends {:.2} s later", began.elapsed().as_secs_f64());
    }
}
