//! Tests that memory does not grow with the number of pairs. `PARFOCAL_PAIRS_OF_MEMORY` sets the number (default 20).

#![cfg(target_os = "linux")]

use std::fs;
use std::ptr::{null, null_mut};

use parfocal_c::parfocal_status::{PARFOCAL_ERROR_FULL, PARFOCAL_OK};
use parfocal_c::*;

const SIZE: [u32; 2] = [96, 80];

fn photograph(soft: f32) -> Vec<f32> {
    let value = |i: u32| 0.5 + soft * ((i % SIZE[0]) as f32 * 1.1).sin() * ((i / SIZE[0]) as f32 * 0.9).cos();
    (0..SIZE[0] * SIZE[1]).map(value).collect()
}

/// Returns the resident memory in bytes. It assumes pages of 4 KiB.
fn resident() -> u64 {
    let counts = fs::read_to_string("/proc/self/statm").expect("Linux");
    4096 * counts.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).expect("a count of pages")
}

fn count() -> u32 {
    std::env::var("PARFOCAL_PAIRS_OF_MEMORY").ok().and_then(|count| count.parse().ok()).unwrap_or(20)
}

/// Asserts that memory does not grow after the first 12 pairs. `some` solves a number of pairs.
fn assert_flat(what: &str, mut some: impl FnMut(u32)) {
    some(12);
    let before = resident();
    some(count());
    let grown = resident().saturating_sub(before);
    println!("{} pairs {what}: {} KiB after 12, {} KiB more", count(), before >> 10, grown >> 10);
    assert!(grown < 8 << 20, "{grown} bytes more after {} pairs {what}", count());
}

/// This is one test, because both parts measure the memory of the whole process.
#[test]
fn memory_does_not_grow_with_the_number_of_pairs() {
    let samples = [photograph(0.4), photograph(0.3)];
    let [i1, i2] = samples.each_ref().map(|samples| parfocal_image {
        size: size_of::<parfocal_image>(),
        data: samples.as_ptr().cast(),
        width: SIZE[0],
        height: SIZE[1],
        channels: 1,
        depth: parfocal_depth::PARFOCAL_F32 as u32,
        row_bytes: 0,
        format: std::ptr::null(),
    });
    let [i1, i2] = [&raw const i1, &raw const i2];
    let mut engine = null_mut();
    // SAFETY: the images describe their samples. No handle is used after it is freed.
    unsafe {
        assert_eq!(parfocal_engine_new(null(), &raw mut engine), PARFOCAL_OK);
        by_a_solver(engine, [i1, i2]);
        through_a_stream(engine, [i1, i2]);
        parfocal_engine_free(engine);
    }
}

/// # Safety
/// The engine is valid, and the images describe their samples.
unsafe fn by_a_solver(engine: *const parfocal_engine, [i1, i2]: [*const parfocal_image; 2]) {
    let mut solver = null_mut();
    // SAFETY: the contract is the same.
    assert_eq!(unsafe { parfocal_solver_new(engine, null(), &raw mut solver) }, PARFOCAL_OK);
    assert_flat("by a solver", |count| {
        for _ in 0..count {
            let mut solution = null_mut();
            // SAFETY: as before.
            unsafe {
                assert_eq!(parfocal_solver_solve(solver, i1, i2, null(), &raw mut solution), PARFOCAL_OK);
                parfocal_solution_free(solution);
            }
        }
    });
    // SAFETY: it is used no more.
    unsafe { parfocal_solver_free(solver) };
}

/// # Safety
/// The same as for [`by_a_solver`].
unsafe fn through_a_stream(engine: *const parfocal_engine, [i1, i2]: [*const parfocal_image; 2]) {
    let mut stream = null_mut();
    // SAFETY: the contract is the same.
    let made = unsafe { parfocal_stream_new(&raw const engine, 1, 3, i1, i2, null(), &raw mut stream) };
    assert_eq!(made, PARFOCAL_OK);
    // SAFETY: as before.
    let read = || unsafe {
        let mut solution = null_mut();
        assert_eq!(parfocal_stream_next(stream, f64::INFINITY, &raw mut solution), PARFOCAL_OK);
        parfocal_solution_free(solution);
        !solution.is_null()
    };
    assert_flat("through a stream", |count| {
        for _ in 0..count {
            // SAFETY: as before.
            while unsafe { parfocal_stream_push(stream, i1, i2, 0.0) } == PARFOCAL_ERROR_FULL {
                read();
            }
        }
        // SAFETY: as before.
        assert_eq!(unsafe { parfocal_stream_finish(stream) }, PARFOCAL_OK);
        while read() {}
    });
    // SAFETY: it is used no more.
    unsafe { parfocal_stream_free(stream) };
}
