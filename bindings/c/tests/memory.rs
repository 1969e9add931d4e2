//! Pairs one after the other take no more memory. PARFOCAL_PAIRS_OF_MEMORY says how many; 20 without.

#![cfg(target_os = "linux")]

use std::fs;
use std::ptr::{null, null_mut};

use parfocal_c::parfocal_status::PARFOCAL_OK;
use parfocal_c::*;

const SIZE: [u32; 2] = [96, 80];

fn photograph(soft: f32) -> Vec<f32> {
    let value = |i: u32| 0.5 + soft * ((i % SIZE[0]) as f32 * 1.1).sin() * ((i / SIZE[0]) as f32 * 0.9).cos();
    (0..SIZE[0] * SIZE[1]).map(value).collect()
}

/// Bytes, to a page of 4 KiB or more.
fn resident() -> u64 {
    let counts = fs::read_to_string("/proc/self/statm").expect("Linux");
    4096 * counts.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).expect("a count of pages")
}

#[test]
fn pairs_one_after_the_other_take_no_more_memory() {
    let samples = [photograph(0.4), photograph(0.3)];
    let [i1, i2] = samples.each_ref().map(|samples| parfocal_image {
        size: size_of::<parfocal_image>(),
        data: samples.as_ptr().cast(),
        width: SIZE[0],
        height: SIZE[1],
        channels: 1,
        depth: parfocal_depth::PARFOCAL_F32 as u32,
        row_bytes: 0,
    });
    let count = std::env::var("PARFOCAL_PAIRS_OF_MEMORY").ok().and_then(|count| count.parse().ok()).unwrap_or(20);
    // SAFETY: images state their samples, handles are used before they are freed.
    unsafe {
        let (mut engine, mut solver) = (null_mut(), null_mut());
        assert_eq!(parfocal_engine_new(null(), &raw mut engine), PARFOCAL_OK);
        assert_eq!(parfocal_solver_new(engine, null(), &raw mut solver), PARFOCAL_OK);
        let some = |count: u32| {
            for _ in 0..count {
                let mut solution = null_mut();
                let solved = parfocal_solver_solve(solver, &raw const i1, &raw const i2, null(), &raw mut solution);
                assert_eq!(solved, PARFOCAL_OK);
                parfocal_solution_free(solution);
            }
        };
        some(5);
        let before = resident();
        some(count);
        let grown = resident().saturating_sub(before);
        println!("{count} pairs: {grown} bytes more");
        assert!(grown < 8 << 20, "{grown} bytes more after {count} pairs");
        parfocal_solver_free(solver);
        parfocal_engine_free(engine);
    }
}
