//! Tests of pairs that are solved in parts because they exceed the memory limit.

use crate::common::scene::{pair, slanted};
use crate::common::{TestEngine, options};
use parfocal::{
    Engine, EngineOptions, Error, Frame, Mask, PairSolver, Settings, Solution, SolveOptions, transform::Similarity,
};

const SIZE: [u32; 2] = [561, 402];

fn solve(engine: &Engine, [i1, i2]: [&Frame; 2], mask: Option<Mask>, settings: &Settings) -> Solution {
    let options = SolveOptions { mask, ..SolveOptions::default() };
    PairSolver::new(engine, settings).unwrap().solve([i1, i2], &options).unwrap()
}

/// Brightens a frame, most at one corner.
fn brightened(frame: &Frame) -> Frame {
    let parfocal::frame::Samples::F32(values) = frame.samples() else { unreachable!() };
    let at = |i: usize| [i % SIZE[0] as usize, i / SIZE[0] as usize].map(|n| n as f32 / 560.0);
    let brighter = |(i, v): (usize, &f32)| 0.04 + v * (1.05 + 0.06 * at(i)[0] * at(i)[1]);
    Frame::gray(SIZE[0], SIZE[1], values.iter().enumerate().map(brighter).collect()).unwrap()
}

#[test]
fn solving_in_parts_agrees_with_solving_at_once() {
    let truth = Similarity::new(4.3, -2.9, 0.15, 1.006);
    let [i1, i2] = pair(SIZE, truth, slanted(SIZE[0]), 0.002, 3);
    let i2 = brightened(&i2);
    let settings = Settings { max_relative_blur: Some(16.0), ..Settings::default() };
    let whole = solve(&TestEngine::new(), [&i1, &i2], None, &settings);
    let small = Engine::new(&EngineOptions { memory: Some(20 << 20), ..options() }).unwrap();
    let formats = [i1.format(), i2.format()];
    assert!(matches!(PairSolver::for_size(&small, SIZE, formats, 1, &settings), Err(Error::TooLarge { .. })));
    let mask: Vec<f32> = (0..SIZE[0] * SIZE[1]).map(|i| f32::from(u8::from(i % SIZE[0] >= 60))).collect();
    let mask = Mask::from_image(&Frame::gray(SIZE[0], SIZE[1], mask).unwrap());
    let parts = solve(&small, [&i1, &i2], Some(mask), &settings);
    let corners = [&whole, &parts].map(|s| s.transform.corner_distance(truth, SIZE[0], SIZE[1]));
    let (mut count, mut square, mut most, mut missing) = (0, 0.0, 0.0_f32, 0);
    for i in (0..whole.relative_blur.len()).filter(|i| i % SIZE[0] as usize >= 76) {
        let [a, b] = [&whole, &parts].map(|s| s.relative_blur[i]);
        if a.is_finite() && b.is_finite() {
            (count, square, most) = (count + 1, square + (a - b) * (a - b), most.max((a - b).abs()));
        } else {
            missing += usize::from(a.is_finite());
        }
    }
    let rms = (square / count as f32).sqrt();
    println!("corners {corners:?} px, V apart by {rms} px² rms, {most} at most, {missing} px missing of {count}");
    println!("{:?} {:?}", whole.photometric, parts.photometric);
    assert!(corners[0] < 0.01 && corners[1] < 0.02, "{corners:?}");
    assert!(rms < 0.03 && most < 0.5 && missing < count / 200, "{rms} {most} {missing}");
    assert!((0..SIZE[1]).all(|y| parts.relative_blur[(y * SIZE[0] + 30) as usize].is_nan()), "masked pixels have a V");
    assert!(parts.converged, "{:?}", parts.warnings);
    let fused = whole.fused.iter().zip(&parts.fused).map(|(a, b)| (a - b).abs()).sum::<f32>();
    assert!(fused / (whole.fused.len() as f32) < 0.002, "{fused}");
    assert_eq!((parts.width, parts.height, parts.photograph), (SIZE[0], SIZE[1], SIZE));
    assert!(small.validation_messages().is_empty(), "{:?}", small.validation_messages());
}

#[test]
fn a_memory_limit_below_one_part_is_an_error() {
    let [i1, i2] = pair(SIZE, Similarity::IDENTITY, slanted(SIZE[0]), 0.0, 3);
    let tiny = Engine::new(&EngineOptions { memory: Some(1 << 20), ..options() }).unwrap();
    let mut solver = PairSolver::new(&tiny, &Settings::default()).unwrap();
    let solved = solver.solve([&i1, &i2], &SolveOptions::default());
    assert!(matches!(solved, Err(Error::TooLarge { .. })), "{:?}", solved.map(|s| s.findings));
}
