//! Tests of pairs in flight: several at a time, their borrowed results, and cancellation.

use std::sync::Arc;
use std::time::{Duration, Instant};

use parfocal::frame::Source;
use parfocal::sweep::SweepOptions;
use parfocal::transform::Similarity;
use parfocal::{
    CancellationToken, Engine, EngineOptions, Error, Frame, Mask, PairSolver, Pending, Region, Settings, Solution,
    SolutionRef, SolveOptions, SweepSolver,
};

use crate::common::scene::{pair, slanted};
use crate::common::{TestEngine, options, progress_log};

const SIZE: [u32; 2] = [96, 80];

fn pairs() -> Vec<[Frame; 2]> {
    let of = |n: usize| {
        let t = Similarity::new(0.4 * n as f64, -0.3, 0.05, 1.0);
        pair(SIZE, t, |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, 3 + n as u64)
    };
    (0..5).map(of).collect()
}

fn large_pair() -> [Frame; 2] {
    pair([256, 192], Similarity::new(0.4, -0.3, 0.05, 1.0), |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, 3)
}

/// Settings whose levels never settle.
fn long() -> Settings {
    Settings { outer_iterations: 400, ..Settings::default() }
}

fn solver(engine: &Engine, frames_in_flight: usize) -> PairSolver {
    let formats = pairs()[0].each_ref().map(Frame::format);
    PairSolver::for_size(engine, SIZE, formats, frames_in_flight, &Settings::default()).unwrap()
}

fn submit(solver: &mut PairSolver, pair: &[Frame; 2]) -> Pending {
    solver.submit(pair.each_ref(), &[], &SolveOptions::default()).unwrap()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn assert_same(found: &SolutionRef<'_>, expected: &Solution) {
    assert_eq!(found.transform, expected.transform);
    assert_eq!(found.valid_fraction, expected.valid_fraction);
    for (found, expected) in [
        (found.relative_blur(), &expected.relative_blur),
        (found.uncertainty(), &expected.uncertainty),
        (found.residual(), &expected.residual),
    ] {
        assert_eq!(bits(found), bits(expected));
    }
    assert_eq!(bits(&found.to_owned().fused), bits(&expected.fused));
    assert!(found.fused(usize::from(found.fused_channels.count() as u16)).is_none());
}

#[test]
fn solving_without_the_fused_image_does_not_change_other_results() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[0];
    let solve = |fused| engine.solve([i1, i2], &Settings { fused, ..Settings::default() });
    let (whole, mut found) = (solve(true), solve(false));
    assert_eq!(bits(&found.relative_blur), bits(&whole.relative_blur));
    assert_eq!(bits(&found.uncertainty), bits(&whole.uncertainty));
    assert_eq!(bits(&found.residual), bits(&whole.residual));
    assert!(found.fused.is_empty() && !whole.fused.is_empty());
    found.crop(Region { x: 3, y: 4, width: 20, height: 10 }).unwrap();
    assert!(found.fused.is_empty());
}

#[test]
fn pairs_in_flight_have_the_results_of_single_solves() {
    let (engine, pairs) = (TestEngine::new(), pairs());
    let mut one = solver(&engine, 1);
    let expected: Vec<Solution> =
        pairs.iter().map(|pair| one.solve(pair.each_ref(), &SolveOptions::default()).unwrap()).collect();
    let mut solver = solver(&engine, 3);
    let mut before: Option<Pending> = None;
    for (n, pair) in pairs.iter().enumerate() {
        let pending = submit(&mut solver, pair);
        if let Some(mut before) = before.replace(pending) {
            assert_same(&before.wait().unwrap(), &expected[n - 1]);
        }
    }
    let mut last = before.unwrap();
    assert_same(&last.wait().unwrap(), &expected[4]);
    // A pair keeps its results and its frame in flight until it is dropped.
    let others = [0, 1].map(|n| submit(&mut solver, &pairs[n]));
    assert_same(&last.wait_timeout(Duration::ZERO).unwrap().unwrap(), &expected[4]);
    let busy = solver.submit(pairs[2].each_ref(), &[], &SolveOptions::default()).map(drop);
    assert!(matches!(busy, Err(Error::Busy { frames: 3 })), "{busy:?}");
    drop(others);
    // A pair can outlive its solver.
    let mut pending = submit(&mut solver, &pairs[1]);
    drop(solver);
    assert_same(&pending.wait().unwrap(), &expected[1]);
}

#[test]
fn a_pair_can_be_written_into_the_memory_that_the_device_reads() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[2];
    let settings = Settings { white_level: Some(0.75), ..Settings::default() };
    let mut solver = PairSolver::for_frames(&engine, [i1, i2], &settings).unwrap();
    let expected = solver.solve([i1, i2], &SolveOptions::default()).unwrap();
    let [near, far] = [i1, i2].map(|frame| move |bytes: &mut [u8]| bytes.copy_from_slice(frame.bytes()));
    let sources = [Source::Write(&near), Source::Write(&far)];
    let mut pending = solver.submit(sources, &[], &SolveOptions::default()).unwrap();
    assert_eq!(pending.is_fetched(), [false; 2]);
    assert_same(&pending.wait().unwrap(), &expected);
}

#[test]
fn masked_pixels_are_nan_in_borrowed_results() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[1];
    let masked = |i: usize| (30..60).contains(&(i % 96)) && i / 96 > 40;
    let picture = (0..96 * 80).map(|i| if masked(i) { 0.0 } else { 1.0 }).collect();
    let mask = Some(Mask::from_image(&Frame::gray(96, 80, picture).unwrap()));
    let mut solver = solver(&engine, 2);
    let mut unmasked = submit(&mut solver, &pairs()[1]);
    let options = SolveOptions { mask, ..SolveOptions::default() };
    let mut pending = solver.submit([i1, i2], &[], &options).unwrap();
    let solution = pending.wait().unwrap();
    let known = solution.relative_blur().iter().filter(|v| !v.is_nan()).count();
    assert!((0..96 * 80).filter(|&i| masked(i)).all(|i| solution.relative_blur()[i].is_nan()));
    assert!(solution.relative_blur().iter().zip(solution.uncertainty()).all(|(v, s)| v.is_nan() == s.is_nan()));
    assert_eq!(solution.valid_fraction, known as f64 / (96.0 * 80.0));
    assert!(solution.converged, "{:?}", solution.warnings);
    // Each pair has its own mask.
    assert!(unmasked.wait().unwrap().relative_blur()[60 * 96 + 45].is_finite());
    let refused = solver.submit([i1, i2], &[], &SolveOptions { crop_valid: true, ..options }).map(drop);
    assert!(matches!(refused, Err(Error::Mismatch(_))), "{refused:?}");
}

#[test]
fn cancelling_a_pair_does_not_affect_other_pairs() {
    let (engine, pairs) = (TestEngine::new(), pairs());
    let mut solver = solver(&engine, 2);
    let expected = solver.solve(pairs[0].each_ref(), &SolveOptions::default()).unwrap();
    let [mut cancelled, mut other] = [0, 1].map(|_| submit(&mut solver, &pairs[0]));
    cancelled.cancel();
    assert!(matches!(cancelled.wait().map(drop), Err(Error::Cancelled)));
    assert!(cancelled.poll().unwrap(), "the device still works on the cancelled pair");
    assert_same(&other.wait().unwrap(), &expected);
    drop(cancelled);
    assert_same(&submit(&mut solver, &pairs[0]).wait().unwrap(), &expected);
}

#[test]
fn a_token_cancels_a_solve_from_another_thread_and_every_later_solve_with_it() {
    let (engine, [i1, i2]) = (TestEngine::new(), large_pair());
    let mut solver = PairSolver::new(&engine, &long()).unwrap();
    let options = SolveOptions::default();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(30));
            options.cancel.cancel();
        });
        let solved = solver.solve([&i1, &i2], &options);
        assert!(matches!(solved, Err(Error::Cancelled)), "{:?}", solved.map(|s| s.levels.len()));
    });
    assert!(matches!(solver.solve([&i1, &i2], &options), Err(Error::Cancelled)));
    assert!(solver.register([&i1, &i2], &SolveOptions::default()).is_ok());
}

#[test]
fn the_token_of_an_earlier_pair_does_not_cancel_the_next() {
    let (engine, pairs) = (TestEngine::new(), pairs());
    let mut solver = solver(&engine, 1);
    let earlier = SolveOptions::default();
    solver.solve(pairs[0].each_ref(), &earlier).unwrap();
    let mut pending = submit(&mut solver, &pairs[0]);
    earlier.cancel.cancel();
    assert!(pending.wait().unwrap().converged);
    drop(pending);
    // If an error occurs before submission, the frame in flight is released.
    let rows = vec![0xff; 4 * (SIZE[0] * SIZE[1]) as usize];
    let not_finite = Source::Rows { bytes: &rows, pitch: 0 };
    let refused = solver.submit([not_finite; 2], &[], &SolveOptions::default()).map(drop);
    assert!(matches!(refused, Err(Error::Mismatch(_))), "{refused:?}");
    assert!(matches!(solver.submit(pairs[0].each_ref(), &[], &earlier).map(drop), Err(Error::Cancelled)));
    assert!(submit(&mut solver, &pairs[0]).wait().unwrap().converged);
}

/// Returns options whose progress function cancels the solve, and a log of its calls.
fn cancelling() -> (SolveOptions, Arc<std::sync::Mutex<Vec<parfocal::Progress>>>) {
    let (mut options, log) = progress_log();
    let (report, cancel) = (options.progress.take().unwrap(), options.cancel.clone());
    options.progress = Some(Arc::new(move |progress| {
        report(progress);
        cancel.cancel();
    }));
    (options, log)
}

#[test]
fn regions_and_sweeps_are_cancelled_by_their_progress_function() {
    let (engine, [i1, i2]) = (TestEngine::new(), large_pair());
    let mut solver = PairSolver::new(&engine, &Settings::default()).unwrap();
    for region in [None, Some(Region { x: 20, y: 20, width: 100, height: 100 })] {
        let options = SolveOptions { region, ..cancelling().0 };
        assert!(matches!(solver.solve([&i1, &i2], &options), Err(Error::Cancelled)));
        let options = SolveOptions { region, ..SolveOptions::default() };
        assert!(solver.solve([&i1, &i2], &options).unwrap().converged);
    }
    let sweep: Vec<Frame> =
        [0.2, 0.6, 1.0].map(|v| pair([256, 192], Similarity::IDENTITY, |_| [v, v], 0.0, 5)[0].clone()).to_vec();
    let (options, log) = cancelling();
    let mut solver = SweepSolver::new(&engine, &SweepOptions::default()).unwrap();
    assert!(matches!(solver.solve(&sweep, &options), Err(Error::Cancelled)));
    solver.solve(&sweep, &SolveOptions::default()).unwrap();
    assert_eq!(log.lock().unwrap().len(), 1);
}

/// Measures how long a solve of 1 Mpx runs on after it is cancelled:
/// `cargo test --test library how_soon_a_cancelled_solve_ends -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn how_soon_a_cancelled_solve_ends() {
    let engine = Engine::new(&EngineOptions { validation: false, timed: false, ..options() }).unwrap();
    let size = [1024, 1024];
    let pair = pair(size, Similarity::new(0.4, -0.3, 0.05, 1.0), slanted(size[0]), 0.002, 3);
    let mut solver = PairSolver::for_frames(&engine, pair.each_ref(), &Settings::default()).unwrap();
    let mut whole = 0.0;
    for _ in 0..3 {
        let began = Instant::now();
        solver.solve(pair.each_ref(), &SolveOptions::default()).unwrap();
        whole = began.elapsed().as_secs_f64();
    }
    println!("a solve takes {whole:.2} s");
    for share in [0.05, 0.2, 0.4, 0.6, 0.8] {
        let cancel = CancellationToken::default();
        let options = SolveOptions { cancel: cancel.clone(), ..SolveOptions::default() };
        let mut pending = solver.submit(pair.each_ref(), &[], &options).unwrap();
        std::thread::sleep(Duration::from_secs_f64(share * whole));
        let began = Instant::now();
        cancel.cancel();
        assert!(matches!(pending.wait().map(drop), Err(Error::Cancelled)));
        println!("cancelled after {share:.2} of it: ends {:.2} s later", began.elapsed().as_secs_f64());
    }
}
