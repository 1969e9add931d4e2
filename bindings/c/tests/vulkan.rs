//! Tests of an engine on a Vulkan device that a C program created.

use std::ffi::{CStr, c_void};
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicU32, Ordering};

use parfocal::interop::ash::vk::{self, Handle};
use parfocal::interop::{DeviceRequirements, ash};
use parfocal_c::parfocal_status::*;
use parfocal_c::*;

const SIZE: u32 = 64;

fn photograph(soft: f32) -> Vec<f32> {
    let value = |i: u32| 0.5 + soft * ((i % SIZE) as f32 * 1.1).sin() * ((i / SIZE) as f32 * 0.9).cos();
    (0..SIZE * SIZE).map(value).collect()
}

fn image(samples: &[f32]) -> parfocal_image {
    parfocal_image {
        size: size_of::<parfocal_image>(),
        data: samples.as_ptr().cast(),
        width: SIZE,
        height: SIZE,
        channels: 1,
        depth: parfocal_depth::PARFOCAL_F32 as u32,
        row_bytes: 0,
        format: null(),
    }
}

/// Returns V in bits as the engine solves it, and frees the engine.
///
/// # Safety
/// The engine is valid and not used afterwards.
unsafe fn solved(engine: *mut parfocal_engine) -> Vec<u32> {
    let samples = [photograph(0.4), photograph(0.3)];
    let [i1, i2] = samples.each_ref().map(|samples| image(samples));
    let (mut solver, mut solution) = (null_mut(), null_mut());
    // SAFETY: the images describe their samples. No handle is used after it is freed.
    unsafe {
        assert_eq!(parfocal_solver_new(engine, null(), &raw mut solver), PARFOCAL_OK);
        assert_eq!(parfocal_solver_solve(solver, &raw const i1, &raw const i2, null(), &raw mut solution), PARFOCAL_OK);
        let mut found = std::mem::zeroed::<parfocal_solution_view>();
        found.size = size_of::<parfocal_solution_view>();
        assert_eq!(parfocal_solution_get(solution, &raw mut found), PARFOCAL_OK);
        let blur = std::slice::from_raw_parts(found.relative_blur, (SIZE * SIZE) as usize);
        let bits = blur.iter().map(|v| v.to_bits()).collect();
        parfocal_solution_free(solution);
        parfocal_solver_free(solver);
        parfocal_engine_free(engine);
        bits
    }
}

unsafe extern "C" fn lock(context: *mut c_void) {
    // SAFETY: the context points to the counter.
    assert_eq!(unsafe { &*context.cast::<AtomicU32>() }.fetch_add(1, Ordering::SeqCst) % 2, 0);
}

unsafe extern "C" fn unlock(context: *mut c_void) {
    // SAFETY: the context points to the counter.
    assert_eq!(unsafe { &*context.cast::<AtomicU32>() }.fetch_add(1, Ordering::SeqCst) % 2, 1);
}

#[test]
fn an_engine_on_a_shared_device_has_equal_results_and_reports_missing_fields() {
    let lock_calls = AtomicU32::new(0);
    // SAFETY: the structs that are pointed to outlive the calls. The device outlives the engine.
    unsafe {
        let mut own = null_mut();
        let options = parfocal_engine_options {
            size: size_of::<parfocal_engine_options>(),
            device: c"vulkan".as_ptr(),
            timeout_s: 0.0,
            validation: 0,
        };
        assert_eq!(parfocal_engine_new(&raw const options, &raw mut own), PARFOCAL_OK);
        let expected = solved(own);
        let entry = ash::Entry::load().unwrap();
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let create = vk::InstanceCreateInfo::default().application_info(&application);
        let instance = entry.create_instance(&create, None).unwrap();
        let physical = instance.enumerate_physical_devices().unwrap()[0];
        let mut requirements = DeviceRequirements::for_device(&instance, physical).unwrap();
        let extensions: Vec<_> = requirements.extensions().into_iter().map(CStr::as_ptr).collect();
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(0).queue_priorities(&[1.0])];
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
        let device = instance.create_device(physical, &requirements.enable_features(create), None).unwrap();
        let pointer = |raw: u64| raw as *const c_void;
        let vulkan = parfocal_vulkan {
            size: size_of::<parfocal_vulkan>(),
            get_instance_proc_addr: entry.static_fn().get_instance_proc_addr as *const c_void,
            instance: pointer(instance.handle().as_raw()),
            physical_device: pointer(physical.as_raw()),
            device: pointer(device.handle().as_raw()),
            queue: pointer(device.get_device_queue(0, 0).as_raw()),
            queue_family: 0,
            conditional_rendering: 0,
            lock: Some(lock),
            unlock: Some(unlock),
            context: (&raw const lock_calls).cast_mut().cast(),
        };
        let mut engine = null_mut();
        let last_error = || CStr::from_ptr(parfocal_last_error()).to_string_lossy().into_owned();
        for (incomplete, words) in [
            (parfocal_vulkan { queue: null(), ..vulkan }, "parfocal_vulkan.queue is NULL"),
            (parfocal_vulkan { unlock: None, ..vulkan }, "set both or neither"),
        ] {
            let status = parfocal_engine_from_vulkan(&raw const incomplete, null(), &raw mut engine);
            assert!(
                status == PARFOCAL_ERROR_INVALID_ARGUMENT && engine.is_null() && last_error().contains(words),
                "{}",
                last_error()
            );
        }
        let other = parfocal_vulkan { queue_family: 99, ..vulkan };
        assert_eq!(parfocal_engine_from_vulkan(&raw const other, null(), &raw mut engine), PARFOCAL_ERROR_NO_DEVICE);
        assert_eq!(
            parfocal_engine_from_vulkan(&raw const vulkan, null(), &raw mut engine),
            PARFOCAL_OK,
            "{}",
            last_error()
        );
        assert!(solved(engine) == expected);
        let lock_calls = lock_calls.load(Ordering::SeqCst);
        assert!(lock_calls > 0 && lock_calls.is_multiple_of(2));
        device.destroy_device(None);
        instance.destroy_instance(None);
    }
}
