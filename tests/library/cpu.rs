//! Tests of the CPU device: its results are those of a Vulkan device, for all methods and inputs.

use std::sync::Arc;
use std::time::Duration;

use parfocal::frame::{Channels, Samples, Source};
use parfocal::internals::reference;
use parfocal::settings::{Kernel, Method, Motion};
use parfocal::sweep::{Positions, SweepOptions};
use parfocal::transform::{Homography, Similarity};
use parfocal::{
    CancellationToken, Engine, EngineOptions, Error, Frame, Mask, PairSolver, PixelFormat, Settings, Solution,
    SolveOptions, SweepSolver,
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

/// Solves on both devices. V may differ by 0.002 px² rms and T by 0.0005 px at a corner, because both round to single
/// precision in each iteration.
fn check(what: &str, [i1, i2]: [&Frame; 2], settings: &Settings, mask: Option<&Mask>) -> Solution {
    let solve = |engine: &Engine| {
        let options = SolveOptions { mask: mask.cloned(), ..SolveOptions::default() };
        PairSolver::for_frames(engine, [i1, i2], settings).unwrap().solve([i1, i2], &options).unwrap()
    };
    let (found, expected) = (solve(&cpu()), solve(&TestEngine::new()));
    let corner = found.transform.corner_distance(expected.transform, i1.width(), i1.height());
    let (v, unequal) = apart(&found.relative_blur, &expected.relative_blur);
    let (fused, _) = apart(&found.fused, &expected.fused);
    let (sigma, _) = apart(&found.uncertainty, &expected.uncertainty);
    println!(
        "{what}: V {v:.5} px², σ {sigma:.5} px², corner {corner:.6} px, fused {fused:.6}, {unequal:.5} in one only"
    );
    assert!(v <= 0.002 && corner <= 5e-4 && fused < 1e-4 && unequal < 1e-3, "{what}");
    assert_eq!(found.converged, expected.converged, "{what}");
    assert_eq!(found.warnings, expected.warnings, "{what}");
    found
}

fn small_pair() -> [Frame; 2] {
    pair([151, 131], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(151), 0.003, 5)
}

#[test]
fn pairs_have_the_results_of_a_vulkan_device() {
    let [i1, i2] = &small_pair();
    let settings = Settings { max_relative_blur: Some(36.0), ..Settings::default() };
    check("unified", [i1, i2], &settings, None);
    for motion in [Motion::Translation, Motion::Affine, Motion::Homography] {
        check(&format!("{motion:?}"), [i1, i2], &Settings { motion, ..settings.clone() }, None);
    }
    for method in [Method::Aligned, Method::Appearance] {
        check(&format!("{method:?}"), [i1, i2], &Settings { method, ..settings.clone() }, None);
    }
    for kernel in [Kernel::Gaussian, Kernel::Pillbox] {
        check(kernel.clone().name(), [i1, i2], &Settings { kernel, ..settings.clone() }, None);
    }
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
fn clipped_pixels_masks_and_colours_are_as_on_a_vulkan_device() {
    let coloured = small_pair().map(|frame| {
        let Samples::F32(values) = frame.samples() else { unreachable!() };
        let shown = |v: &f32| [1.1 * v, v * v, 0.9 * v].map(|v| (255.0 * v.clamp(0.0, 0.8) / 0.8) as u8);
        let samples = values.iter().flat_map(shown).collect();
        Frame::new(frame.width(), frame.height(), Channels::Rgb, Samples::U8(samples)).unwrap()
    });
    let shown = (0..151 * 131).map(|i| f32::from(u8::from(i % 151 > 30))).collect();
    let mask = Mask::from_image(&Frame::gray(151, 131, shown).unwrap());
    let found = check("clipped", coloured.each_ref(), &Settings::default(), Some(&mask));
    assert!(found.relative_blur.iter().step_by(151).all(|v| v.is_nan()), "the masked columns have no V");
}

#[test]
fn sweeps_have_the_results_of_a_vulkan_device() {
    let focus = |[x, y]: [f64; 2]| 0.6 + 2.6 * (0.7 * x / 160.0 + 0.3 * y / 128.0);
    let frame = |n: usize| {
        let t: Homography = Similarity::new(0.8 * n as f64 - 1.6, 0.3, 0.02, 1.0 + 0.01 * n as f64).into();
        let [_, shown] = pair([160, 128], t, |x| [0.0, 0.2 + 1.5 * (n as f64 - focus(x)).powi(2)], 0.004, 5);
        shown
    };
    let frames: Vec<Frame> = (0..5).map(frame).collect();
    let settings = (0..5).map(f64::from).collect();
    let options =
        SweepOptions { settings: Settings::default(), positions: Positions::Settings(settings), reference: Some(2) };
    let solve = |engine: &Engine| {
        let mut solver = SweepSolver::for_frames(engine, &frames, &options).unwrap();
        solver.solve(&frames, &SolveOptions::default()).unwrap()
    };
    let (found, expected) = (solve(&cpu()), solve(&TestEngine::new()));
    let (u, unequal) = apart(&found.focus, &expected.focus);
    let corners = found.transforms.iter().zip(&expected.transforms).map(|(a, b)| a.corner_distance(*b, 160, 128));
    let corner = corners.fold(0.0, f64::max);
    println!("u {u:.6} steps, corner {corner:.6} px, {unequal:.5} in one only");
    assert!(u < 1e-3 && corner < 5e-4 && unequal < 1e-3);
    assert_eq!(found.warnings, expected.warnings);
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
