//! Tests of streams: results come in order and equal those of single solves bit for bit.

use std::iter;
use std::sync::LazyLock;
use std::thread;
use std::time::{Duration, Instant};

use parfocal::sweep::SweepOptions;
use parfocal::{
    Engine, EngineOptions, Error, Frame, PairSolver, QueueFull, Settings, Solution, SolveOptions, Stream, SweepSolver,
    frame::Format, transform::Similarity,
};

use crate::common::scene::{pair, slanted};
use crate::common::{TestEngine, options};

const SIZE: [u32; 2] = [72, 64];

/// Four pairs and their solutions.
static SOLVED: LazyLock<Vec<([Frame; 2], Solution)>> = LazyLock::new(|| {
    let engine = TestEngine::new();
    let of = |n: u64| pair(SIZE, Similarity::new(0.3 * n as f64, -0.3, 0.05, 1.0), slanted(SIZE[0]), 0.0, 3 + n);
    let pairs = (0..4).map(of);
    let mut solver = PairSolver::for_size(&engine, SIZE, formats(), 1, &settings()).unwrap();
    pairs.map(|pair| (pair.clone(), solver.solve(pair.each_ref(), &SolveOptions::default()).unwrap())).collect()
});

fn settings() -> Settings {
    Settings { outer_iterations: 8, ..Settings::default() }
}

fn formats() -> [Format; 2] {
    [Frame::gray(1, 1, vec![0.0]).unwrap().format(); 2]
}

fn stream(engines: &[&Engine], frames_in_flight: usize) -> Stream {
    Stream::new(engines, frames_in_flight, SIZE, formats(), &settings()).unwrap()
}

/// Returns the n-th pair and its expected solution.
fn solved(n: usize) -> &'static ([Frame; 2], Solution) {
    &SOLVED[n % SOLVED.len()]
}

fn pairs(count: usize) -> impl Iterator<Item = [Frame; 2]> {
    (0..count).map(|n| solved(n).0.clone())
}

fn assert_is(found: &Solution, n: usize) {
    let (expected, bits) = (&solved(n).1, |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
    assert_eq!(found.transform, expected.transform, "pair {n}");
    assert_eq!(bits(&found.relative_blur), bits(&expected.relative_blur), "pair {n}");
    assert_eq!(bits(&found.uncertainty), bits(&expected.uncertainty), "pair {n}");
    assert_eq!(bits(&found.residual), bits(&expected.residual), "pair {n}");
    assert_eq!(bits(&found.fused), bits(&expected.fused), "pair {n}");
}

/// Returns a pair of another size.
fn other() -> [Frame; 2] {
    pair([64, 48], Similarity::new(0.0, 0.0, 0.0, 1.0), slanted(64), 0.0, 1)
}

#[test]
fn results_come_in_order_and_equal_single_solves() {
    let engines = [TestEngine::new(), TestEngine::alone()];
    for (engines, slots) in [(&engines[..1], 1), (&engines[..1], 3), (&engines[..], 2)] {
        let engines: Vec<&Engine> = engines.iter().map(|engine| &**engine).collect();
        let mut stream = stream(&engines, slots);
        let found: Vec<Solution> = stream.map(pairs(11)).map(Result::unwrap).collect();
        found.iter().enumerate().for_each(|(n, found)| assert_is(found, n));
        assert_eq!((found.len(), stream.len(), stream.map([]).count()), (11, 0, 0));
    }
}

#[test]
fn one_thread_pushes_and_another_reads() {
    let engine = TestEngine::new();
    let stream = stream(&[&engine], 2);
    thread::scope(|scope| {
        scope.spawn(|| {
            pairs(9).for_each(|pair| stream.push(pair, Duration::MAX).unwrap());
            stream.finish();
        });
        let count = stream.results().enumerate().map(|(n, found)| assert_is(&found.unwrap(), n)).count();
        assert_eq!(count, 9);
    });
    // A further push reopens the stream after `finish`.
    stream.push(solved(2).0.clone(), Duration::ZERO).unwrap();
    assert_is(&stream.next(Duration::MAX).unwrap().unwrap(), 2);
}

#[test]
fn a_full_stream_returns_the_pair() {
    let engine = TestEngine::new();
    let stream = stream(&[&engine], 1);
    assert_eq!((stream.capacity(), stream.is_empty()), (2, true));
    assert!(stream.next(Duration::ZERO).unwrap().is_none(), "a result before the first push");
    pairs(2).for_each(|pair| stream.push(pair, Duration::ZERO).unwrap());
    let before = Instant::now();
    let QueueFull(back) = stream.push(solved(2).0.clone(), Duration::from_millis(30)).unwrap_err();
    assert!(back == solved(2).0 && before.elapsed() >= Duration::from_millis(30));
    assert_is(&stream.next(Duration::MAX).unwrap().unwrap(), 0);
    stream.push(back, Duration::ZERO).unwrap();
    for n in [1, 2] {
        assert_is(&stream.next(Duration::MAX).unwrap().unwrap(), n);
    }
}

#[test]
fn the_error_of_a_pair_comes_in_its_place() {
    let engine = TestEngine::new();
    let mut stream = stream(&[&engine], 2);
    let some = pairs(2).chain([other()]).chain(pairs(2)).chain([other(), other()]);
    let found: Vec<_> = stream.map(some).collect();
    assert_eq!(found.len(), 7);
    for (n, found) in found.iter().enumerate() {
        match n {
            2 | 5 | 6 => assert!(matches!(found, Err(Error::Mismatch(_))), "pair {n}"),
            _ => assert_is(found.as_ref().unwrap(), if n < 2 { n } else { n - 3 }),
        }
    }
}

#[test]
fn dropping_a_stream_leaves_the_engine_usable() {
    let engine = TestEngine::alone();
    let before = Instant::now();
    for pushed in [0, 1, 6] {
        let mut stream = stream(&[&engine], 3);
        pairs(pushed).for_each(|pair| stream.push(pair, Duration::ZERO).unwrap());
        // Dropping the iterator of `map` keeps the pending pairs and their order.
        let first = stream.map(pairs(9).skip(pushed)).next().unwrap().unwrap();
        assert_is(&first, 0);
        assert_is(&stream.next(Duration::MAX).unwrap().unwrap(), 1);
    }
    assert!(before.elapsed() < Duration::from_secs(300));
    assert_is(&engine.solve(solved(1).0.each_ref(), &settings()), 1);
}

#[test]
fn a_stream_that_cannot_be_prepared_is_an_error() {
    let engine = TestEngine::new();
    let wrong = |size, settings: &Settings| Stream::new(&[&engine], 3, size, formats(), settings).map(drop);
    assert!(matches!(wrong([4, 4], &settings()), Err(Error::TooSmall { .. })));
    assert!(matches!(wrong([60_000; 2], &settings()), Err(Error::TooLarge { .. })));
    assert!(matches!(wrong(SIZE, &Settings { levels: Some(99), ..settings() }), Err(Error::Setting { .. })));
    assert!(matches!(Stream::new(&[], 3, SIZE, formats(), &settings()).map(drop), Err(Error::NoDevice(_))));
}

/// Returns a pair and settings whose solve takes long.
fn long() -> ([Frame; 2], Settings) {
    let settings = Settings { levels: Some(1), outer_iterations: 1000, continuation: 1.0, ..Settings::default() };
    (pair([256, 256], Similarity::new(3.0, 2.0, 0.5, 1.01), slanted(256), 0.2, 5), settings)
}

#[test]
fn other_devices_solve_the_pairs_of_a_failed_one() {
    let (pair, settings) = long();
    let intact = TestEngine::new();
    let before = Instant::now();
    let expected = intact.solve(pair.each_ref(), &settings);
    println!("{:?}", before.elapsed());
    // The timeout is long enough to prepare and too short to solve.
    let hurried = || Engine::new(&EngineOptions { timeout: Duration::from_millis(150), ..options() }).unwrap();
    let solve = |engines: &[&Engine], count: usize| {
        let mut stream = Stream::new(engines, 2, [256, 256], formats(), &settings).unwrap();
        stream.map(iter::repeat_n(pair.clone(), count)).collect::<Vec<_>>()
    };
    for found in solve(&[&hurried(), &intact], 3) {
        let found = found.unwrap();
        assert!(found.relative_blur.iter().zip(&expected.relative_blur).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
    // If no other device is left, the stream returns the error. The engine is poisoned afterwards.
    let hurried = hurried();
    let found = solve(&[&hurried], 6);
    assert!(matches!(found[0], Err(Error::Timeout { .. })), "{:?}", found[0].as_ref().map(drop));
    assert!(found.len() == 6 && found[1..].iter().all(|found| matches!(found, Err(Error::Poisoned))));
    assert!(hurried.validation_messages().is_empty(), "{:?}", hurried.validation_messages());
}

#[test]
fn a_stream_is_send_and_sync() {
    fn check<T: Send + Sync>() {}
    check::<Stream>();
}

/// Measures the time that a stream saves. It saves little on lavapipe, where device and host share the processor:
/// `cargo test --test library how_much_a_stream_saves -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn how_much_a_stream_saves() {
    let (size, settings) = ([512, 384], Settings::default());
    let engine = Engine::new(&EngineOptions { validation: false, timed: false, ..options() }).unwrap();
    let pair = pair(size, Similarity::new(1.0, -0.5, 0.1, 1.001), slanted(size[0]), 0.002, 7);
    let mut solver = PairSolver::for_size(&engine, size, formats(), 1, &settings).unwrap();
    let mut stream = Stream::new(&[&engine], 3, size, formats(), &settings).unwrap();
    let pairs = || iter::repeat_n(pair.clone(), 20);
    let mut one_by_one =
        || pairs().for_each(|[i1, i2]| drop(solver.solve([&i1, &i2], &SolveOptions::default()).unwrap()));
    let mut streamed = || stream.map(pairs()).for_each(|solution| drop(solution.unwrap()));
    let seconds = |run: &mut dyn FnMut()| {
        let before = Instant::now();
        run();
        before.elapsed().as_secs_f64()
    };
    seconds(&mut streamed);
    // Both orders alternate, so that other load on the machine affects both.
    let mut ratios: Vec<f64> = Vec::new();
    for round in 0..7 {
        let (blocking, overlapping) = match round % 2 {
            0 => (seconds(&mut one_by_one), seconds(&mut streamed)),
            _ => {
                let overlapping = seconds(&mut streamed);
                (seconds(&mut one_by_one), overlapping)
            }
        };
        println!("20 pairs: one by one {blocking:.3} s, stream {overlapping:.3} s");
        ratios.push(overlapping / blocking);
    }
    ratios.sort_by(f64::total_cmp);
    println!(
        "stream / one by one on {}: {:.3} in the median, {:.3} to {:.3}",
        engine.info().name,
        ratios[3],
        ratios[0],
        ratios[6]
    );
}

#[test]
fn sweeps_come_in_order_and_errors_in_their_place() {
    let engine = TestEngine::new();
    let frame = |v: f64, seed: u64| pair(SIZE, Similarity::IDENTITY, move |_| [v, v], 0.0, seed)[0].clone();
    let sweep = |seed: u64| [1.3, 0.3, 1.3, 4.3].map(|v| frame(v, seed)).to_vec();
    let mut sweeps = [5, 6, 7].map(sweep).to_vec();
    let mut solver = SweepSolver::new(&engine, &SweepOptions::default()).unwrap();
    let solved = sweeps.iter().map(|frames| solver.solve(frames, &SolveOptions::default()));
    let expected: Vec<_> = solved.map(|sweep| sweep.unwrap().focus).collect();
    sweeps.insert(1, vec![frame(1.0, 8); 2]);
    let mut stream = Stream::of_sweeps(&[&engine], 2, &SweepOptions::default()).unwrap();
    assert_eq!(stream.capacity(), 4);
    let mut found: Vec<_> = stream.map(sweeps).collect();
    assert!(matches!(found.remove(1), Err(Error::Mismatch(_))), "a sweep of two frames was accepted");
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    for (found, expected) in found.into_iter().zip(expected) {
        assert_eq!(bits(&found.unwrap().focus), bits(&expected));
    }
}
