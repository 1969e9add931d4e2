//! Opens a wgpu device that an engine can share.

use std::error::Error;
use std::sync::Arc;

use parfocal::interop::ash::vk;
use parfocal::interop::{DeviceRequirements, ExternalDevice, SharedQueue};
use wgpu::hal::api::Vulkan;

/// The queue family that wgpu uses.
const FAMILY: u32 = 0;

/// Opens the device and queue of wgpu, and returns the same device for an engine.
///
/// `Adapter::request_device` does not enable all features that the engine requires. `open_with_callback` cannot enable
/// them either, because the feature chain of wgpu already contains `maintenance4`, disabled.
///
/// # Safety
/// - The caller locks the queue around each use by wgpu: `Queue::submit`, `Queue::present`, `Surface::configure`,
///   `Queue::on_submitted_work_done`, `Buffer::map_async` of a buffer written since the last submission, the drop of
///   the last handle of a queue.
/// - The engine and its solvers are dropped before wgpu's device.
pub unsafe fn open(
    adapter: &wgpu::Adapter,
    shared_queue: &Arc<SharedQueue>,
) -> Result<(wgpu::Device, wgpu::Queue, ExternalDevice), Box<dyn Error>> {
    let descriptor = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
    // SAFETY: no handle of the adapter is destroyed here.
    let hal = unsafe { adapter.as_hal::<Vulkan>() }.ok_or("wgpu is not on Vulkan")?;
    let (instance, physical) = (hal.shared_instance().raw_instance(), hal.raw_physical_device());
    // SAFETY: wgpu creates its instance for Vulkan 1.3 if the loader supports it.
    let mut requirements = unsafe { DeviceRequirements::for_device(instance, physical) }?;
    let mut extensions = hal.required_device_extensions(descriptor.required_features);
    extensions.extend(requirements.extensions());
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let mut features = hal.physical_device_features(&extensions, descriptor.required_features);
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(FAMILY).queue_priorities(&[1.0])];
    let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&names);
    // SAFETY: the feature chain is valid and outlives the call. The device has all features and extensions that wgpu
    // enables, and those that the engine requires. wgpu owns the device afterwards.
    unsafe {
        let create = requirements.enable_features(features.add_to_device_create(create));
        let raw = instance.create_device(physical, &create, None)?;
        let (limits, hints) = (&descriptor.required_limits, &descriptor.memory_hints);
        let of_hal = hal.device_from_raw(
            raw.clone(),
            None,
            &extensions,
            descriptor.required_features,
            limits,
            hints,
            FAMILY,
            0,
        )?;
        let external = ExternalDevice::new(instance.clone(), physical, raw, FAMILY, of_hal.queue.as_raw())
            .with_queue_lock(shared_queue.clone())
            .with_requirements(&requirements);
        let (device, queue) = adapter.create_device_from_hal::<Vulkan>(of_hal, &descriptor)?;
        Ok((device, queue, external))
    }
}
