//! Tests of pixels without weight: clipped pixels and pixels that a mask excludes.

use crate::common::scene::{luminance, pair, slanted};
use crate::common::{TestEngine, blur_error};
use parfocal::{
    Frame, Mask, PairSolver, Settings, Solution, SolveOptions,
    frame::{Channels, Samples},
    internals::reference,
    transform::Similarity,
};

const SIZE: [u32; 2] = [160, 128];

fn transform() -> Similarity {
    Similarity::new(1.3, -0.9, 0.15, 1.01)
}

fn clean_pair() -> [Frame; 2] {
    pair(SIZE, transform(), slanted(SIZE[0]), 0.0, 5)
}

/// Converts a frame to 16 bits. Where `replace` returns a value, it replaces the pixel.
fn stored(frame: &Frame, replace: impl Fn(u32, u32) -> Option<f64>) -> Frame {
    let values = luminance(frame).into_iter().enumerate().map(|(i, v)| {
        let (x, y) = (i as u32 % frame.width(), i as u32 / frame.width());
        // Scaled to half of the range, so that no other pixel is clipped.
        (65535.0 * replace(x, y).unwrap_or(0.25 + 0.5 * v).clamp(0.0, 1.0)).round() as u16
    });
    Frame::new(frame.width(), frame.height(), Channels::Gray, Samples::U16(values.collect())).unwrap()
}

/// Returns whether a pixel is within a disk of this radius on a grid of 40 px, moved by `shift`.
fn disks(radius: i64, shift: i64) -> impl Fn(u32, u32) -> bool {
    move |x, y| {
        let offset = |i: u32| (i64::from(i) + shift).rem_euclid(40) - 20;
        offset(x).pow(2) + offset(y).pow(2) <= radius * radius
    }
}

fn v_rms(solution: &Solution, skip: impl Fn(u32, u32) -> bool) -> f64 {
    let mut left_out = solution.clone();
    for (i, v) in left_out.relative_blur.iter_mut().enumerate() {
        if skip(i as u32 % SIZE[0], i as u32 / SIZE[0]) {
            *v = f32::NAN;
        }
    }
    blur_error(&left_out, |x, _| {
        let [v1, v2] = slanted(SIZE[0])([x as f64, 0.0]);
        v2 - v1
    })
    .0
}

fn corner(solution: &Solution) -> f64 {
    solution.transform.corner_distance(transform(), SIZE[0], SIZE[1])
}

/// Reflections clip different pixels in the two images.
#[test]
fn clipped_pixels_carry_no_weight() {
    let [i1, i2] = clean_pair();
    let white = |on: bool| on.then_some(1.0);
    let i1 = stored(&i1, |x, y| white(disks(3, 0)(x, y)));
    let i2 = stored(&i2, |x, y| white(disks(3, 6)(x, y)));
    let engine = TestEngine::on_any();
    let near = |x: u32, y: u32| disks(9, 0)(x, y) || disks(9, 6)(x, y);
    let weighted = engine.solve([&i1, &i2], &Settings::default());
    let unweighted = engine.solve([&i1, &i2], &Settings { white_level: Some(1e5), ..Settings::default() });
    let [a, b] = [&weighted, &unweighted].map(|s| (corner(s), v_rms(s, near)));
    println!("without clipped pixels: corner {:.4} px, V rms {:.4} px²; with them: {:.4}, {:.4}", a.0, a.1, b.0, b.1);
    assert!(a.0 < 0.1 && a.1 < 0.25, "{a:?}");
    assert!(b.0 > 3.0 * a.0 && b.1 > 2.0 * a.1, "{b:?}");
}

/// Pixels clip below the maximum of the format, at a level given in stored values.
#[test]
fn the_white_level_can_be_set() {
    let [i1, i2] = clean_pair();
    let grey = |on: bool| on.then_some(0.9);
    let i1 = stored(&i1, |x, y| grey(disks(3, 0)(x, y)));
    let i2 = stored(&i2, |x, y| grey(disks(3, 6)(x, y)));
    let solution = TestEngine::on_any()
        .solve([&i1, &i2], &Settings { white_level: Some((0.9 * 65535.0f64).round()), ..Settings::default() });
    assert!(corner(&solution) < 0.1, "{}", corner(&solution));
}

/// A part of I2 moves differently, and a mask excludes it.
#[test]
fn pixels_excluded_by_a_mask_do_not_affect_the_registration() {
    let [i1, i2] = clean_pair();
    let [_, moved] = pair(SIZE, Similarity::new(7.0, 5.0, 0.0, 1.0), slanted(SIZE[0]), 0.0, 5);
    let left_out = |x: u32, y: u32| (20..110).contains(&x) && (24..104).contains(&y);
    let (there, here) = (luminance(&moved), luminance(&i2));
    let mixed = (0..SIZE[0] * SIZE[1]).map(|i| {
        let inside = left_out(i % SIZE[0], i / SIZE[0]);
        (if inside { there[i as usize] } else { here[i as usize] }) as f32
    });
    let i2 = Frame::gray(SIZE[0], SIZE[1], mixed.collect()).unwrap();
    let picture = (0..SIZE[0] * SIZE[1]).map(|i| if left_out(i % SIZE[0], i / SIZE[0]) { 0.0 } else { 1.0 });
    let mask = Mask::from_image(&Frame::gray(SIZE[0], SIZE[1], picture.collect()).unwrap());
    let engine = TestEngine::on_any();
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let whole = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
    let options = SolveOptions { mask: Some(mask), ..SolveOptions::default() };
    let masked = solver.solve([&i1, &i2], &options).unwrap();
    println!("corner {:.4} px with the mask, {:.4} without", corner(&masked), corner(&whole));
    assert!(corner(&masked) < 0.02 && corner(&whole) > 0.15_f64.max(10.0 * corner(&masked)));
    let place = (60 * SIZE[0] + 60) as usize;
    assert!(masked.relative_blur[place].is_nan() && masked.confidence[place] == 0.0);
    // The residual is large where the scene moved.
    let middle = whole.residual[place];
    let beside = whole.residual[(64 * SIZE[0] + 140) as usize];
    println!("residual {middle:.4} where the scene moved, {beside:.4} beside it");
    assert!(middle > 5.0 * beside, "{middle} {beside}");
    let again = solver.solve([&i1, &i2], &SolveOptions::default()).unwrap();
    assert_eq!(again.transform, whole.transform, "the mask affected a later solve");
    let mask = Some(Mask::from_image(&Frame::gray(16, 16, vec![1.0; 256]).unwrap()));
    let refused = solver.solve([&i1, &i2], &SolveOptions { mask, ..SolveOptions::default() });
    assert!(refused.unwrap_err().to_string().contains("16x16"));
}

/// A mask may leave less than 1 % of the frame without a warning.
#[test]
fn a_small_mask_does_not_cause_an_overlap_warning() {
    let [i1, i2] = clean_pair();
    let inside = |i: u32| (64..78).contains(&(i % SIZE[0])) && (60..74).contains(&(i / SIZE[0]));
    let picture = (0..SIZE[0] * SIZE[1]).map(|i| if inside(i) { 1.0 } else { 0.0 }).collect();
    let engine = TestEngine::on_any();
    let start =
        Settings { start: transform().into(), method: parfocal::settings::Method::Aligned, ..Settings::default() };
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &start).unwrap();
    let mask = Some(Mask::from_image(&Frame::gray(SIZE[0], SIZE[1], picture).unwrap()));
    let solution = solver.solve([&i1, &i2], &SolveOptions { mask, ..SolveOptions::default() }).unwrap();
    assert!(solution.valid_fraction > 0.0 && solution.valid_fraction < 0.01, "{}", solution.valid_fraction);
    assert!(!solution.warnings.iter().any(|warning| warning.contains("overlap")), "{:?}", solution.warnings);
}

/// Whether a level settles after the same iteration as in the reference is decided by rounding: of starts that differ
/// by some 1e-6 px, the finest level takes 10 iterations instead of 8 from 5 of 16 with the passes for processors, and
/// from 4 of 16 with those for GPUs. After 8 iterations 0.22 of the pixels still move in the reference, 0.15 to more
/// than 0.25 on the device, and the limit is 0.25. Solutions with the same iterations are compared more closely.
#[test]
fn masks_agree_with_the_reference() {
    let size = [151, 131];
    let [i1, i2] = pair(size, Similarity::new(0.6, -0.4, 0.1, 1.004), slanted(size[0]), 0.0, 5);
    let white = |on: bool| on.then_some(1.0);
    let i1 = stored(&i1, |x, y| white(disks(3, 0)(x, y)));
    let i2 = stored(&i2, |x, y| white(disks(3, 6)(x, y)));
    let picture = (0..size[0] * size[1]).map(|i| if i % size[0] < 30 { 0.0 } else { 1.0 }).collect();
    let mask = Mask::from_image(&Frame::gray(size[0], size[1], picture).unwrap());
    let engine = TestEngine::new();
    let rms = |f: &[f32], e: &[f64]| {
        let squares = f.iter().zip(e).map(|(f, e)| (f64::from(*f) - e).powi(2)).filter(|s| !s.is_nan());
        let squares: Vec<f64> = squares.collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    // Returns whether all levels took as many iterations as in the reference.
    let compare = |start: u32| {
        let start = Similarity::new(1e-6 * f64::from(start), 0.0, 0.0, 1.0).into();
        let settings = Settings { max_relative_blur: Some(9.0), start, ..Settings::default() };
        let expected = reference::solve_masked(&i1, &i2, &settings, Some(&mask)).unwrap();
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &settings).unwrap();
        let options = SolveOptions { mask: Some(mask.clone()), ..SolveOptions::default() };
        let found = solver.solve([&i1, &i2], &options).unwrap();
        let alike = found.levels.iter().map(|level| level.energy.len()).eq(expected.energies.iter().map(Vec::len));
        let v = rms(&found.relative_blur, &expected.relative_blur.data);
        let residual = rms(&found.residual, &expected.residual.data);
        println!("rms against the reference: V {v:.5} px², residual {residual:.7}; the same iterations: {alike}");
        assert!(v < 5e-3 && residual < if alike { 1e-5 } else { 2e-5 });
        assert!(found.transform.corner_distance(expected.transform, size[0], size[1]) < 2e-3);
        alike
    };
    assert!((0..8).any(compare), "other iterations from each start");
}
