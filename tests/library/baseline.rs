//! Tests of the baseline methods: registration by appearance or SIFT, then the solve for blur.

use crate::common::scene::{exposed, pair, slanted};
use crate::common::{TestEngine, assert_transform, blur_error, progress_log, real_pair};
use parfocal::{
    Error, Frame, PairSolver, Settings, SolveOptions,
    frame::{Channels, Format, Samples},
    internals::reference,
    settings::{Decode, Method},
    transform::Similarity,
};

fn settings_of(method: Method) -> Settings {
    Settings { method, decode: Decode::None, ..Settings::default() }
}

fn truth() -> Similarity {
    Similarity::new(1.3, -0.9, 0.15, 1.01)
}

fn register(engine: &TestEngine, [i1, i2]: [&Frame; 2], settings: &Settings) -> parfocal::results::Registered {
    PairSolver::for_frames(engine, [i1, i2], settings).unwrap().register([i1, i2], &SolveOptions::default()).unwrap()
}

/// Reduces a frame to half size by means of 2 x 2 pixels.
fn half_size(frame: &Frame) -> Frame {
    let Format { channels, .. } = frame.format();
    let (Samples::U8(samples), count) = (frame.samples(), channels.count() as usize) else { panic!("8 bits") };
    let (width, height) = (frame.width() as usize / 2, frame.height() as usize / 2);
    let mean = |x: usize, y: usize, c: usize| {
        let at = |x: usize, y: usize| u32::from(samples[(y * frame.width() as usize + x) * count + c]);
        ((at(2 * x, 2 * y) + at(2 * x + 1, 2 * y) + at(2 * x, 2 * y + 1) + at(2 * x + 1, 2 * y + 1) + 2) / 4) as u8
    };
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let samples = places.flat_map(|(x, y)| (0..count).map(move |c| (x, y, c))).map(|(x, y, c)| mean(x, y, c)).collect();
    Frame::new(width as u32, height as u32, channels, Samples::U8(samples)).unwrap()
}

#[test]
fn appearance_registers_images_of_equal_blur() {
    let engine = TestEngine::new();
    let [i1, i2] = pair([200, 160], truth(), |_| [1.0, 1.0], 0.0, 1);
    for i2 in [&i2, &exposed(&i2, 0.9, 0.05)] {
        let found = register(&engine, [&i1, i2], &settings_of(Method::Appearance));
        assert_transform(&found.transform, truth(), [0.005, 0.001, 0.005]);
        assert!(found.converged, "{:?}", found.warnings);
    }
    let found = register(&engine, [&i1, &exposed(&i2, 0.9, 0.05)], &settings_of(Method::Appearance));
    assert!((found.photometric.gain - 1.0 / 0.9).abs() < 1e-3, "{:?}", found.photometric);
}

#[test]
fn appearance_registers_a_slanted_plane_and_its_blur_is_solved() {
    let [i1, i2] = pair([256, 256], truth(), slanted(256), 0.003, 1);
    let solution = TestEngine::new().solve([&i1, &i2], &settings_of(Method::Appearance));
    assert_transform(&solution.transform, truth(), [0.1, 0.02, 0.05]);
    let (rms, bias) = blur_error(&solution, |x, _| {
        let [v1, v2] = slanted(256)([x as f64, 0.0]);
        v2 - v1
    });
    println!("V rms {rms:.4} px², bias {bias:+.4}");
    assert!(rms < 0.2);
    assert!(solution.converged, "{:?}", solution.warnings);
}

#[test]
fn appearance_agrees_with_the_reference() {
    let [i1, i2] = pair([151, 131], Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(151), 0.0, 5);
    let settings = Settings { max_relative_blur: Some(9.0), ..settings_of(Method::Appearance) };
    let expected = reference::solve(&i1, &i2, &settings).unwrap();
    let found = TestEngine::new().solve([&i1, &i2], &settings);
    assert!(found.transform.corner_distance(expected.transform, 151, 131) < 1e-3, "{:?}", found.transform);
    let squares: Vec<f64> = found
        .relative_blur
        .iter()
        .zip(&expected.relative_blur.data)
        .map(|(f, e)| (f64::from(*f) - e).powi(2))
        .filter(|s| !s.is_nan())
        .collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(rms < 5e-3, "V rms {rms}");
}

#[test]
fn registering_equals_solving_and_does_not_affect_later_solves() {
    let engine = TestEngine::new();
    let [i1, i2] = pair([160, 128], truth(), slanted(160), 0.0, 2);
    for method in [Method::Unified, Method::Appearance, Method::Aligned] {
        let settings = settings_of(method);
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &settings).unwrap();
        let (options, log) = progress_log();
        let registered = solver.register([&i1, &i2], &options).unwrap();
        let reported: Vec<(u32, u32)> = log.lock().unwrap().iter().map(|p| (p.done, p.total)).collect();
        let solution = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
        assert_eq!(registered.transform, solution.transform, "{method:?}");
        assert_eq!(solver.register([&i1, &i2], &SolveOptions::default()).unwrap().levels, registered.levels);
        let fresh = engine.solve([&i1, &i2], &settings);
        assert_eq!((fresh.transform, &fresh.levels), (solution.transform, &solution.levels));
        let levels = if method == Method::Aligned { 0 } else { 3 };
        assert!(reported.is_sorted() && reported.last().copied().unwrap_or((0, 0)) == (levels, levels), "{reported:?}");
        assert!(registered.timings.passes_ms.iter().any(|(name, _)| *name == "exposure"));
        assert!(registered.timings.passes_ms.iter().all(|(name, _)| *name != "fuse"));
    }
}

#[test]
fn a_pair_that_appearance_cannot_register_gives_a_warning() {
    let engine = TestEngine::new();
    let stripes = |shift: f32| {
        let value = |i: usize| 0.5 + 0.3 * (0.9 * ((i % 80) as f32 + shift)).sin();
        Frame::gray(80, 60, (0..80 * 60).map(value).collect()).unwrap()
    };
    let (a, b) = (stripes(0.0), stripes(0.3));
    let registered = register(&engine, [&a, &b], &settings_of(Method::Appearance));
    assert!(!registered.converged && registered.warnings[0].contains("determine"), "{:?}", registered.warnings);
    let solution = engine.solve([&a, &b], &settings_of(Method::Appearance));
    assert!(!solution.converged && solution.warnings[0].contains("determine"), "{:?}", solution.warnings);
}

#[test]
fn sift_registers_the_heat_sink() {
    let [i1, i2] = real_pair("heatsink", ["frame_15.png", "frame_30.png"]).unwrap();
    let (i1, i2) = (half_size(&i1), half_size(&i2));
    let engine = TestEngine::new();
    // Estimated by another program on images of this size.
    let expected = Similarity::new(0.30, -0.07, 0.007, 1.0075);
    for method in [Method::Sift, Method::Appearance] {
        let found = register(&engine, [&i1, &i2], &settings_of(method));
        let distance = found.transform.corner_distance(expected, i1.width(), i1.height());
        println!("{}: corners {distance:.3} px, {:?}, {:?}", method.name(), found.transform, found.photometric);
        assert!(distance < 0.6, "{:?}", found.transform);
        assert!(found.converged, "{:?}", found.warnings);
    }
}

#[test]
fn sift_registers_a_large_displacement_and_the_blur_is_solved() {
    let far = Similarity::new(14.0, -9.0, 6.0, 1.05);
    let [i1, i2] = pair([256, 200], far, |_| [0.5, 1.5], 0.0, 3);
    let solution = TestEngine::new().solve([&i1, &i2], &settings_of(Method::Sift));
    assert!(solution.transform.corner_distance(far, 256, 200) < 0.3, "{:?}", solution.transform);
    let median = parfocal::export::RangeReport::of(&solution.relative_blur).median.unwrap();
    // V = v2 - v1. The variances are in squared pixels of I1.
    assert!((median - 1.0).abs() < 0.1, "{median}");
}

#[test]
fn too_few_key_points_are_an_error() {
    let engine = TestEngine::new();
    let grey = Frame::gray(80, 60, vec![0.5; 80 * 60]).unwrap();
    let [textured, _] = pair([80, 60], Similarity::IDENTITY, |_| [0.3, 0.3], 0.0, 1);
    let failure = |i1: &Frame, i2: &Frame| {
        let mut solver = PairSolver::for_frames(&engine, [i1, i2], &settings_of(Method::Sift)).unwrap();
        let message = solver.register([i1, i2], &SolveOptions::default()).unwrap_err().to_string();
        assert!(matches!(solver.solve([i1, i2], &SolveOptions::default()), Err(Error::TooFewKeyPoints { .. })));
        message
    };
    let message = failure(&grey, &grey);
    assert!(message.contains("0 key-points in I1") && message.contains("unified"), "{message}");
    assert!(failure(&textured, &grey).contains("0 key-points in I2"));
    let [other, _] = pair([80, 60], Similarity::IDENTITY, |_| [0.3, 0.3], 0.0, 77);
    assert!(failure(&textured, &other).contains("match"));
    // The engine stays usable.
    assert!(engine.solve([&textured, &textured], &settings_of(Method::Sift)).transform.translation()[0].abs() < 1e-3);
}

#[test]
fn colours_are_registered_by_their_luminance() {
    let [i1, i2] = pair([160, 128], truth(), |_| [0.5, 0.5], 0.0, 4);
    let colour = |frame: &Frame| {
        let grey = crate::common::scene::luminance(frame);
        let samples = grey.iter().flat_map(|v| [0.9, 1.0, 1.1].map(|c| (c * v * 255.0).round() as u8)).collect();
        Frame::new(160, 128, Channels::Rgb, Samples::U8(samples)).unwrap()
    };
    let found = register(&TestEngine::new(), [&colour(&i1), &i2], &settings_of(Method::Sift));
    assert!(found.transform.corner_distance(truth(), 160, 128) < 0.3, "{:?}", found.transform);
}
