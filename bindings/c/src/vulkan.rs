//! Engines on a Vulkan device of the embedding program.

use std::ffi::c_void;
use std::mem::transmute;
use std::sync::Arc;

use parfocal::Engine;
use parfocal::interop::ash::vk::{self, Handle};
use parfocal::interop::{ExternalDevice, QueueLock};

use crate::engine::{engine_options, parfocal_engine, parfocal_engine_options};
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::give;
use crate::sized::{Versioned, read};

/// A Vulkan instance and device of the embedding program, both for Vulkan 1.3 or later. The device has the features
/// timelineSemaphore, synchronization2 and maintenance4. Destroy them after all engines, solvers, streams and solutions.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_vulkan {
    /// sizeof(parfocal_vulkan).
    pub size: usize,
    /// The vkGetInstanceProcAddr of the loader that made the instance.
    pub get_instance_proc_addr: *const c_void,
    /// The VkInstance.
    pub instance: *const c_void,
    /// The VkPhysicalDevice.
    pub physical_device: *const c_void,
    /// The VkDevice.
    pub device: *const c_void,
    /// A VkQueue with compute support. Without lock and unlock no other code uses it.
    pub queue: *const c_void,
    /// The queue family index of the queue.
    pub queue_family: u32,
    /// Not 0 if the device was made with VK_EXT_conditional_rendering and its feature conditionalRendering. A solve is then one
    /// submission.
    pub conditional_rendering: i32,
    /// Locks the queue for the calling thread, which calls unlock after one submission. NULL: no other code uses the queue.
    pub lock: Option<unsafe extern "C" fn(context: *mut c_void)>,
    /// Unlocks the queue.
    pub unlock: Option<unsafe extern "C" fn(context: *mut c_void)>,
    /// Passed to lock and unlock, which are called from any thread.
    pub context: *mut c_void,
}

// SAFETY: `repr(C)`, integers, pointers and function pointers, the size first.
unsafe impl Versioned for parfocal_vulkan {
    const NAME: &'static str = "parfocal_vulkan";

    fn start() -> Self {
        let none = std::ptr::null();
        Self {
            size: size_of::<Self>(),
            get_instance_proc_addr: none,
            instance: none,
            physical_device: none,
            device: none,
            queue: none,
            queue_family: 0,
            conditional_rendering: 0,
            lock: None,
            unlock: None,
            context: std::ptr::null_mut(),
        }
    }
}

/// The embedding program's lock of its queue.
struct Lock {
    lock: unsafe extern "C" fn(context: *mut c_void),
    unlock: unsafe extern "C" fn(context: *mut c_void),
    context: *mut c_void,
}

// SAFETY: by the C contract both functions may be called from any thread.
unsafe impl Send for Lock {}
// SAFETY: as for `Send`.
unsafe impl Sync for Lock {}

impl QueueLock for Lock {
    fn lock(&self) {
        // SAFETY: by the C contract it may be called with `context`.
        unsafe { (self.lock)(self.context) }
    }

    fn unlock(&self) {
        // SAFETY: by the C contract it may be called with `context`.
        unsafe { (self.unlock)(self.context) }
    }
}

/// Makes an engine on a device of the embedding program, which keeps owning it. options may be NULL; only timeout_s applies.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_from_vulkan(
    vulkan: *const parfocal_vulkan,
    options: *const parfocal_engine_options,
    engine: *mut *mut parfocal_engine,
) -> parfocal_status {
    let make = || {
        let stated = match options.is_null() {
            true => parfocal_engine_options::start(),
            // SAFETY: by the C contract.
            false => unsafe { read(options) }?,
        };
        // SAFETY: by the C contract.
        let (options, device) = unsafe { (engine_options(&stated)?, external_device(read(vulkan)?)?) };
        Ok(parfocal_engine::of(Engine::from_vulkan(device, &options)?))
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(engine, make) })
}

/// # Safety
/// The C contract holds for all handles.
unsafe fn external_device(of: parfocal_vulkan) -> Result<ExternalDevice, Fault> {
    let handles = [
        ("get_instance_proc_addr", of.get_instance_proc_addr),
        ("instance", of.instance),
        ("physical_device", of.physical_device),
        ("device", of.device),
        ("queue", of.queue),
    ];
    if let Some((name, _)) = handles.iter().find(|(_, handle)| handle.is_null()) {
        return Err(Fault::argument(format!("parfocal_vulkan.{name} is NULL")));
    }
    let raw = |handle: *const c_void| handle as u64;
    // SAFETY: not NULL, so by the C contract that function and valid handles; the lock orders the use of the queue.
    let device = unsafe {
        let entry = transmute::<*const c_void, vk::PFN_vkGetInstanceProcAddr>(of.get_instance_proc_addr);
        ExternalDevice::from_handles(
            entry,
            vk::Instance::from_raw(raw(of.instance)),
            vk::PhysicalDevice::from_raw(raw(of.physical_device)),
            vk::Device::from_raw(raw(of.device)),
            of.queue_family,
            vk::Queue::from_raw(raw(of.queue)),
        )
    };
    // SAFETY: the caller states that the device has the feature.
    let device = if of.conditional_rendering != 0 { unsafe { device.with_conditional_rendering() } } else { device };
    match (of.lock, of.unlock) {
        (None, None) => Ok(device),
        (Some(lock), Some(unlock)) => {
            let lock = Arc::new(Lock { lock, unlock, context: of.context });
            // SAFETY: by the C contract no other code uses the queue between lock and unlock.
            Ok(unsafe { device.with_queue_lock(lock) })
        }
        _ => Err(Fault::argument("parfocal_vulkan has only one of lock and unlock: set both or neither")),
    }
}
