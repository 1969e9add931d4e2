//! The logical device, with its compute queue, memory allocator and pipeline cache.

use std::ffi::{CStr, c_char};
use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ash::{ext, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::instance::{Instance, PhysicalDevice, vulkan_error};
use super::interop::{ExternalDevice, QueueGuard, QueueLock, enable_required_features};
use super::pipeline_cache;
use crate::base::{DeviceInfo, Error};

/// Bytes in a mebibyte.
pub(crate) const MIB: u64 = 1 << 20;

/// A Vulkan device with one compute queue.
pub(crate) struct Device {
    pub(super) handle: ash::Device,
    pub(super) physical: PhysicalDevice,
    queue: Arc<Mutex<vk::Queue>>,
    /// Set if the embedding program uses the queue as well.
    queue_lock: Option<Arc<dyn QueueLock>>,
    /// Whether this crate created the handle, and destroys it.
    owns_handle: bool,
    pub(super) pipeline_cache: vk::PipelineCache,
    pub(super) timeout: Duration,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    debug_utils: Option<ext::debug_utils::Device>,
    pub(super) conditional_rendering: Option<ext::conditional_rendering::Device>,
    pub(super) external_memory_host: Option<ext::external_memory_host::Device>,
    /// Whether a wait has failed.
    is_poisoned: AtomicBool,
    /// The number of abandoned submissions that may still be pending.
    abandoned: AtomicUsize,
    pub(crate) instance: Arc<Instance>,
}

impl Device {
    /// Creates a device.
    pub(crate) fn new(
        instance: Arc<Instance>,
        physical: PhysicalDevice,
        timeout: Duration,
    ) -> Result<Arc<Self>, Error> {
        let name = physical.info.name.clone();
        let priorities = [1.0];
        let queues = [vk::DeviceQueueCreateInfo::default()
            .queue_family_index(physical.queue_family)
            .queue_priorities(&priorities)];
        let (mut v12, mut v13) = Default::default();
        enable_required_features(&mut v12, &mut v13);
        let mut conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
        let is_conditional = physical.optional.conditional_rendering;
        let extensions: Vec<*const c_char> = physical.optional.names().map(CStr::as_ptr).collect();
        let mut create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .push_next(&mut v12)
            .push_next(&mut v13);
        if is_conditional {
            create = create.push_next(&mut conditional);
        }
        // SAFETY: the physical device belongs to this instance and has the features (`Instance::missing_requirement`).
        let handle = unsafe { instance.handle.create_device(physical.handle, &create, None) }
            .map_err(|e| vulkan_error("vkCreateDevice", &name, e))?;
        // SAFETY: the device was created with one queue of the family.
        let queue = unsafe { handle.get_device_queue(physical.queue_family, 0) };
        Self::from_handles(instance, physical, (handle, Arc::new(Mutex::new(queue)), None), true, timeout)
    }

    /// Uses a device of the embedding program.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if the device or its queue family lacks a required feature, [`Error::Vulkan`].
    pub(crate) fn external(external: ExternalDevice, timeout: Duration) -> Result<Arc<Self>, Error> {
        let instance = Instance::external(external.instance);
        let mut physical = instance.physical_device(external.physical, external.queue_family)?;
        physical.optional = physical.optional.intersection(external.optional);
        let handles = (external.device, external.queue, external.queue_lock);
        Self::from_handles(instance, physical, handles, false, timeout)
    }

    /// Adds an allocator and a pipeline cache to a device.
    pub(super) fn from_handles(
        instance: Arc<Instance>,
        physical: PhysicalDevice,
        (handle, queue, queue_lock): (ash::Device, Arc<Mutex<vk::Queue>>, Option<Arc<dyn QueueLock>>),
        owns_handle: bool,
        timeout: Duration,
    ) -> Result<Arc<Self>, Error> {
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.handle.clone(),
            device: handle.clone(),
            physical_device: physical.handle,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::default(),
        })
        .map_err(|e| {
            if owns_handle {
                // SAFETY: nothing was created from the device.
                unsafe { handle.destroy_device(None) };
            }
            Error::Vulkan {
                call: "creating the allocator".into(),
                device: physical.info.name.clone(),
                result: e.to_string(),
                advice: "",
            }
        })?;
        let (loader, optional) = (&instance.handle, physical.optional);
        let debug_utils = instance.debug_utils.then(|| ext::debug_utils::Device::new(loader, &handle));
        let conditional_rendering =
            optional.conditional_rendering.then(|| ext::conditional_rendering::Device::new(loader, &handle));
        let external_memory_host =
            optional.host_memory.then(|| ext::external_memory_host::Device::new(loader, &handle));
        let mut device = Self {
            handle,
            physical,
            queue,
            queue_lock,
            owns_handle,
            pipeline_cache: vk::PipelineCache::null(),
            timeout,
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            debug_utils,
            conditional_rendering,
            external_memory_host,
            is_poisoned: AtomicBool::new(false),
            abandoned: AtomicUsize::new(0),
            instance,
        };
        device.pipeline_cache = device.open_pipeline_cache()?;
        Ok(Arc::new(device))
    }

    /// Submits to the queue, under the engine's lock and that of the embedding program.
    pub(super) fn submit(&self, submits: &[vk::SubmitInfo2<'_>]) -> Result<(), vk::Result> {
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let _guard = QueueGuard::new(self.queue_lock.as_deref());
        // SAFETY: the queue is locked; the command buffers are recorded and not pending, since every run waits for its
        // end; their recording retains what they use.
        unsafe { self.handle.queue_submit2(*queue, submits, vk::Fence::null()) }
    }

    /// Describes the device.
    pub(crate) fn info(&self) -> &DeviceInfo {
        &self.physical.info
    }

    /// Returns the time limit of one solve.
    pub(crate) fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Whether the device skips commands by conditional rendering.
    pub(crate) fn is_conditional(&self) -> bool {
        self.conditional_rendering.is_some()
    }

    /// Returns the largest size of an allocation and of a buffer, in bytes.
    pub(crate) fn allocation_limits(&self) -> (u64, u64) {
        let mut v11 = vk::PhysicalDeviceVulkan11Properties::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Properties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut v11).push_next(&mut v13);
        // SAFETY: the physical device belongs to this instance; a 1.3 device fills both structures.
        unsafe { self.instance.handle.get_physical_device_properties2(self.physical.handle, &mut properties) };
        (v11.max_memory_allocation_size, v13.max_buffer_size)
    }

    /// Returns the alignment of imported host memory, in bytes.
    pub(super) fn imported_host_alignment(&self) -> u64 {
        let mut host = vk::PhysicalDeviceExternalMemoryHostPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut host);
        // SAFETY: the physical device belongs to this instance; a device with the extension fills the structure.
        unsafe { self.instance.handle.get_physical_device_properties2(self.physical.handle, &mut properties) };
        host.min_imported_host_pointer_alignment.max(1)
    }

    /// Whether an earlier wait timed out or failed, so that the engine refuses further work.
    pub(crate) fn is_poisoned(&self) -> bool {
        self.is_poisoned.load(Ordering::Acquire)
    }

    /// Refuses further work of a poisoned device by [`Error::Poisoned`].
    pub(crate) fn check_usable(&self) -> Result<(), Error> {
        if self.is_poisoned() { Err(Error::Poisoned) } else { Ok(()) }
    }

    /// Whether an abandoned submission may still be pending, so that nothing of the device may be destroyed.
    pub(super) fn is_in_use(&self) -> bool {
        self.abandoned.load(Ordering::Acquire) > 0
    }

    /// Keeps all objects of the device, since a submission that failed is still pending.
    pub(super) fn abandon(&self) {
        self.abandoned.fetch_add(1, Ordering::AcqRel);
    }

    /// Refuses further work after a failed wait.
    pub(super) fn poison(&self) {
        self.is_poisoned.store(true, Ordering::Release);
    }

    pub(super) fn allocator(&self) -> MutexGuard<'_, Allocator> {
        self.allocator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Converts the result of a Vulkan call into one whose error names the call and the device.
    pub(super) fn check<T>(&self, call: &str, result: Result<T, vk::Result>) -> Result<T, Error> {
        result.map_err(|e| vulkan_error(call, &self.physical.info.name, e))
    }

    /// Names an object in validation messages and debuggers.
    pub(super) fn name(&self, object: impl vk::Handle, name: &str) {
        let (Some(names), Ok(name)) = (&self.debug_utils, std::ffi::CString::new(name)) else { return };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: the object belongs to this device, and only this thread uses it yet. A failure is ignored, since
        // names are only diagnostics.
        let _ = unsafe { names.set_debug_utils_object_name(&info) };
    }

    fn open_pipeline_cache(&self) -> Result<vk::PipelineCache, Error> {
        let data = pipeline_cache::read(&self.physical).unwrap_or_default();
        let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: `data` outlives the call; its header matches this driver, and its checksum is right
        // (`pipeline_cache::read`).
        let created = unsafe { self.handle.create_pipeline_cache(&create, None) };
        self.check("vkCreatePipelineCache", created)
    }

    /// Writes the pipeline cache to disk for the next engine. Failures are ignored: the next engine then compiles
    /// again.
    pub(crate) fn save_pipeline_cache(&self) {
        // SAFETY: the cache belongs to this device.
        if let Ok(data) = unsafe { self.handle.get_pipeline_cache_data(self.pipeline_cache) } {
            pipeline_cache::write(&self.physical, &data);
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if self.is_in_use() {
            // The device may still use its objects, so they are leaked, with the instance.
            std::mem::forget(self.instance.clone());
            return;
        }
        // SAFETY: everything created from the device held an Arc to it and is dropped, and its submissions are
        // complete. The allocator frees its memory before the device is destroyed, and is not used again.
        unsafe {
            if self.owns_handle {
                // A failure, such as a lost device, does not prevent the destruction.
                let _ = self.handle.device_wait_idle();
            }
            self.handle.destroy_pipeline_cache(self.pipeline_cache, None);
            ManuallyDrop::drop(&mut self.allocator);
            if self.owns_handle {
                self.handle.destroy_device(None);
            }
        }
    }
}
