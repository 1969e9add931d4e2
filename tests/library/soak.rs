//! Soak test: memory, threads and open files do not grow over many pairs. Some of the pairs fail.

use std::process::Command;
use std::time::Duration;

use crate::common::scene::{pair, slanted};
use crate::common::{options, trust};
use parfocal::image_io::Photograph;
use parfocal::{
    Engine, EngineOptions, Error, Frame, PairSolver, Settings, Solution, SolveOptions, Stream, transform::Similarity,
};

const CHILD: &str = "PARFOCAL_SOAK_CHILD";
/// Every n-th pair fails on purpose.
const BROKEN: usize = 20;
/// Growth that is ignored, KiB. The memory that an allocator retains varies by some MiB.
const SLACK: u64 = 16 << 10;

/// Resources of the process: resident memory in KiB, threads, open files.
#[derive(Clone, Copy, Debug)]
struct Held {
    memory: u64,
    threads: usize,
    files: usize,
}

impl Held {
    fn now() -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        let count = |folder| std::fs::read_dir(folder).unwrap().count();
        let memory = line.trim().trim_end_matches(" kB").parse().unwrap();
        // `/proc` lists a joined thread until the kernel has removed it. The minimum over half a second excludes it.
        let sample = |_| {
            std::thread::sleep(Duration::from_millis(10));
            count("/proc/self/task")
        };
        let threads = (0..50).map(sample).min().unwrap();
        Self { memory, threads, files: count("/proc/self/fd") }
    }
}

/// Options without validation, which allocates memory and triples the time per pair.
fn open() -> EngineOptions {
    EngineOptions { validation: false, ..options() }
}

fn frames(n: usize) -> [Frame; 2] {
    let size = [[48, 48], [64, 40], [97, 75], [33, 70]][n % 4];
    pair(size, Similarity::new(0.5, -0.3, 0.1, 1.002), slanted(size[0]), 0.0, n as u64 % 7)
}

fn solve(engine: &Engine, [i1, i2]: &[Frame; 2]) -> Result<Solution, Error> {
    let settings = Settings { outer_iterations: 6, ..Settings::default() };
    PairSolver::new(engine, &settings)?.solve([i1, i2], &SolveOptions::default())
}

fn bits(solution: &Solution) -> Vec<u32> {
    solution.relative_blur.iter().chain(&solution.uncertainty).map(|value| value.to_bits()).collect()
}

/// Causes one of five failures and checks its error.
fn broken(engine: &Engine, n: usize) {
    let [i1, i2] = frames(n);
    match n / BROKEN % 5 {
        0 => {
            let other = frames(n + 1);
            assert!(matches!(solve(engine, &[i1, other[1].clone()]), Err(Error::Mismatch(_))));
        }
        1 => {
            // An image without texture gives a warning.
            let uniform = Frame::gray(i1.width(), i1.height(), vec![0.5; (i1.width() * i1.height()) as usize]).unwrap();
            assert!(solve(engine, &[uniform.clone(), uniform]).is_ok_and(|solution| !solution.warnings.is_empty()));
            let not_finite = vec![f32::NAN; (i1.width() * i1.height()) as usize];
            assert!(Frame::gray(i1.width(), i1.height(), not_finite).is_err());
        }
        2 => {
            let folder = tempfile::tempdir().unwrap();
            let bomb = folder.path().join("bomb.pgm");
            std::fs::write(&bomb, "P5 16384 16384 65535\n").unwrap();
            assert!(Photograph::open(&bomb).is_ok_and(|bomb| bomb.decode().is_err()));
        }
        3 => {
            let large = PairSolver::for_size(engine, [60_000; 2], [i1.format(); 2], 1, &Settings::default());
            assert!(matches!(large.map(drop), Err(Error::TooLarge { .. })));
        }
        _ => {
            let hurried = EngineOptions { timeout: Duration::ZERO, ..open() };
            let timed_out = Engine::new(&hurried).and_then(|engine| solve(&engine, &[i1, i2]));
            assert!(matches!(timed_out.map(drop), Err(Error::Timeout { .. })));
        }
    }
}

fn soak(pairs: usize) {
    let engine = Engine::new(&open()).unwrap();
    let first = bits(&solve(&engine, &frames(0)).unwrap());
    // Caches are full after every size and every failure has occurred.
    let warm = (pairs / 5).clamp(5 * BROKEN, 1000);
    let mut before = None;
    for n in 0..pairs {
        if n == warm {
            before = Some(Held::now());
        }
        if n % BROKEN == BROKEN - 1 {
            broken(&engine, n);
        } else {
            solve(&engine, &frames(n)).unwrap();
        }
    }
    let (before, after) = (before.unwrap(), Held::now());
    assert_eq!(bits(&solve(&engine, &frames(0)).unwrap()), first, "the results changed");
    let describe = |Held { memory, threads, files }| format!("{memory} KiB, {threads} threads, {files} files");
    trust::note(
        "pairs soaked",
        format!("{pairs}: {} after {warm} pairs, {} at the end", describe(before), describe(after)),
    );
    assert!(after.memory <= before.memory + SLACK, "{before:?}, {after:?}");
    assert!(after.threads <= before.threads && after.files <= before.files, "{before:?}, {after:?}");
}

/// Runs a test in its own process, so that its resources can be counted. Returns whether this is that process.
fn is_alone(test: &str) -> bool {
    if std::env::var_os(CHILD).is_some() {
        return true;
    }
    let mut child = Command::new(std::env::current_exe().unwrap());
    // One arena per thread would make the memory grow.
    let child = child.args([test, "--exact", "--nocapture"]).env(CHILD, "1").env("MALLOC_ARENA_MAX", "1");
    assert!(child.status().unwrap().success());
    false
}

#[test]
fn many_pairs_by_one_engine_leave_nothing_behind() {
    if is_alone("soak::many_pairs_by_one_engine_leave_nothing_behind") {
        let pairs = if trust::is_long() { 10_000 } else { 140 };
        soak(std::env::var("PARFOCAL_SOAK").map_or(pairs, |pairs| pairs.parse().unwrap()));
    }
}

/// `PARFOCAL_PAIRS_OF_MEMORY` sets the number of pairs (default 48).
#[test]
fn a_stream_takes_no_more_memory_for_more_pairs() {
    if !is_alone("soak::a_stream_takes_no_more_memory_for_more_pairs") {
        return;
    }
    let pairs: usize = std::env::var("PARFOCAL_PAIRS_OF_MEMORY").map_or(48, |pairs| pairs.parse().unwrap());
    let engine = Engine::new(&open()).unwrap();
    let settings = Settings { outer_iterations: 6, ..Settings::default() };
    let some: Vec<[Frame; 2]> =
        (0..4).map(|seed| pair([64, 48], Similarity::IDENTITY, slanted(64), 0.0, seed)).collect();
    let mut stream = Stream::new(&[&engine], 3, [64, 48], [some[0][0].format(); 2], &settings).unwrap();
    let mut before = None;
    for (n, solution) in stream.map(some.iter().cycle().take(pairs).cloned()).enumerate() {
        solution.unwrap();
        // All frames in flight and all places of the queue have been used.
        if n == 23 {
            before = Some(Held::now());
        }
    }
    let (before, after) = (before.unwrap(), Held::now());
    println!("{pairs} pairs through a stream: {} KiB after 24, {} KiB at the end", before.memory, after.memory);
    assert!(after.memory <= before.memory + SLACK, "{before:?}, {after:?}");
    assert!(after.threads <= before.threads && after.files <= before.files, "{before:?}, {after:?}");
}
