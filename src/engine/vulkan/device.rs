//! The logical device: its queue, its allocator, its clock.

use std::ffi::{CStr, c_char};
use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ash::{ext, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::cache;
use super::device_requirements;
use super::failure::failure;
use super::instance::{Instance, PhysicalDevice};
use super::interop::{ExternalDevice, QueueGuard, QueueLock};
use crate::base::{DeviceInfo, Error};

/// Bytes in a mebibyte.
pub(crate) const MIB: u64 = 1 << 20;

/// A Vulkan device with one compute queue.
pub(crate) struct Device {
    pub(super) handle: ash::Device,
    pub(super) physical: PhysicalDevice,
    queue: Arc<Mutex<vk::Queue>>,
    /// SharedQueue at the queue, where others use it too.
    lock: Option<Arc<dyn QueueLock>>,
    /// Whether it was opened here, and goes with this.
    is_own: bool,
    pub(super) pipeline_cache: vk::PipelineCache,
    pub(super) timeout: Duration,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    names: Option<ext::debug_utils::Device>,
    /// Where the device can leave commands out by itself.
    pub(super) conditional: Option<ext::conditional_rendering::Device>,
    /// Where the device can read memory of the host where it is.
    pub(super) external_host: Option<ext::external_memory_host::Device>,
    poisoned: AtomicBool,
    /// Runs that were given up and may still be at work.
    abandoned: AtomicUsize,
    pub(crate) instance: Arc<Instance>,
}

impl Device {
    /// Opens a physical device.
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
        device_requirements::require(&mut v12, &mut v13);
        let mut conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
        let is_conditional = physical.liked.conditional;
        let extensions: Vec<*const c_char> = physical.liked.extensions().map(CStr::as_ptr).collect();
        let mut create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .push_next(&mut v12)
            .push_next(&mut v13);
        if is_conditional {
            create = create.push_next(&mut conditional);
        }
        // SAFETY: the physical device came from this instance and has the features (`Instance::missing`).
        let handle = unsafe { instance.handle.create_device(physical.handle, &create, None) }
            .map_err(|e| failure("vkCreateDevice", &name, e))?;
        // SAFETY: the family was asked for above, with one queue.
        let queue = unsafe { handle.get_device_queue(physical.queue_family, 0) };
        Self::around(instance, physical, (handle, Arc::new(Mutex::new(queue)), None), true, timeout)
    }

    /// Takes a device that is someone else's.
    pub(crate) fn foreign(of: ExternalDevice, timeout: Duration) -> Result<Arc<Self>, Error> {
        let instance = Instance::foreign(of.instance);
        let mut physical = instance.described(of.physical, of.queue_family)?;
        physical.liked = physical.liked.and(of.liked);
        Self::around(instance, physical, (of.device, of.queue, of.lock), false, timeout)
    }

    /// An allocator and a pipeline cache for an open device.
    fn around(
        instance: Arc<Instance>,
        physical: PhysicalDevice,
        (handle, queue, lock): (ash::Device, Arc<Mutex<vk::Queue>>, Option<Arc<dyn QueueLock>>),
        is_own: bool,
        timeout: Duration,
    ) -> Result<Arc<Self>, Error> {
        let (name, is_conditional) = (physical.info.name.clone(), physical.liked.conditional);
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.handle.clone(),
            device: handle.clone(),
            physical_device: physical.handle,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::default(),
        })
        .map_err(|e| Error::Vulkan {
            call: "opening the allocator".into(),
            device: name.clone(),
            result: e.to_string(),
            advice: "",
        });
        let allocator = match allocator {
            Ok(allocator) => allocator,
            Err(error) => {
                if is_own {
                    // SAFETY: nothing was made from the device yet.
                    unsafe { handle.destroy_device(None) };
                }
                return Err(error);
            }
        };
        let names = instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.handle, &handle));
        let conditional = is_conditional.then(|| ext::conditional_rendering::Device::new(&instance.handle, &handle));
        let external_host =
            physical.liked.host_memory.then(|| ext::external_memory_host::Device::new(&instance.handle, &handle));
        let mut device = Self {
            handle,
            physical,
            queue,
            lock,
            is_own,
            pipeline_cache: vk::PipelineCache::null(),
            timeout,
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            names,
            conditional,
            external_host,
            poisoned: AtomicBool::new(false),
            abandoned: AtomicUsize::new(0),
            instance,
        };
        device.pipeline_cache = device.open_pipeline_cache()?;
        Ok(Arc::new(device))
    }

    /// Hands work to the queue, one thread at a time, and where others use it too, when it is this one's turn.
    pub(super) fn submit(&self, submits: &[vk::SubmitInfo2<'_>]) -> Result<(), vk::Result> {
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let _turn = QueueGuard::take(self.lock.as_deref());
        // SAFETY: the queue is locked; the parts are recorded and not pending, since every run waits to the end; what they
        // use is kept alive.
        unsafe { self.handle.queue_submit2(*queue, submits, vk::Fence::null()) }
    }

    /// What the device is.
    pub(crate) fn info(&self) -> &DeviceInfo {
        &self.physical.info
    }

    /// The longest wait for one solve.
    pub(crate) fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Whether it leaves commands out by itself.
    #[cfg(test)]
    pub(crate) fn is_conditional(&self) -> bool {
        self.conditional.is_some()
    }

    /// Most bytes of one allocation and of one buffer.
    pub(crate) fn allocation_limits(&self) -> (u64, u64) {
        let mut v11 = vk::PhysicalDeviceVulkan11Properties::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Properties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut v11).push_next(&mut v13);
        // SAFETY: the physical device belongs to this instance, and a 1.3 device fills both structures.
        unsafe { self.instance.handle.get_physical_device_properties2(self.physical.handle, &mut properties) };
        (v11.max_memory_allocation_size, v13.max_buffer_size)
    }

    /// What memory of the host that the device reads is whole pages of, bytes.
    pub(super) fn host_alignment(&self) -> u64 {
        let mut host = vk::PhysicalDeviceExternalMemoryHostPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut host);
        // SAFETY: the physical device belongs to this instance, and one with the extension fills the structure.
        unsafe { self.instance.handle.get_physical_device_properties2(self.physical.handle, &mut properties) };
        host.min_imported_host_pointer_alignment.max(1)
    }

    /// An earlier wait timed out or failed: the device is not to be relied on.
    pub(crate) fn is_poisoned(&self) -> bool {
        self.poisoned.load(Ordering::Acquire)
    }

    /// Some of what was made from it may still be at work: nothing of that may be freed.
    pub(super) fn is_in_use(&self) -> bool {
        self.abandoned.load(Ordering::Acquire) > 0
    }

    /// Gives a run up, which has `ended` or not.
    pub(super) fn poison(&self, ended: bool) {
        if !ended {
            self.abandoned.fetch_add(1, Ordering::AcqRel);
        }
        self.poisoned.store(true, Ordering::Release);
    }

    pub(super) fn allocator(&self) -> MutexGuard<'_, Allocator> {
        self.allocator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// SharedQueue a failed call into an error that names it and the device.
    pub(super) fn check<T>(&self, call: &str, result: Result<T, vk::Result>) -> Result<T, Error> {
        result.map_err(|e| failure(call, &self.physical.info.name, e))
    }

    /// Gives an object a name that validation and debuggers show.
    pub(super) fn name(&self, object: impl vk::Handle, name: &str) {
        let (Some(names), Ok(name)) = (&self.names, std::ffi::CString::new(name)) else { return };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: the object belongs to this device and is used by this thread alone so far. A name is only a help: its
        // failure changes nothing.
        let _ = unsafe { names.set_debug_utils_object_name(&info) };
    }

    fn open_pipeline_cache(&self) -> Result<vk::PipelineCache, Error> {
        let data = cache::read(&self.physical).unwrap_or_default();
        let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: `data` outlives the call; it carries this driver's stamp and a checksum (`cache::read`).
        let made = unsafe { self.handle.create_pipeline_cache(&create, None) };
        self.check("vkCreatePipelineCache", made)
    }

    /// Writes the pipeline cache where the next engine finds it; failing to is no error.
    pub(crate) fn save_pipeline_cache(&self) {
        // SAFETY: the cache belongs to this device.
        if let Ok(data) = unsafe { self.handle.get_pipeline_cache_data(self.pipeline_cache) } {
            cache::write(&self.physical, &data);
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if self.is_in_use() {
            // What the device may still use is left alone, and so is the instance under it.
            std::mem::forget(self.instance.clone());
            return;
        }
        // SAFETY: everything made from the device holds an Arc to it and is gone, and its runs were waited for; a device of our own is idle
        // after this wait; the allocator frees its memory before the device goes, and is not touched again.
        unsafe {
            if self.is_own {
                let _ = self.handle.device_wait_idle();
            }
            self.handle.destroy_pipeline_cache(self.pipeline_cache, None);
            ManuallyDrop::drop(&mut self.allocator);
            if self.is_own {
                self.handle.destroy_device(None);
            }
        }
    }
}
