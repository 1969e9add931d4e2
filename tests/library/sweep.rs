//! Tests of focus sweeps: a slope rendered in closed form, through a lens that breathes and drifts.

use parfocal::internals::scene::{Preset, Scene, SweepScene};
use parfocal::sweep::{Positions, Sweep, SweepOptions};
use parfocal::{
    Frame, Settings, SolveOptions, SweepSolver,
    frame::Samples,
    transform::{Homography, Similarity},
};

use crate::common::TestEngine;
use crate::common::scene::{Random, exposed, pair};

const SIZE: [u32; 2] = [288, 224];
/// Blur rate c, px² per squared focus setting.
const RATE: f64 = 1.2;
const FRAMES: usize = 7;
const REFERENCE: usize = 3;

/// Focus setting u at a pixel of the reference frame.
fn focus([x, y]: [f64; 2]) -> f64 {
    0.8 + 4.4 * (0.7 * x / f64::from(SIZE[0]) + 0.3 * y / f64::from(SIZE[1]))
}

/// Renders a frame at a focus setting, with displacement, gain and noise.
fn frame(setting: f64, t: Homography, gain: f64, noise: f64, seed: u64) -> Frame {
    let [_, shown] = pair(SIZE, t, |x| [0.0, 0.2 + RATE * (setting - focus(x)).powi(2)], 0.0, 5);
    let mut random = Random(seed);
    let Samples::F32(values) = shown.samples() else { unreachable!() };
    let values = values.iter().map(|&v| (gain * f64::from(v) + noise * random.normal()) as f32);
    Frame::gray(SIZE[0], SIZE[1], values.collect()).unwrap()
}

/// Transform of frame n: scale by 5 % over the sweep, a curved drift of 10 px, and a rotation.
fn transform(n: usize) -> Homography {
    let s = n as f64 - REFERENCE as f64;
    Similarity::new(1.6 * s, 0.4 * s * s - 0.5 * s, 0.05 * s, 1.0 + 0.05 * s / (FRAMES - 1) as f64).into()
}

fn gain(n: usize) -> f64 {
    1.0 + 0.05 * (1.3 * (n as f64 - REFERENCE as f64)).sin()
}

fn frames(settings: &[f64], noise: f64) -> Vec<Frame> {
    (0..FRAMES).map(|n| frame(settings[n], transform(n), gain(n), noise, 20 + n as u64)).collect()
}

fn solve(settings: &[f64], frames: &[Frame]) -> Sweep {
    let options = SweepOptions {
        settings: Settings::default(),
        positions: Positions::Settings(settings.to_vec()),
        reference: Some(REFERENCE),
    };
    let mut solver = SweepSolver::for_frames(&TestEngine::on_any(), frames, &options).unwrap();
    solver.solve(frames, &SolveOptions::default()).unwrap()
}

/// Returns the median of |u - truth| in focus settings, and the shares within one and two standard deviations. The
/// outermost 24 px are excluded.
fn errors_inside(sweep: &Sweep) -> [f64; 3] {
    let [width, height] = SIZE.map(|side| side as usize);
    let places = (24..height - 24).flat_map(|y| (24..width - 24).map(move |x| (x, y)));
    let mut errors: Vec<[f64; 2]> = places
        .map(|(x, y)| {
            let (u, sigma) = (sweep.focus[y * width + x], sweep.uncertainty[y * width + x]);
            let error = (f64::from(u) - focus([x as f64, y as f64])).abs();
            [error, error / f64::from(sigma)]
        })
        .filter(|error| !error[0].is_nan())
        .collect();
    assert!(errors.len() > (width - 48) * (height - 48) * 95 / 100, "{} pixels have a u", errors.len());
    let within = |times: f64| errors.iter().filter(|e| e[1] < times).count() as f64 / errors.len() as f64;
    let shares = [within(1.0), within(2.0)];
    errors.sort_by(|a, b| a[0].total_cmp(&b[0]));
    [errors[errors.len() / 2][0], shares[0], shares[1]]
}

fn check(sweep: &Sweep) {
    let corner = |n: usize| sweep.transforms[n].corner_distance(transform(n), SIZE[0], SIZE[1]);
    let corners: Vec<f64> = (0..FRAMES).map(corner).collect();
    let gains = (0..FRAMES).map(|n| sweep.brightness[n].photometric.gain * gain(n));
    let gains = gains.map(|product| (product - 1.0).abs()).fold(0.0, f64::max);
    let [error, one, two] = errors_inside(sweep);
    println!("corners {corners:.3?} px, gain {gains:.4}, u {error:.4}, {one:.2} {two:.2}, c {:.3}", sweep.blur_rate);
    assert!(corners.iter().all(|corner| *corner < 0.1), "{corners:?}");
    assert!(error < 0.06 && one > 0.5 && two > 0.85, "{error} {one} {two}");
    assert!((sweep.blur_rate / RATE - 1.0).abs() < 0.15, "{}", sweep.blur_rate);
}

/// A sixteenth of the light changes no bit.
#[test]
fn frames_of_a_lens_that_breathes_and_drifts_are_solved_with_any_light() {
    let settings: Vec<f64> = (0..FRAMES).map(|n| n as f64).collect();
    let frames = frames(&settings, 0.005);
    let dim: Vec<Frame> = frames.iter().map(|frame| exposed(frame, 1.0 / 16.0, 0.0)).collect();
    let [bright, dim] = [&frames, &dim].map(|frames| solve(&settings, frames));
    check(&bright);
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&dim.focus) == bits(&bright.focus) && bits(&dim.uncertainty) == bits(&bright.uncertainty));
    assert_eq!((dim.blur_rate, &dim.transforms), (bright.blur_rate, &bright.transforms));
}

#[test]
fn uneven_settings_are_solved() {
    let settings = [0.0, 0.6, 1.9, 3.1, 3.8, 5.2, 6.0];
    check(&solve(&settings, &frames(&settings, 0.005)));
}

#[test]
fn descending_settings_are_solved() {
    let settings: Vec<f64> = (0..FRAMES).map(|n| 6.0 - n as f64).collect();
    let [error, ..] = errors_inside(&solve(&settings, &frames(&settings, 0.005)));
    assert!(error < 0.06, "{error}");
}

/// A camera that moves from frame to frame displaces near against far things: the displacement is found, and u is as
/// certain as without movement.
#[test]
fn the_parallax_of_a_camera_that_moves_is_found() {
    // What is in focus at the last of 9 settings moves by 5.7 px against what is at the first.
    let moves = [4.8, -3.0];
    let by_moves = [[0.0; 2], moves].map(|camera_moves| {
        let scene = Scene { width: 240, height: 176, noise: 0.003, camera_moves, ..Preset::Blocks.scene() };
        let simulated = SweepScene::new(scene, 9).render().unwrap();
        // Descending settings: parallax then has the other sign, and its deviation still none.
        let positions = Positions::Settings((0..9).map(|n| f64::from(8 - n)).collect());
        let options = SweepOptions { positions, ..SweepOptions::default() };
        let mut solver = SweepSolver::new(&TestEngine::on_any(), &options).unwrap();
        let sweep = solver.solve(&simulated.frames, &SolveOptions::default()).unwrap();
        let off = |(u, truth): (&f32, &f32)| (8.0 - u - truth).abs() > 0.5;
        let wrong = sweep.focus.iter().zip(&simulated.focus).filter(|pair| off(*pair)).count();
        println!("{:.4?}", sweep.parallax_deviation);
        assert!(sweep.parallax_deviation.as_flattened().iter().all(|deviation| *deviation >= 0.0));
        // That of the reference, from which the others are counted, is exact.
        let exact = sweep.parallax_deviation.iter().filter(|deviation| **deviation == [0.0; 2]).count();
        assert_eq!(exact, if camera_moves == moves { 1 } else { 9 });
        (sweep.parallax.clone(), wrong as f64 / sweep.focus.len() as f64)
    });
    let [(still, wrong_of_still), (moved, wrong)] = by_moves;
    println!("{moved:.3?}; wrong {wrong_of_still:.3} {wrong:.3}");
    assert!(still.iter().all(|px| *px == [0.0; 2]), "{still:?}");
    // The camera moves evenly, and the scene lies between the settings 0.8 and 7.2. Steps of parallax are damped, and few.
    for (c, px) in moves.into_iter().enumerate() {
        let slope: f64 = moved.iter().enumerate().map(|(n, moves)| (n as f64 - 4.0) * moves[c]).sum::<f64>() / 60.0;
        let found = slope.abs() * 8.0 * 6.4;
        assert!((found - px.abs()).abs() < 0.1 * px.abs(), "{found} {px}");
    }
    assert!(wrong < 1.3 * wrong_of_still + 0.003, "{wrong} {wrong_of_still}");
}
