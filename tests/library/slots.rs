//! Several pairs under way in one solver, and results lent where the device has left them.

use std::time::Duration;

use parfocal::{Error, Frame, Mask, PairSolver, Region, Settings, Similarity, Solution, SolutionRef, Source};

use crate::common::TestEngine;
use crate::common::scene::pair;

const SIZE: [u32; 2] = [96, 80];

fn pairs() -> Vec<[Frame; 2]> {
    let of = |n: usize| {
        let t = Similarity::new(0.4 * n as f64, -0.3, 0.05, 1.0);
        pair(SIZE, t, |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, 3 + n as u64)
    };
    (0..5).map(of).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn assert_same(found: &SolutionRef<'_>, expected: &Solution) {
    assert_eq!(found.transform, expected.transform);
    assert_eq!(found.valid_fraction, expected.valid_fraction);
    for (found, expected) in [
        (found.relative_blur(), &expected.relative_blur),
        (found.uncertainty(), &expected.uncertainty),
        (found.residual(), &expected.residual),
    ] {
        assert_eq!(bits(found), bits(expected));
    }
    assert_eq!(bits(&found.to_owned().fused), bits(&expected.fused));
    assert!(found.fused(usize::from(found.fused_channels.count() as u16)).is_none());
}

#[test]
fn without_the_fused_image_the_rest_is_the_same() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[0];
    let solve = |fused| {
        let settings = Settings { fused, ..Settings::default() };
        PairSolver::for_pair(&engine, i1, i2, &settings).unwrap().solve(i1, i2).unwrap()
    };
    let (whole, mut found) = (solve(true), solve(false));
    assert_eq!(bits(&found.relative_blur), bits(&whole.relative_blur));
    assert_eq!(bits(&found.uncertainty), bits(&whole.uncertainty));
    assert_eq!(bits(&found.residual), bits(&whole.residual));
    assert!(found.fused.is_empty() && !whole.fused.is_empty());
    found.crop(Region { x: 3, y: 4, width: 20, height: 10 }).unwrap();
    assert!(found.fused.is_empty());
}

#[test]
fn pairs_under_way_side_by_side_come_out_as_one_by_one() {
    let engine = TestEngine::new();
    let (pairs, settings) = (pairs(), Settings::default());
    let formats = [pairs[0][0].format(), pairs[0][1].format()];
    let one_by_one: Vec<Solution> = {
        let mut solver = PairSolver::new(&engine, SIZE[0], SIZE[1], formats, &settings).unwrap();
        pairs.iter().map(|[i1, i2]| solver.solve(i1, i2).unwrap()).collect()
    };
    let mut solver = PairSolver::with_slots(3, &engine, SIZE, formats, &settings).unwrap();
    let mut tickets = Vec::new();
    for (n, [i1, i2]) in pairs.iter().enumerate() {
        tickets.push(solver.submit(n % 3, i1, i2).unwrap());
        if let Some(before) = n.checked_sub(1) {
            let view = solver.wait(&tickets[before], Duration::MAX).unwrap().unwrap();
            assert_same(&view, &one_by_one[before]);
        }
    }
    let last = solver.wait(&tickets[4], Duration::MAX).unwrap().unwrap();
    assert_same(&last, &one_by_one[4]);
    // Its results stand until its slot takes another pair.
    assert_same(&solver.wait(&tickets[4], Duration::ZERO).unwrap().unwrap(), &one_by_one[4]);
    assert!(matches!(solver.wait(&tickets[1], Duration::ZERO), Err(Error::Mismatch(_))), "slot 1 has pair 4");
    assert!(matches!(solver.submit(3, &pairs[0][0], &pairs[0][1]), Err(Error::Mismatch(_))));
    // What is under way when the solver goes is waited for.
    solver.submit(0, &pairs[0][0], &pairs[0][1]).unwrap();
}

#[test]
fn a_pair_may_be_written_where_the_device_reads_it() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[2];
    let settings = Settings { white_level: Some(0.75), ..Settings::default() };
    let mut solver = PairSolver::for_pair(&engine, i1, i2, &settings).unwrap();
    let expected = solver.solve(i1, i2).unwrap();
    for (image, frame) in [i1, i2].into_iter().enumerate() {
        solver.input(0, image).unwrap().copy_from_slice(frame.bytes());
    }
    assert!(solver.input(0, 2).is_err() && solver.input(1, 0).is_err());
    let ticket = solver.submit_sources(0, [Source::Written; 2], &[]).unwrap();
    assert_eq!(ticket.is_fetched(), [false; 2]);
    assert_same(&solver.wait(&ticket, Duration::MAX).unwrap().unwrap(), &expected);
}

#[test]
fn what_a_mask_leaves_out_is_nothing_in_what_is_lent() {
    let engine = TestEngine::new();
    let [i1, i2] = &pairs()[1];
    let left_out = |i: usize| (30..60).contains(&(i % 96)) && i / 96 > 40;
    let picture = (0..96 * 80).map(|i| if left_out(i) { 0.0 } else { 1.0 }).collect();
    let mut solver = PairSolver::for_pair(&engine, i1, i2, &Settings::default()).unwrap();
    solver.set_mask(Some(Mask::from_image(&Frame::gray(96, 80, picture).unwrap()))).unwrap();
    let view = solver.solve_in_place(i1, i2).unwrap();
    let known = view.relative_blur().iter().filter(|v| !v.is_nan()).count();
    assert!((0..96 * 80).filter(|&i| left_out(i)).all(|i| view.relative_blur()[i].is_nan()));
    assert!(view.relative_blur().iter().zip(view.uncertainty()).all(|(v, s)| v.is_nan() == s.is_nan()));
    assert_eq!(view.valid_fraction, known as f64 / (96.0 * 80.0));
    assert!(view.converged, "{:?}", view.warnings);
}
