//! Tests of the CPU device: its results are those of a Vulkan device, for all methods and inputs.

use std::sync::Arc;
use std::time::Duration;

use parfocal::frame::{Samples, Source};
use parfocal::internals::{device_check, reference};
use parfocal::settings::Kernel;
use parfocal::transform::Similarity;
use parfocal::{
    CancellationToken, Engine, EngineOptions, Error, Frame, PairSolver, PixelFormat, Settings, SolveOptions,
};

use crate::common::scene::{pair, slanted};
use crate::common::{TestEngine, cpu_options};

fn cpu() -> Engine {
    Engine::new(&cpu_options()).unwrap()
}

/// The root mean square difference of numbers that are finite in both, and the share that is finite in one only.
fn apart(a: &[f32], b: &[f32]) -> (f64, f64) {
    let both: Vec<f64> = a
        .iter()
        .zip(b)
        .filter(|(a, b)| a.is_finite() && b.is_finite())
        .map(|(a, b)| f64::from(a - b).powi(2))
        .collect();
    let unequal = a.iter().zip(b).filter(|(a, b)| a.is_finite() != b.is_finite()).count();
    ((both.iter().sum::<f64>() / both.len().max(1) as f64).sqrt(), unequal as f64 / a.len() as f64)
}

fn small_pair() -> [Frame; 2] {
    pair([151, 131], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(151), 0.003, 5)
}

/// All methods, motion models and kernels, clipped pixels, masks, colours, and a sweep.
#[test]
fn pairs_and_sweeps_have_the_results_of_a_vulkan_device() {
    let is_right = device_check::check(&TestEngine::new(), &cpu(), &mut |check| {
        println!("{check:?}");
        assert!(check.is_right(), "{check:?}");
    });
    assert!(is_right.unwrap());
}

/// Levels do not settle with a kernel that does not fit, so that rounding grows from iteration to iteration. A single
/// level has no coarser one to start from. A Vulkan device stores weights of the linear system in half precision: it is
/// 0.0027 and 0.0013 px² off, the CPU device at most 3e-6 px².
#[test]
fn results_are_those_of_double_precision() {
    let half_gaussian = Settings { kernel: Kernel::HalfGaussian, ..Settings::default() };
    let single_level = pair([71, 53], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(71), 0.003, 5);
    let (processor, vulkan) = (cpu(), TestEngine::new());
    for ([i1, i2], settings) in [(small_pair(), half_gaussian), (single_level, Settings::default())] {
        let expected = reference::solve(&i1, &i2, &settings).unwrap();
        let expected: Vec<f32> = expected.relative_blur.data.iter().map(|&v| v as f32).collect();
        for (engine, most) in [(&processor, 0.002), (&*vulkan, 0.004)] {
            let found =
                PairSolver::new(engine, &settings).unwrap().solve([&i1, &i2], &SolveOptions::default()).unwrap();
            let (v, unequal) = apart(&found.relative_blur, &expected);
            println!("{}: V {v:.6} px², {unequal:.5} in one only", engine.info().name);
            assert!(v < most && unequal < 1e-3);
        }
    }
}

#[test]
fn photographs_come_from_frames_rows_and_functions() {
    let [i1, i2] = small_pair();
    let engine = cpu();
    let mut solver =
        PairSolver::for_size(&engine, [151, 131], [i1.format(), i2.format()], 2, &Settings::default()).unwrap();
    let write = |to: &mut [u8]| to.copy_from_slice(i1.bytes());
    let sources = [Source::Write(&write), Source::Rows { bytes: i2.bytes(), pitch: 0 }];
    let mut pending = solver.submit(sources, &[], &SolveOptions::default()).unwrap();
    assert!(pending.poll().unwrap(), "the CPU device solves while it is asked");
    let found = pending.wait().unwrap().to_owned();
    assert!(matches!(pending.on_device(), Err(Error::Mismatch(_))));
    let mut other = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let expected = other.solve([&i1, &i2], &SolveOptions::default()).unwrap();
    let (v, _) = apart(&found.relative_blur, &expected.relative_blur);
    assert!(v < 1e-3, "{v}");
}

#[test]
fn a_solve_ends_at_its_limit_or_if_it_is_cancelled() {
    let [i1, i2] = small_pair();
    let options = EngineOptions { device: Some("cpu".into()), timeout: Duration::from_millis(1), ..Default::default() };
    let engine = Engine::new(&options).unwrap();
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let solved = solver.solve([&i1, &i2], &SolveOptions::default());
    assert!(matches!(solved, Err(Error::Timeout { .. })));

    let mut solver = PairSolver::for_frames(&cpu(), [&i1, &i2], &Settings::default()).unwrap();
    let cancel = CancellationToken::default();
    let after_the_first_part = cancel.clone();
    let progress = Arc::new(move |_| after_the_first_part.cancel());
    let cancelled = SolveOptions { cancel, progress: Some(progress), ..SolveOptions::default() };
    assert!(matches!(solver.solve([&i1, &i2], &cancelled), Err(Error::Cancelled)));
    assert!(solver.solve([&i1, &i2], &SolveOptions::default()).unwrap().converged, "the solver stays usable");
}

#[test]
fn packed_photographs_are_unpacked() {
    let format: PixelFormat = "Mono12p".parse().unwrap();
    let bytes = small_pair().map(|frame| {
        let Samples::F32(values) = frame.samples() else { unreachable!() };
        let twelve = |v: f32| (4095.0 * v.clamp(0.0, 1.0)) as u32;
        let pairs = values.chunks(2).map(|two| twelve(two[0]) | twelve(two.get(1).copied().unwrap_or(0.0)) << 12);
        let mut bytes: Vec<u8> = pairs.flat_map(|bits| bits.to_le_bytes()[..3].to_vec()).collect();
        bytes.truncate(format.bytes([151, 131]) as usize);
        bytes
    });
    let solve = |engine: &Engine| {
        let mut solver = PairSolver::for_size(engine, [151, 131], [format; 2], 1, &Settings::default()).unwrap();
        let sources = bytes.each_ref().map(|bytes| Source::Rows { bytes, pitch: 0 });
        solver.submit(sources, &[], &SolveOptions::default()).unwrap().wait().unwrap().to_owned()
    };
    let (v, _) = apart(&solve(&cpu()).relative_blur, &solve(&TestEngine::new()).relative_blur);
    assert!(v < 0.002, "{v}");
}
