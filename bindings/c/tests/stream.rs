//! Tests of streams in C: results in order, equal to those of a solver bit for bit, and a status for a failed pair.

use std::ffi::CStr;
use std::ptr::{null, null_mut};

use parfocal_c::parfocal_status::*;
use parfocal_c::*;

const SIZE: [u32; 2] = [64, 48];
const NONE: f64 = 0.0;

fn photograph(soft: f32) -> Vec<f32> {
    let value = |i: u32| 0.5 + soft * ((i % SIZE[0]) as f32 * 1.1).sin() * ((i / SIZE[0]) as f32 * 0.9).cos();
    (0..SIZE[0] * SIZE[1]).map(value).collect()
}

fn image(samples: &[f32], height: u32) -> parfocal_image {
    let (size, data, depth) =
        (size_of::<parfocal_image>(), samples.as_ptr().cast(), parfocal_depth::PARFOCAL_F32 as u32);
    parfocal_image { size, data, width: SIZE[0], height, channels: 1, depth, row_bytes: 0, format: std::ptr::null() }
}

/// Returns V of a solution in bits, and frees the solution.
///
/// # Safety
/// The solution is from a solve and not yet freed.
unsafe fn blur(solution: *mut parfocal_solution) -> Vec<u32> {
    // SAFETY: fields live until the solution is freed, and have `width * height` values.
    unsafe {
        let mut found = std::mem::zeroed::<parfocal_solution_view>();
        found.size = size_of::<parfocal_solution_view>();
        assert_eq!(parfocal_solution_get(solution, &raw mut found), PARFOCAL_OK);
        let pixels = (found.width * found.height) as usize;
        let values = std::slice::from_raw_parts(found.relative_blur, pixels).iter().map(|v| v.to_bits()).collect();
        parfocal_solution_free(solution);
        values
    }
}

#[test]
fn results_are_in_order_and_equal_those_of_a_solver() {
    let validation = std::env::var_os("PARFOCAL_VALIDATE").is_some_and(|value| value == "1");
    let options = parfocal_engine_options {
        size: size_of::<parfocal_engine_options>(),
        device: null(),
        timeout_s: 0.0,
        validation: validation.into(),
    };
    let near = photograph(0.4);
    let far = [0.1, 0.2, 0.3].map(photograph);
    let i1 = image(&near, SIZE[1]);
    let others = [&far[0], &far[1], &far[2]].map(|far| image(far, SIZE[1]));
    let small = image(&near, SIZE[1] - 8);
    let (mut engine, mut solver, mut stream, mut solution) = (null_mut(), null_mut(), null_mut(), null_mut());
    // SAFETY: structs have their sizes, and images describe their samples. No handle is used after it is freed.
    unsafe {
        assert_eq!(parfocal_engine_new(&raw const options, &raw mut engine), PARFOCAL_OK);
        assert_eq!(parfocal_solver_new(engine, null(), &raw mut solver), PARFOCAL_OK);
        let expected = others.each_ref().map(|i2| {
            let mut solution = null_mut();
            assert_eq!(parfocal_solver_solve(solver, &raw const i1, i2, null(), &raw mut solution), PARFOCAL_OK);
            blur(solution)
        });
        // `parfocal_stream_new` does not read pixels, so `data` may be NULL.
        let kind = parfocal_image { data: null(), ..i1 };
        let engines = [engine.cast_const(); 2];
        let mut new = |count, i2: &parfocal_image| {
            let i2 = &raw const *i2;
            parfocal_stream_new(engines.as_ptr(), count, 1, &raw const kind, i2, null(), &raw mut stream)
        };
        assert_eq!(new(0, &kind), PARFOCAL_ERROR_NO_DEVICE);
        assert_eq!(new(1, &small), PARFOCAL_ERROR_INVALID_ARGUMENT);
        assert_eq!(new(2, &kind), PARFOCAL_OK);
        assert_eq!((parfocal_stream_capacity(stream), parfocal_stream_length(stream)), (4, 0));
        let push = |i2: &parfocal_image| parfocal_stream_push(stream, &raw const i1, &raw const *i2, NONE);
        let next = |seconds| {
            let mut solution = null_mut();
            (parfocal_stream_next(stream, seconds, &raw mut solution), solution)
        };
        assert_eq!(next(NONE), (PARFOCAL_OK, null_mut()), "a result before the first push");
        for i2 in [&others[0], &others[1], &small, &others[2]] {
            assert_eq!(push(i2), PARFOCAL_OK);
        }
        assert_eq!(push(&others[0]), PARFOCAL_ERROR_FULL);
        assert!(CStr::from_ptr(parfocal_last_error()).to_string_lossy().contains("read a result"));
        for wrong in [-1.0, f64::NAN] {
            assert_eq!(next(wrong).0, PARFOCAL_ERROR_INVALID_ARGUMENT);
        }
        assert_eq!(parfocal_stream_finish(stream), PARFOCAL_OK);
        // The solver and the stream keep the engine alive.
        parfocal_engine_free(engine);
        for expected in [Some(&expected[0]), Some(&expected[1]), None, Some(&expected[2])] {
            let (status, solution) = next(f64::INFINITY);
            assert_eq!(status, if expected.is_some() { PARFOCAL_OK } else { PARFOCAL_ERROR_MISMATCH });
            expected.inspect(|expected| assert!(blur(solution) == **expected));
        }
        assert_eq!(next(f64::INFINITY), (PARFOCAL_OK, null_mut()), "a result after the last one");
        // The stream is freed with pairs in flight. A solution outlives it.
        assert_eq!((push(&others[0]), push(&others[1])), (PARFOCAL_OK, PARFOCAL_OK));
        assert_eq!(parfocal_stream_next(stream, f64::INFINITY, &raw mut solution), PARFOCAL_OK);
        parfocal_stream_free(stream);
        assert!(blur(solution) == expected[0]);
        parfocal_solver_free(solver);
    }
}
