//! Tests that invalid arguments from C give a status and a message, and never a crash.

use std::ffi::{CStr, CString};
use std::ptr::{null, null_mut};

use parfocal_c::parfocal_status::*;
use parfocal_c::*;

fn last_error() -> String {
    // SAFETY: the string is valid until the next call on this thread, and it is copied at once.
    unsafe { CStr::from_ptr(parfocal_last_error()) }.to_string_lossy().into_owned()
}

fn image(samples: &[u8], width: u32, height: u32) -> parfocal_image {
    let size = size_of::<parfocal_image>();
    parfocal_image {
        size,
        data: samples.as_ptr().cast(),
        width,
        height,
        channels: 1,
        depth: 0,
        row_bytes: 0,
        format: null(),
    }
}

#[test]
fn null_is_reported_or_ignored() {
    // SAFETY: every function accepts NULL.
    unsafe {
        parfocal_engine_free(null_mut());
        parfocal_solver_free(null_mut());
        parfocal_solution_free(null_mut());
        parfocal_sweep_free(null_mut());
        parfocal_stream_free(null_mut());
        parfocal_cancellation_token_free(null_mut());
        assert_eq!(parfocal_stream_capacity(null()) + parfocal_stream_length(null()), 0);
        assert_eq!(CStr::from_ptr(parfocal_engine_device(null())), c"");
        assert_eq!(CStr::from_ptr(parfocal_engine_messages(null())), c"");
        assert!(parfocal_solution_warning(null(), 0).is_null() && parfocal_sweep_warning(null(), 0).is_null());
        let (mut solver, mut solution, mut sweep) = (null_mut(), null_mut(), null_mut());
        let (mut stream, nothing, field) = (null_mut(), null(), null());
        let region = parfocal_region { x: 0, y: 0, width: 1, height: 1 };
        for status in [
            parfocal_engine_new(null(), null_mut()),
            parfocal_engine_from_vulkan(null(), null(), null_mut()),
            parfocal_settings_init(null_mut()),
            parfocal_solver_new(null(), null(), &raw mut solver),
            parfocal_solver_new(null(), null(), null_mut()),
            parfocal_solver_solve(null_mut(), null(), null(), null(), &raw mut solution),
            parfocal_solver_register(null_mut(), null(), null(), &raw mut solution),
            parfocal_solution_get(null(), null_mut()),
            parfocal_solution_depth(null(), null(), null_mut(), null_mut(), 0),
            parfocal_solution_apply(null(), null(), 0, null_mut(), 0),
            parfocal_stream_new(null(), 1, 3, null(), null(), null(), &raw mut stream),
            parfocal_stream_new(&raw const nothing, 1, 3, null(), null(), null(), &raw mut stream),
            parfocal_stream_push(null(), null(), null(), 0.0),
            parfocal_stream_next(null(), 0.0, &raw mut solution),
            parfocal_stream_next(null(), 0.0, null_mut()),
            parfocal_stream_finish(null()),
            parfocal_cancellation_token_new(null_mut()),
            parfocal_cancellation_token_cancel(null()),
            parfocal_sweep_solve(null(), null(), 0, null(), null(), null(), &raw mut sweep),
            parfocal_sweep_get(null(), null_mut()),
            parfocal_sweep_transform(null(), 0, null_mut()),
            parfocal_sweep_parallax(null(), 0, null_mut()),
            parfocal_sweep_apply(null(), 0, null(), 0, null_mut(), 0),
            parfocal_measure_step(null(), 4, 4, region, region, null_mut()),
            parfocal_measure_profile(null(), 4, 4, 0.0, 0.0, 3.0, 0.0, 1.0, null_mut(), 4),
            parfocal_roughness_options_init(null_mut()),
            parfocal_measure_roughness(null(), null(), 4, 4, null(), null_mut()),
            parfocal_measure_repeatability(null(), null(), 2, 4, 4, null(), null(), 0, null_mut()),
            parfocal_measure_repeatability(&raw const field, &raw const field, 1, 4, 4, null(), null(), 0, null_mut()),
        ] {
            assert_eq!(status, PARFOCAL_ERROR_INVALID_ARGUMENT);
            assert!(last_error().contains("NULL"), "{}", last_error());
        }
        assert!(solver.is_null() && solution.is_null() && sweep.is_null() && stream.is_null());
    }
    assert_eq!(parfocal_profile_length(0.0, 0.0, f64::NAN, 1.0), 0);
}

#[test]
fn invalid_arguments_are_reported_and_the_engine_stays_usable() {
    let options = |device: Option<&CString>, validation| parfocal_engine_options {
        size: size_of::<parfocal_engine_options>(),
        device: device.map_or(null(), |device| device.as_ptr()),
        timeout_s: 0.0,
        validation,
    };
    let validation = std::env::var_os("PARFOCAL_VALIDATE").is_some_and(|value| value == "1");
    let nowhere = CString::new("no such device").expect("a string");
    let samples: Vec<u8> = (0..64 * 48).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let (i1, small) = (image(&samples, 64, 48), image(&samples, 48, 64));
    let (mut engine, mut solver, mut solution) = (null_mut(), null_mut(), null_mut());
    // SAFETY: structs have their sizes, and images describe their samples. No handle is used after it is freed.
    unsafe {
        assert_eq!(parfocal_engine_new(&options(Some(&nowhere), 0), &raw mut engine), PARFOCAL_ERROR_NO_DEVICE);
        assert!(engine.is_null() && last_error().contains("no such device"), "{}", last_error());
        assert_eq!(parfocal_engine_new(&options(None, validation.into()), &raw mut engine), PARFOCAL_OK);

        let mut settings = std::mem::zeroed::<parfocal_settings>();
        assert_eq!(parfocal_settings_init(&raw mut settings), PARFOCAL_ERROR_INVALID_ARGUMENT);
        assert!(last_error().contains("sizeof(parfocal_settings)"), "{}", last_error());
        settings.size = size_of::<parfocal_settings>();
        assert_eq!(parfocal_settings_init(&raw mut settings), PARFOCAL_OK);
        let levels = std::mem::replace(&mut settings.levels, 99);
        assert_eq!(parfocal_solver_new(engine, &raw const settings, &raw mut solver), PARFOCAL_ERROR_INVALID_SETTING);
        settings.levels = levels;
        assert_eq!(parfocal_solver_new(engine, &raw const settings, &raw mut solver), PARFOCAL_OK);

        let mut solve = |i1: &parfocal_image, i2: &parfocal_image, scope: Option<&parfocal_solve_options>| {
            let scope = scope.map_or(null(), |scope| &raw const *scope);
            parfocal_solver_solve(solver, &raw const *i1, &raw const *i2, scope, &raw mut solution)
        };
        assert_eq!(solve(&i1, &small, None), PARFOCAL_ERROR_MISMATCH);
        assert_eq!(solve(&image(&samples, 4, 4), &image(&samples, 4, 4), None), PARFOCAL_ERROR_TOO_SMALL);
        let region = parfocal_region { x: 60, y: 0, width: 10, height: 10 };
        let (size, mask, context, cancel) = (size_of::<parfocal_solve_options>(), null(), null_mut(), null());
        let scope = parfocal_solve_options { size, region, mask, crop_valid: 0, progress: None, context, cancel };
        assert_eq!(solve(&i1, &i1, Some(&scope)), PARFOCAL_ERROR_INVALID_REGION);
        assert_eq!(solve(&i1, &i1, None), PARFOCAL_OK);
        parfocal_engine_free(engine);
        parfocal_solution_free(solution);
        assert_eq!(parfocal_solver_register(solver, &raw const i1, &raw const i1, &raw mut solution), PARFOCAL_OK);

        let mut found = std::mem::zeroed::<parfocal_solution_view>();
        found.size = size_of::<parfocal_solution_view>();
        assert_eq!(parfocal_solution_get(solution, &raw mut found), PARFOCAL_OK);
        assert!(found.relative_blur.is_null() && found.width == 64);
        let mut moved = vec![0u8; 64 * 48];
        let out = moved.as_mut_ptr().cast();
        assert_eq!(
            parfocal_solution_apply(solution, &raw const i1, 0, out, 64 * 48 - 1),
            PARFOCAL_ERROR_INVALID_ARGUMENT
        );
        assert_eq!(parfocal_solution_apply(solution, &raw const small, 0, out, 64 * 48), PARFOCAL_ERROR_MISMATCH);
        assert_eq!(parfocal_solution_apply(solution, &raw const i1, 0, out, 64 * 48), PARFOCAL_OK);
        parfocal_solution_free(solution);
        parfocal_solver_free(solver);
    }
}
