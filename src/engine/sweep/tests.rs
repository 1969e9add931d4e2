use std::time::Instant;

use super::*;
use crate::base::{Homography, Samples};
use crate::engine::{EngineOptions, testing};
use crate::lab::scene::{Preset, Scene, SimulatedSweep, SweepScene};

const FRAMES: usize = 5;

fn sweep(width: u32, height: u32) -> SimulatedSweep {
    let scene = Scene { width, height, noise: 0.003, ..Preset::Relief.scene() };
    let sweep = SweepScene {
        breathing: 0.03,
        drift: 5.0,
        rotation: 0.004,
        gain_drift: 0.03,
        vignetting: 0.04,
        ..SweepScene::new(scene, FRAMES)
    };
    sweep.render().unwrap()
}

fn solve(sweep: &SimulatedSweep, budget: u64, settings: &Settings, mask: Option<&Mask>) -> Focus {
    let engine = Engine::new(&testing::options()).unwrap();
    let size = [sweep.frames[0].width(), sweep.frames[0].height()];
    let mut solver = SweepSolver::within(budget, &engine, size, sweep.frames[0].format(), FRAMES, settings).unwrap();
    assert_eq!(solver.parts.is_some(), budget < BUDGET);
    let positions: Vec<f64> = (0..FRAMES).map(|n| n as f64).collect();
    let asked = Asked { settings: &positions, known: true, reference: sweep.reference, mask };
    solver.solve(&sweep.frames, &asked, &mut |_, _| ()).unwrap()
}

/// Median and 99th percentile of |u - truth| in settings, of pixels that are told of and counted.
fn errors(found: &Focus, truth: &[f32], counts: impl Fn(usize) -> bool) -> [f32; 2] {
    let known = (0..truth.len()).filter(|&i| found.deviation[i] < 2.0 && counts(i));
    let mut off: Vec<f32> = known.map(|i| (found.focus[i] - truth[i]).abs()).collect();
    off.sort_by(f32::total_cmp);
    [off[off.len() / 2], off[off.len() * 99 / 100]]
}

fn corner(sweep: &SimulatedSweep, found: &Focus) -> f64 {
    let [width, height] = [sweep.frames[0].width(), sweep.frames[0].height()];
    let pairs = sweep.shots.iter().zip(&found.transforms);
    pairs.map(|(shot, t)| t.corner_distance(Homography::from(shot.transform), width, height)).fold(0.0, f64::max)
}

#[test]
fn by_parts_it_is_the_same() {
    let sweep = sweep(520, 390);
    let settings = Settings::default();
    let [whole, parts] = [BUDGET, 16 << 20].map(|budget| solve(&sweep, budget, &settings, None));
    let [of_whole, of_parts] = [&whole, &parts].map(|found| errors(found, &sweep.focus, |_| true));
    let corners = [&whole, &parts].map(|found| corner(&sweep, found));
    let mut apart: Vec<f32> = whole.focus.iter().zip(&parts.focus).map(|(a, b)| (a - b).abs()).collect();
    apart.sort_by(f32::total_cmp);
    println!(
        "whole {of_whole:?}, by parts {of_parts:?}, corners {corners:?}, apart {} {}",
        apart[apart.len() / 2],
        apart[apart.len() * 99 / 100]
    );
    // Settings; both are off by as much as registration at half the size is.
    assert!(of_parts[0] < 1.1 * of_whole[0] + 0.002 && of_parts[1] < 1.2 * of_whole[1]);
    assert!(corners[1] < 1.2 * corners[0] + 0.01);
    assert!(apart[apart.len() / 2] < 0.003 && apart[apart.len() * 99 / 100] < 0.03);
}

#[test]
fn registered_alone_it_is_the_same() {
    let (sweep, engine) = (sweep(168, 126), Engine::new(&testing::options()).unwrap());
    let format = sweep.frames[0].format();
    let mut solver = SweepSolver::new(&engine, [168, 126], format, FRAMES, &Settings::default()).unwrap();
    let asked = Asked { settings: &[0.0, 1.0, 2.0, 3.0, 4.0], known: true, reference: sweep.reference, mask: None };
    let mut said = Vec::new();
    let alone = solver.register(&sweep.frames, &asked, &mut |done, all| said.push((done, all))).unwrap();
    let solved = solver.solve(&sweep.frames, &asked, &mut |_, _| ()).unwrap();
    assert_eq!((&alone.transforms, alone.rate), (&solved.transforms, solved.rate));
    assert_eq!((alone.brightness, alone.settings), (solved.brightness, solved.settings));
    assert_eq!(said, [(1, 1)]);
}

#[test]
fn a_sweep_has_one_time_limit() {
    let sweep = sweep(168, 126);
    let asked = Asked { settings: &[0.0, 1.0, 2.0, 3.0, 4.0], known: true, reference: sweep.reference, mask: None };
    let solve = |options: &EngineOptions| {
        let engine = Engine::new(options).unwrap();
        let format = sweep.frames[0].format();
        let mut solver = SweepSolver::new(&engine, [168, 126], format, FRAMES, &Settings::default()).unwrap();
        let started = Instant::now();
        let solved = solver.solve(&sweep.frames, &asked, &mut |_, _| ());
        (solved.map(drop), started.elapsed())
    };
    let (solved, whole) = solve(&testing::options());
    solved.unwrap();
    // No script of a sweep takes as long as a third of it.
    let (solved, _) = solve(&EngineOptions { timeout: whole / 3, ..testing::options() });
    assert!(matches!(solved, Err(Error::Timeout { .. })), "{solved:?}");
}

#[test]
fn a_frame_that_is_missing_leaves_a_gap_unless_settings_are_known() {
    let mut sweep = sweep(168, 126);
    sweep.frames.remove(1);
    let engine = Engine::new(&testing::options()).unwrap();
    let format = sweep.frames[0].format();
    let mut solver = SweepSolver::new(&engine, [168, 126], format, FRAMES - 1, &Settings::default()).unwrap();
    for (known, settings) in [(false, [0.0, 2.0, 3.0, 4.0]), (true, [0.0, 1.0, 2.0, 3.0])] {
        let asked = Asked { settings: &[0.0, 1.0, 2.0, 3.0], known, reference: 1, mask: None };
        assert_eq!(solver.register(&sweep.frames, &asked, &mut |_, _| ()).unwrap().settings, settings);
    }
}

#[test]
fn clipped_pixels_count_for_nothing() {
    let mut sweep = sweep(260, 200);
    for frame in &mut sweep.frames {
        let Samples::F32(values) = frame.samples() else { unreachable!() };
        // A fifth of the frame is white.
        let clipped = values.iter().map(|v| (1.8 * v).min(1.0)).collect();
        *frame = Frame::gray(frame.width(), frame.height(), clipped).unwrap();
    }
    let told = Settings { white_level: Some(1.0), ..Settings::default() };
    let [plain, told] = [Settings::default(), told].map(|settings| solve(&sweep, BUDGET, &settings, None));
    let [of_plain, of_told] = [&plain, &told].map(|found| errors(found, &sweep.focus, |_| true));
    println!("plain {of_plain:?}, told {of_told:?}, corners {} {}", corner(&sweep, &plain), corner(&sweep, &told));
    assert!(of_told[0] < 0.95 * of_plain[0] && corner(&sweep, &told) < 0.7 * corner(&sweep, &plain));
}

#[test]
fn what_a_mask_leaves_out_counts_for_nothing() {
    let clean = sweep(260, 200);
    let mut dirty = clean.clone();
    let hidden = |i: usize| (40..140).contains(&(i % 260)) && (50..150).contains(&(i / 260));
    for (n, frame) in dirty.frames.iter_mut().enumerate() {
        let Samples::F32(values) = frame.samples() else { unreachable!() };
        // What moves by 3 px from frame to frame.
        let at = |i: usize| if hidden(i) { 0.5 + 0.4 * ((i % 260 + 3 * n) as f32).sin() } else { values[i] };
        *frame = Frame::gray(260, 200, (0..values.len()).map(at).collect()).unwrap();
    }
    let picture = (0..260 * 200).map(|i| if hidden(i) { 0.0 } else { 1.0 }).collect();
    let mask = Mask::of_picture(&Frame::gray(260, 200, picture).unwrap());
    let settings = Settings::default();
    let [with, without] = [Some(&mask), None].map(|mask| solve(&dirty, BUDGET, &settings, mask));
    let clean = solve(&clean, BUDGET, &settings, None);
    let of = |found: &Focus| (errors(found, &dirty.focus, |i| !hidden(i)), corner(&dirty, found));
    println!("clean {:?}, masked {:?}, not {:?}", of(&clean), of(&with), of(&without));
    assert!(of(&with).0[0] < 1.3 * of(&clean).0[0] && of(&with).1 < 0.06);
    assert!((60..120).all(|x| (70..130).all(|y| with.deviation[y * 260 + x].is_nan())));
}
