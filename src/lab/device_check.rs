//! Whether a device computes what the processor does: whole solves on both, compared.

use serde::Serialize;

use super::scene::{Preset, Scene, SweepScene};
use crate::base::{Channels, Error, Frame, Kernel, Mask, Method, Motion, Samples, Settings};
use crate::engine::{Engine, Solution};
use crate::solve::sweep::{SweepOptions, SweepSolver};
use crate::solve::{PairSolver, SolveOptions};

/// A solve on a device and on the processor.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceCheck {
    /// What was solved.
    pub solve: String,
    /// How far apart the results are; empty if the device failed.
    pub differences: Vec<Difference>,
    /// The error of a device that failed.
    pub error: Option<String>,
    /// The times of the solve on the device and on the processor, ms. Pairs are solved twice, and the second counts.
    pub times_ms: [f64; 2],
}

/// A difference between the results of two devices, and the largest that is right.
#[derive(Clone, Debug, Serialize)]
pub struct Difference {
    /// The quantity with its unit.
    pub of: &'static str,
    /// The difference: of maps the root of the mean square, of T that at a corner.
    pub found: f64,
    /// The largest that rounding explains: both devices round to single precision in each iteration.
    pub most: f64,
}

impl DeviceCheck {
    /// Whether the device did not fail and each difference is one of rounding.
    pub fn is_right(&self) -> bool {
        self.error.is_none() && self.differences.iter().all(|difference| difference.found <= difference.most)
    }
}

/// Odd, so that tiles and levels have borders of all kinds.
const SIZE: [u32; 2] = [151, 131];

/// Solves eleven pairs and a sweep on a device and on the processor, for all methods, motion models and kernels, and
/// passes each to `seen`. Returns whether all are right.
///
/// # Errors
/// Of the processor. Those of the device are in the checks.
pub fn check(device: &Engine, processor: &Engine, seen: &mut dyn FnMut(&DeviceCheck)) -> Result<bool, Error> {
    let mut is_right = true;
    let mut add = |check: DeviceCheck| {
        is_right &= check.is_right();
        seen(&check);
    };
    for (name, scene, settings) in pairs() {
        let pair = scene.render()?;
        add(of_pair(name, [device, processor], [&pair.i1, &pair.i2], &settings, None)?);
    }
    let pair = scene(SIZE).render()?;
    let clipped = [&pair.i1, &pair.i2].map(clipped).into_iter().collect::<Result<Vec<_>, _>>()?;
    let shown = (0..SIZE[0] * SIZE[1]).map(|i| f32::from(u8::from(i % SIZE[0] > 30))).collect();
    let mask = Mask::from_image(&Frame::gray(SIZE[0], SIZE[1], shown).map_err(Error::Mismatch)?);
    add(of_pair(
        "colours of 8 bits, clipped, under a mask",
        [device, processor],
        [&clipped[0], &clipped[1]],
        &Settings::default(),
        Some(&mask),
    )?);
    add(of_sweep([device, processor])?);
    Ok(is_right)
}

fn scene([width, height]: [u32; 2]) -> Scene {
    Scene { width, height, noise: 0.003, ..Preset::Plane.scene() }
}

/// The pairs of floats.
fn pairs() -> Vec<(&'static str, Scene, Settings)> {
    let with = |name, change: &dyn Fn(&mut Settings)| {
        let mut settings = Settings { max_relative_blur: Some(36.0), ..Settings::default() };
        change(&mut settings);
        (name, scene(SIZE), settings)
    };
    vec![
        with("unified", &|_| {}),
        with("translation", &|settings| settings.motion = Motion::Translation),
        with("affine", &|settings| settings.motion = Motion::Affine),
        with("homography", &|settings| settings.motion = Motion::Homography),
        with("aligned", &|settings| {
            (settings.method, settings.start) = (Method::Aligned, scene(SIZE).transform.into());
        }),
        with("appearance", &|settings| settings.method = Method::Appearance),
        with("gaussian", &|settings| settings.kernel = Kernel::Gaussian),
        with("pillbox", &|settings| settings.kernel = Kernel::Pillbox),
        ("one level", scene([71, 53]), Settings::default()),
        ("many levels", scene([401, 263]), Settings::default()),
    ]
}

/// A pair in colour, of 8 bits, whose brightest pixels are white.
fn clipped(frame: &Frame) -> Result<Frame, Error> {
    let shown = |v: &f32| [1.1 * v, v * v, 0.9 * v].map(|v| (255.0 * v.clamp(0.0, 0.8) / 0.8) as u8);
    let samples = frame.intensities(crate::base::Decode::None).iter().flat_map(shown).collect();
    Frame::new(frame.width(), frame.height(), Channels::Rgb, Samples::U8(samples)).map_err(Error::Mismatch)
}

/// Compares the solves of one pair.
///
/// # Errors
/// Of the processor.
fn of_pair(
    name: &str,
    [device, processor]: [&Engine; 2],
    pair: [&Frame; 2],
    settings: &Settings,
    mask: Option<&Mask>,
) -> Result<DeviceCheck, Error> {
    let options = SolveOptions { mask: mask.cloned(), ..SolveOptions::default() };
    let solve = |engine: &Engine| {
        let mut solver = PairSolver::for_frames(engine, pair, settings)?;
        solver.solve(pair, &options)?;
        solver.solve(pair, &options)
    };
    let expected = solve(processor)?;
    let differences = |found: &Solution| {
        let corner = found.transform.corner_distance(expected.transform, pair[0].width(), pair[0].height());
        let judged = found.converged == expected.converged && found.warnings == expected.warnings;
        let ([v, apart], [sigma, _]) =
            (differ(&found.relative_blur, &expected.relative_blur), differ(&found.uncertainty, &expected.uncertainty));
        vec![
            Difference { of: "V, px²", found: v, most: 0.002 },
            Difference { of: "σ, px²", found: sigma, most: 0.002 },
            Difference { of: "T, px", found: corner, most: 5e-4 },
            Difference { of: "fused", found: differ(&found.fused, &expected.fused)[0], most: 1e-4 },
            Difference { of: "share without V", found: apart, most: 1e-3 },
            Difference { of: "verdicts", found: f64::from(u8::from(!judged)), most: 0.0 },
        ]
    };
    let (found, times) = (solve(device), |solution: &Solution| solution.timings.total_ms);
    Ok(DeviceCheck {
        solve: name.to_string(),
        times_ms: [found.as_ref().map_or(f64::NAN, times), times(&expected)],
        differences: found.as_ref().map(differences).unwrap_or_default(),
        error: found.err().map(|error| error.to_string()),
    })
}

fn of_sweep([device, processor]: [&Engine; 2]) -> Result<DeviceCheck, Error> {
    let sweep = SweepScene::new(scene(SIZE), 5).render()?;
    let mut times_ms = [0.0; 2];
    let mut solve = |n: usize, engine: &Engine| {
        let mut solver = SweepSolver::for_frames(engine, &sweep.frames, &SweepOptions::default())?;
        let started = std::time::Instant::now();
        let solved = solver.solve(&sweep.frames, &SolveOptions::default());
        times_ms[n] = started.elapsed().as_secs_f64() * 1e3;
        solved
    };
    let expected = solve(1, processor)?;
    let found = solve(0, device);
    let differences = found.as_ref().map(|found| {
        let both = found.transforms.iter().zip(&expected.transforms);
        let corner = both.map(|(a, b)| a.corner_distance(*b, SIZE[0], SIZE[1])).fold(0.0, f64::max);
        let [u, apart] = differ(&found.focus, &expected.focus);
        vec![
            Difference { of: "u, steps", found: u, most: 1e-3 },
            Difference { of: "T, px", found: corner, most: 5e-4 },
            Difference { of: "share without V", found: apart, most: 1e-3 },
            Difference { of: "verdicts", found: f64::from(u8::from(found.warnings != expected.warnings)), most: 0.0 },
        ]
    });
    Ok(DeviceCheck {
        solve: "sweep of 5".to_string(),
        differences: differences.unwrap_or_default(),
        error: found.err().map(|error| error.to_string()),
        times_ms,
    })
}

/// The root of the mean square difference of the numbers that are finite in both, and the share finite in one only.
fn differ(a: &[f32], b: &[f32]) -> [f64; 2] {
    let both = || a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
    let squares: f64 = both().map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let unequal = a.iter().zip(b).filter(|(a, b)| a.is_finite() != b.is_finite()).count();
    [(squares / both().count().max(1) as f64).sqrt(), unequal as f64 / a.len().max(1) as f64]
}
