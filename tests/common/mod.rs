//! Helpers for tests of whole solves: an engine under validation, scenes with known V and T, photographs.
#![allow(dead_code, reason = "no test program uses all helpers")]

#[cfg(target_os = "linux")]
pub mod fuzz;
pub mod scene;
pub mod trust;

use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock, Mutex};

use parfocal::{
    Engine, EngineOptions, Frame, PairSolver, Progress, Settings, Solution, SolveOptions, image_io,
    internals::key_points, transform::Homography,
};

/// An engine that fails the test on any validation message. Tests share one engine for each device, and so its messages.
pub struct TestEngine(Engine);

/// The shared engine on Vulkan. It is opened once, because opening a device under validation takes as long as most
/// tests.
static SHARED: LazyLock<Engine> = LazyLock::new(open);

/// The shared engine on the CPU device.
static SHARED_CPU: LazyLock<Engine> = LazyLock::new(|| Engine::new(&cpu_options()).unwrap());

fn open() -> Engine {
    Engine::new(&options()).unwrap()
}

impl TestEngine {
    /// Returns the shared engine, on the device that `PARFOCAL_DEVICE` names. Validation is enabled unless
    /// `PARFOCAL_VALIDATE` is 0. A missing device or layer fails the test.
    pub fn new() -> Self {
        Self(SHARED.clone())
    }

    /// Returns the shared engine for tests of results that are the same on all devices: on the device that
    /// `PARFOCAL_DEVICE` names, else on the CPU device, which is the fastest where there is no GPU.
    pub fn on_any() -> Self {
        let shared = if std::env::var_os("PARFOCAL_DEVICE").is_some() { &SHARED } else { &SHARED_CPU };
        Self(Engine::clone(shared))
    }

    /// Opens a separate engine, for a test that poisons it or needs a second one.
    pub fn alone() -> Self {
        Self(open())
    }

    /// Solves one pair.
    pub fn solve(&self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Solution {
        PairSolver::new(self, settings).unwrap().solve([i1, i2], &SolveOptions::default()).unwrap()
    }
}

/// Returns options with a progress function, and the log of its calls.
pub fn progress_log() -> (SolveOptions, Arc<Mutex<Vec<Progress>>>) {
    let log = Arc::<Mutex<Vec<Progress>>>::default();
    let calls = log.clone();
    let progress = move |progress| calls.lock().unwrap().push(progress);
    (SolveOptions { progress: Some(Arc::new(progress)), ..SolveOptions::default() }, log)
}

/// Returns the engine options of all tests.
pub fn options() -> EngineOptions {
    EngineOptions {
        device: std::env::var("PARFOCAL_DEVICE").ok().or(Some("vulkan".into())),
        validation: std::env::var("PARFOCAL_VALIDATE").as_deref() != Ok("0"),
        key_points: Some(key_points),
        timed: true,
        ..EngineOptions::default()
    }
}

/// Returns the engine options of tests on the CPU device.
pub fn cpu_options() -> EngineOptions {
    EngineOptions { device: Some("cpu".into()), validation: false, ..options() }
}

impl Deref for TestEngine {
    type Target = Engine;

    fn deref(&self) -> &Engine {
        &self.0
    }
}

impl Drop for TestEngine {
    fn drop(&mut self) {
        let messages = self.0.validation_messages();
        assert!(std::thread::panicking() || messages.is_empty(), "validation: {messages:#?}");
    }
}

/// Reads a real pair from the project's data or from the folder `PARFOCAL_PAIRS` (default `../shared/data`).
/// The project cannot distribute some pairs. If a pair is absent, prints a message and returns `None`.
pub fn real_pair(folder: &str, names: [&str; 2]) -> Option<[Frame; 2]> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let from = |name: &str| std::env::var_os(name).map(PathBuf::from);
    let own = from("PARFOCAL_DATA").unwrap_or_else(|| root.join("data"));
    let others = from("PARFOCAL_PAIRS").unwrap_or_else(|| root.join("../shared/data"));
    let Some(data) = [own, others].into_iter().map(|d| d.join(folder)).find(|d| d.is_dir()) else {
        eprintln!(
            "the pair '{folder}' is missing, and the test is skipped: set PARFOCAL_PAIRS to the folder that holds it"
        );
        return None;
    };
    let (i1, i2) = image_io::read_pair(&data.join(names[0]), &data.join(names[1])).unwrap();
    Some([i1, i2])
}

/// Returns the rms and the mean of the error of V, px², over the valid pixels without a border of 16 px.
pub fn blur_error(solution: &Solution, truth: impl Fn(usize, usize) -> f64) -> (f64, f64) {
    let (width, height, border) = (solution.width as usize, solution.height as usize, 16);
    let errors: Vec<f64> = (border..height - border)
        .flat_map(|y| (border..width - border).map(move |x| (x, y)))
        .map(|(x, y)| f64::from(solution.relative_blur[y * width + x]) - truth(x, y))
        .filter(|e| !e.is_nan())
        .collect();
    assert!(errors.len() > width * height / 3, "only {} pixels are valid", errors.len());
    let n = errors.len() as f64;
    ((errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(), errors.iter().sum::<f64>() / n)
}

/// Asserts that the errors of T are at most these: translation per axis in pixels, rotation in degrees, scale in %.
#[track_caller]
pub fn assert_transform(found: &Homography, truth: impl Into<Homography>, [pixels, degrees, percent]: [f64; 3]) {
    let truth = truth.into();
    let ([x, y], [true_x, true_y]) = (found.translation(), truth.translation());
    let errors = [
        (x - true_x).abs().max((y - true_y).abs()),
        (found.rotation_deg() - truth.rotation_deg()).abs(),
        100.0 * (found.scale() - truth.scale()).abs(),
    ];
    println!(
        "t {:.5} px (≤ {pixels}), θ {:.6}° (≤ {degrees}), s {:.6} % (≤ {percent})",
        errors[0], errors[1], errors[2]
    );
    assert!(errors[0] <= pixels && errors[1] <= degrees && errors[2] <= percent, "{found:?}, not {truth:?}");
}
