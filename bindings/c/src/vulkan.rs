//! A Vulkan device that belongs to the embedding program.

use std::ffi::c_void;
use std::mem::transmute;
use std::sync::Arc;

use parfocal::Engine;
use parfocal::interop::ash::vk::{self, Handle};
use parfocal::interop::{ExternalDevice, QueueLock};

use crate::engine::{parfocal_engine, parfocal_engine_options, told};
use crate::fault::{Fault, call, parfocal_status};
use crate::handle::give;
use crate::sized::{Versioned, read};

/// An instance and a device of the program's, both made for Vulkan 1.3 or later, the device with the features timelineSemaphore, synchronization2
/// and maintenance4. They are not destroyed before the last engine, solver, stream and solution of them is freed.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_vulkan {
    /// sizeof(parfocal_vulkan).
    pub size: usize,
    /// The vkGetInstanceProcAddr that the instance came by.
    pub get_instance_proc_addr: *const c_void,
    /// The VkInstance.
    pub instance: *const c_void,
    /// The VkPhysicalDevice.
    pub physical_device: *const c_void,
    /// The VkDevice.
    pub device: *const c_void,
    /// A VkQueue of it that computes, which nobody else uses, unless all do between lock and unlock.
    pub queue: *const c_void,
    /// Its family.
    pub queue_family: u32,
    /// Not 0 where the device was made with VK_EXT_conditional_rendering and its feature conditionalRendering: a solve is then one submission.
    pub conditional_rendering: i32,
    /// Waits until nobody else uses the queue, and keeps others from it until unlock is called, by the same thread, after one submission;
    /// NULL: nobody else uses it.
    pub lock: Option<unsafe extern "C" fn(context: *mut c_void)>,
    /// Lets others have the queue.
    pub unlock: Option<unsafe extern "C" fn(context: *mut c_void)>,
    /// What both are called with, from any thread.
    pub context: *mut c_void,
}

// SAFETY: integers and pointers, those to functions among them, the size first.
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

/// The program's lock of its queue.
struct Lock {
    lock: unsafe extern "C" fn(context: *mut c_void),
    unlock: unsafe extern "C" fn(context: *mut c_void),
    context: *mut c_void,
}

// SAFETY: both functions may be called from any thread, as the header says.
unsafe impl Send for Lock {}
// SAFETY: likewise.
unsafe impl Sync for Lock {}

impl QueueLock for Lock {
    fn lock(&self) {
        // SAFETY: it may be called so, as the header says.
        unsafe { (self.lock)(self.context) }
    }

    fn unlock(&self) {
        // SAFETY: likewise.
        unsafe { (self.unlock)(self.context) }
    }
}

/// An engine on a device of the program's, which keeps it; of the options, which may be NULL, timeout_s counts alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_from_vulkan(
    vulkan: *const parfocal_vulkan,
    options: *const parfocal_engine_options,
    engine: *mut *mut parfocal_engine,
) -> parfocal_status {
    let make = || {
        let asked = match options.is_null() {
            true => parfocal_engine_options::start(),
            // SAFETY: the contract is the same.
            false => unsafe { read(options) }?,
        };
        // SAFETY: the contract is the same.
        let (options, device) = unsafe { (told(&asked)?, foreign(read(vulkan)?)?) };
        Ok(parfocal_engine::of(Engine::from_vulkan(device, &options)?))
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(engine, make) })
}

/// # Safety
/// The handles are NULL, or what the header says that they are.
unsafe fn foreign(of: parfocal_vulkan) -> Result<ExternalDevice, Fault> {
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
    // SAFETY: not NULL, and that function, as the header says; the handles are valid, and the queue is used by turns.
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
    // SAFETY: the device was made so.
    let device = if of.conditional_rendering != 0 { unsafe { device.with_conditional_rendering() } } else { device };
    match (of.lock, of.unlock) {
        (None, None) => Ok(device),
        (Some(lock), Some(unlock)) => {
            let lock = Arc::new(Lock { lock, unlock, context: of.context });
            // SAFETY: nobody else uses the queue in between.
            Ok(unsafe { device.with_queue_lock(lock) })
        }
        _ => Err(Fault::argument("parfocal_vulkan has one of lock and unlock: give both, or none")),
    }
}
