//! Tests of `PairSolver`: agreement with the CPU reference, determinism, warnings, errors, threads.

use std::sync::Arc;
use std::time::Duration;

use crate::common::scene::{Radiance, Random, luminance, pair, pair_of, slanted};
use crate::common::{TestEngine, blur_error, options, progress_log};
use parfocal::{
    Engine, EngineOptions, Error, Frame, PairSolver, Pending, Progress, Settings, SolveOptions,
    frame::{Channels, Depth, Format, Samples},
    internals::reference,
    settings::{Decode, Method, Photometric},
    transform::Similarity,
};

fn small_pair() -> [Frame; 2] {
    pair([97, 75], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(97), 0.0, 5)
}

#[test]
fn the_device_agrees_with_the_cpu_reference() {
    check_reference(small_pair());
}

/// With three levels, the finest level resamples I2 onto the pixels of I1.
#[test]
fn the_device_agrees_with_the_cpu_reference_if_i2_is_resampled() {
    check_reference(pair([151, 131], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(151), 0.0, 5));
}

fn check_reference([i1, i2]: [Frame; 2]) {
    let settings = Settings { max_relative_blur: Some(9.0), ..Settings::default() };
    let expected = reference::solve(&i1, &i2, &settings).unwrap();
    let found = TestEngine::alone().solve([&i1, &i2], &settings);
    // Single and double precision differ over all iterations, because each continues from the previous one.
    assert!(
        found.transform.corner_distance(expected.transform, i1.width(), i1.height()) < 2e-3,
        "{:?}",
        found.transform
    );
    assert!((found.photometric.gain - expected.photometric.gain).abs() < 1e-4);
    let rms = |pairs: &mut dyn Iterator<Item = (f32, f64)>| {
        let squares: Vec<f64> = pairs.map(|(f, e)| (f64::from(f) - e).powi(2)).filter(|s| !s.is_nan()).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let both = |f: &[f32], e: &[f64]| rms(&mut f.iter().copied().zip(e.iter().copied()));
    let v = both(&found.relative_blur, &expected.relative_blur.data);
    let uncertainty = both(&found.uncertainty, &expected.uncertainty.data);
    let fused = both(&found.fused, &expected.fused[0].data);
    println!("rms against the reference: V {v:.5} px², uncertainty {uncertainty:.6} px², fused {fused:.7}");
    assert!(v < 5e-3 && uncertainty < 5e-3 && fused < 1e-4);
    for (level, energy) in found.levels.iter().zip(&expected.energies) {
        let (last, truth) = (level.energy.last().unwrap(), energy.last().unwrap());
        assert!((last - truth).abs() < 1e-3 * truth, "{last} {truth}");
    }
}

#[test]
fn the_same_pair_gives_the_same_bits() {
    let [i1, i2] = small_pair();
    let engine = TestEngine::new();
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let first = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
    // A solve of another pair must not affect the next one.
    solver.solve([&i2, &i1], &SolveOptions::default()).unwrap();
    let again = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
    let fresh = engine.solve([&i1, &i2], &Settings::default());
    for other in [again, fresh] {
        assert_eq!(first.transform, other.transform);
        assert_eq!(first.levels, other.levels);
        assert_eq!(bits(&first.relative_blur), bits(&other.relative_blur));
        assert_eq!(bits(&first.confidence), bits(&other.confidence));
        assert_eq!(bits(&first.fused), bits(&other.fused));
    }
}

#[test]
fn a_settled_level_stops() {
    let [i1, i2] = pair([160, 128], Similarity::IDENTITY, slanted(160), 0.0, 2);
    let settings = Settings { outer_iterations: 60, ..Settings::default() };
    let solution = TestEngine::new().solve([&i1, &i2], &settings);
    let done: Vec<usize> = solution.levels.iter().map(|l| l.energy.len()).collect();
    println!("outer iterations by level: {done:?}");
    // A level cannot stop before a whole step at the final α, which the coarsest level reaches after six iterations.
    let earliest = [8, 2, 2];
    assert!(solution.converged && done.iter().zip(earliest).all(|(d, e)| (e..60).contains(d)), "{done:?}");
}

#[test]
fn held_parameters_do_not_change() {
    let [i1, i2] = small_pair();
    let engine = TestEngine::new();
    let start = Similarity::new(0.6, -0.4, 0.1, 1.004);
    let aligned = Settings { method: Method::Aligned, start: start.into(), ..Settings::default() };
    let solution = engine.solve([&i1, &i2], &aligned);
    assert!(solution.transform.corner_distance(start, 97, 75) < 1e-5, "{:?}", solution.transform);
    assert_ne!(solution.photometric, Photometric::IDENTITY, "gain and offset were not solved for");
    let held = Settings { photometric: false, ..aligned };
    let solution = engine.solve([&i1, &i2], &held);
    assert_eq!(solution.photometric, Photometric::IDENTITY);
    let truth = |x: usize, _: usize| {
        let [v1, v2] = slanted(97)([x as f64, 0.0]);
        v2 - v1
    };
    let (rms, _) = blur_error(&solution, truth);
    assert!(rms < 0.1, "V rms {rms}");
}

#[test]
fn a_pair_can_mix_colours_and_bit_depths() {
    let [i1, i2] = small_pair();
    let colour = |frame: &Frame| {
        let samples =
            luminance(frame).iter().flat_map(|v| [0.9, 1.0, 1.1].map(|c| (c * v * 255.0).round() as u8)).collect();
        Frame::new(97, 75, Channels::Rgb, Samples::U8(samples)).unwrap()
    };
    let grey = luminance(&i2).iter().map(|v| (v * 65535.0).round() as u16).collect();
    let grey = Frame::new(97, 75, Channels::Gray, Samples::U16(grey)).unwrap();
    let settings = Settings { decode: Decode::None, ..Settings::default() };
    let solution = TestEngine::new().solve([&colour(&i1), &grey], &settings);
    assert_eq!(solution.fused_channels, Channels::Rgb);
    assert_eq!(solution.fused.len(), 97 * 75 * 3);
    assert!(
        (solution.transform.translation()[0] - 0.6).abs() < 0.05
            && (solution.transform.translation()[1] + 0.4).abs() < 0.05
    );
    let both = TestEngine::new().solve([&colour(&i1), &colour(&i2)], &settings);
    let [red, blue] = [0, 2].map(|c| both.fused.iter().skip(c).step_by(3).sum::<f32>());
    assert!((blue / red - 1.1 / 0.9).abs() < 0.01, "{}", blue / red);
}

#[test]
fn samples_of_8_bits_are_read_as_srgb_by_default_and_of_more_as_linear() {
    let (engine, frames) = (TestEngine::new(), small_pair());
    let stored = |depth: Depth| {
        frames.each_ref().map(|frame| {
            let values = luminance(frame).into_iter().map(|v| v.clamp(0.0, 1.0));
            let samples = match depth {
                Depth::U8 => Samples::U8(values.map(|v| (v * 255.0).round() as u8).collect()),
                _ => Samples::U16(values.map(|v| (v * 65535.0).round() as u16).collect()),
            };
            Frame::new(97, 75, Channels::Gray, samples).unwrap()
        })
    };
    let blur = |[i1, i2]: &[Frame; 2], decode| {
        let settings = Settings { decode, outer_iterations: 8, ..Settings::default() };
        engine.solve([i1, i2], &settings).relative_blur.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    let default = Settings::default().decode;
    for (depth, is, is_not) in [(Depth::U8, Decode::Srgb, Decode::None), (Depth::U16, Decode::None, Decode::Srgb)] {
        let pair = stored(depth);
        let found = blur(&pair, default);
        assert!(found == blur(&pair, is) && found != blur(&pair, is_not), "{depth:?}");
    }
}

fn assert_warns(i1: &Frame, i2: &Frame, settings: &Settings, word: &str) {
    let solution = TestEngine::new().solve([i1, i2], settings);
    assert!(!solution.converged);
    assert!(solution.warnings.iter().any(|w| w.contains(word)), "{:?}", solution.warnings);
    assert!(
        solution.transform.matrix().iter().flatten().all(|v| v.is_finite()) && solution.photometric.gain.is_finite()
    );
    assert!(solution.confidence.iter().all(|c| c.is_finite()) && solution.fused.iter().all(|c| c.is_finite()));
    let invalid = solution.relative_blur.iter().filter(|v| v.is_nan()).count();
    assert_eq!(invalid, ((1.0 - solution.valid_fraction) * solution.relative_blur.len() as f64).round() as usize);
}

#[test]
fn pairs_that_cannot_be_solved_give_a_warning() {
    let grey = |v: f32| Frame::gray(80, 60, vec![v; 80 * 60]).unwrap();
    assert_warns(&grey(0.5), &grey(0.5), &Settings::default(), "texture");
    assert_warns(&grey(0.0), &grey(1.0), &Settings::default(), "texture");
    let constant = TestEngine::new().solve([&grey(0.5), &grey(0.6)], &Settings::default());
    assert!(constant.confidence.iter().all(|c| *c == 0.0));

    let [i1, i2] = small_pair();
    let away = Settings {
        method: Method::Aligned,
        start: Similarity::new(500.0, 0.0, 0.0, 1.0).into(),
        ..Settings::default()
    };
    let solution = TestEngine::new().solve([&i1, &i2], &away);
    assert!(solution.relative_blur.iter().all(|v| v.is_nan()) && solution.confidence.iter().all(|c| *c == 0.0));
    assert_warns(&i1, &i2, &away, "overlap");

    let mut random = Random(3);
    let mut noise = || Frame::gray(90, 70, (0..90 * 70).map(|_| random.uniform() as f32).collect()).unwrap();
    let (a, b) = (noise(), noise());
    assert_warns(&a, &b, &Settings::default(), "correlate");
}

#[test]
fn extreme_values_give_finite_results() {
    let checker =
        |scale: f32| Frame::gray(64, 48, (0..64 * 48).map(|i| scale * ((i / 3) % 2) as f32).collect()).unwrap();
    for (a, b) in [(1.0, 1e4), (1e4, 1e-4), (-1.0, 1.0)] {
        let solution = TestEngine::new().solve([&checker(a), &checker(b)], &Settings::default());
        assert!(solution.fused.iter().all(|v| v.is_finite()), "{a} {b}");
        assert!(solution.transform.scale().is_finite() && solution.photometric.gain.is_finite(), "{a} {b}");
    }
}

#[test]
fn sizes_and_formats_that_do_not_fit_are_refused() {
    let engine = TestEngine::new();
    let gray = Format { channels: Channels::Gray, depth: Depth::U8 };
    let prepare = |w, h| PairSolver::for_size(&engine, [w, h], [gray; 2], 1, &Settings::default()).map(|_| ());
    assert!(matches!(prepare(1, 1), Err(Error::TooSmall { .. })));
    assert!(matches!(prepare(8, 8), Err(Error::TooSmall { .. })));
    assert!(matches!(prepare(1 << 20, 16), Err(Error::TooLarge { .. })));
    assert!(matches!(prepare(16384, 16384), Err(Error::TooLarge { .. })));
    assert!(matches!(prepare(u32::MAX, u32::MAX), Err(Error::TooLarge { .. })));
    let [i1, i2] = small_pair();
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let other = Frame::gray(75, 97, vec![0.5; 97 * 75]).unwrap();
    assert!(matches!(solver.solve([&i1, &other], &SolveOptions::default()), Err(Error::Mismatch(_))));
    let submitted = solver.submit([&other, &other], &[], &SolveOptions::default()).map(drop);
    assert!(matches!(submitted, Err(Error::Mismatch(_))));
    assert!(
        solver.solve([&other, &other], &SolveOptions::default()).is_ok(),
        "the solver did not adapt to another size"
    );
    assert!(matches!(PairSolver::for_frames(&engine, [&i1, &other], &Settings::default()), Err(Error::Mismatch(_))));
}

#[test]
fn the_smallest_size_and_odd_sizes_are_solved() {
    let engine = TestEngine::new();
    for size in [[16, 16], [17, 33], [33, 16], [129, 31]] {
        let [i1, i2] = pair(size, Similarity::IDENTITY, |_| [0.3, 0.8], 0.0, 1);
        let solution = engine.solve([&i1, &i2], &Settings { max_relative_blur: Some(2.0), ..Settings::default() });
        assert!(solution.relative_blur.iter().any(|v| !v.is_nan()), "{size:?}");
    }
}

#[test]
fn a_pair_that_reaches_the_usual_limit_is_solved_with_the_widest() {
    let texture = Radiance::gratings(&[[0.06, 0.1], [0.11, 0.1], [0.23, 0.06], [0.61, 0.05]]);
    let [i1, i2] = pair_of(&texture, [200, 160], Similarity::IDENTITY, |x| [0.5, 0.5 + 1.2 * x[0]], 0.001, 1);
    let solve = |max_relative_blur| {
        let settings =
            Settings { max_relative_blur, method: Method::Aligned, edges: false, fused: false, ..Settings::default() };
        TestEngine::on_any().solve([&i1, &i2], &settings)
    };
    for (stated, limit, share) in [(None, 1024.0, 0.0..0.02), (Some(144.0), 144.0, 0.1..1.0)] {
        let found = solve(stated);
        let is_warned = found.warnings.iter().any(|warning| warning.contains("raise max_relative_blur"));
        println!("{limit} px²: {:.3} saturated, {:?}", found.saturated_fraction, found.warnings);
        assert_eq!((found.max_relative_blur, is_warned), (limit, stated.is_some()));
        assert!(share.contains(&found.saturated_fraction));
    }
}

#[test]
fn engines_and_solvers_can_be_used_from_other_threads() {
    fn send<T: Send>() {}
    fn sync<T: Sync>() {}
    send::<Engine>();
    sync::<Engine>();
    send::<PairSolver>();
    send::<Pending>();
    let engine = TestEngine::new();
    let [i1, i2] = small_pair();
    let found: Vec<_> = std::thread::scope(|scope| {
        let solve = || engine.solve([&i1, &i2], &Settings::default()).transform;
        let threads = [scope.spawn(solve), scope.spawn(solve)];
        threads.map(|t| t.join().unwrap()).to_vec()
    });
    assert_eq!(found[0], found[1]);
}

#[test]
fn progress_rises_to_one_by_levels() {
    let [i1, i2] = small_pair();
    let engine = TestEngine::new();
    let (options, log) = progress_log();
    PairSolver::new(&engine, &Settings::default()).unwrap().solve([&i1, &i2], &options).unwrap();
    let calls = log.lock().unwrap();
    assert!(calls.iter().is_sorted_by_key(|p| p.done) && calls.iter().all(|p| p.total == 2), "{calls:?}");
    assert!(calls.iter().map(|p| p.share).is_sorted() && calls.iter().any(|p| p.done == 1), "{calls:?}");
    let last = calls[calls.len() - 1];
    assert_eq!((last.done, last.share), (2, 1.0));
}

#[test]
fn stripes_do_not_determine_the_registration() {
    let stripes = |shift: f32| {
        let value = |i: usize| 0.5 + 0.3 * (0.9 * ((i % 80) as f32 + shift)).sin();
        Frame::gray(80, 60, (0..80 * 60).map(value).collect()).unwrap()
    };
    assert_warns(&stripes(0.0), &stripes(0.3), &Settings::default(), "determine");
}

#[test]
fn a_solver_is_usable_after_its_progress_function_panics() {
    let engine = TestEngine::alone();
    let [i1, i2] = small_pair();
    let panics = |settings: &Settings| {
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], settings).unwrap();
        let solve = std::panic::AssertUnwindSafe(|| {
            let progress: Option<Arc<dyn Fn(Progress) + Send + Sync>> = Some(Arc::new(|_| panic!("on purpose")));
            let _ = solver.solve([&i1, &i2], &SolveOptions { progress, ..SolveOptions::default() });
        });
        assert!(std::panic::catch_unwind(solve).is_err());
        solver.solve([&i1, &i2], &SolveOptions::default())
    };
    // The solve in flight ends before the panic continues, with and without optional parts.
    for settings in [Settings::default(), Settings { outer_iterations: 5, ..Settings::default() }] {
        let after = panics(&settings).unwrap();
        let before = engine.solve([&i1, &i2], &settings);
        assert_eq!((after.transform, &after.levels), (before.transform, &before.levels));
    }
}

#[test]
fn a_wait_that_times_out_poisons_the_engine() {
    let engine = Engine::new(&EngineOptions { timeout: Duration::from_millis(1), ..options() }).unwrap();
    let [i1, i2] = pair([128, 128], Similarity::IDENTITY, |_| [0.3, 0.8], 0.0, 1);
    // Preparation also waits for the device, to initialize the images.
    let prepared = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default());
    let timed_out = prepared.and_then(|mut solver| solver.solve([&i1, &i2], &SolveOptions::default()));
    assert!(matches!(timed_out, Err(Error::Timeout { .. })), "{timed_out:?}");
    let after = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).map(|_| ());
    assert!(matches!(after, Err(Error::Poisoned)), "{after:?}");
}
