//! A wgpu device that an engine can use too.

use std::error::Error;
use std::sync::Arc;

use parfocal::interop::ash::vk;
use parfocal::interop::{DeviceRequirements, ExternalDevice, SharedQueue};
use wgpu::hal::api::Vulkan;

/// The queue family that wgpu uses.
const FAMILY: u32 = 0;

/// Opens wgpu's device and queue, and the device for an engine. `Adapter::request_device` leaves out features that the
/// engine requires, and `open_with_callback` cannot enable them: wgpu's chain of features has maintenance4 in it,
/// disabled.
///
/// # Safety
/// - The caller locks the queue around each use by wgpu: `Queue::submit`, `Queue::present`, `Surface::configure`,
///   `Queue::on_submitted_work_done`, `Buffer::map_async` of a buffer written since the last submission, the drop of the last handle of a queue.
/// - The engine and its solvers are dropped before wgpu's device.
pub unsafe fn open(
    adapter: &wgpu::Adapter,
    turns: &Arc<SharedQueue>,
) -> Result<(wgpu::Device, wgpu::Queue, ExternalDevice), Box<dyn Error>> {
    let wants = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
    // SAFETY: nothing of it is destroyed here.
    let hal = unsafe { adapter.as_hal::<Vulkan>() }.ok_or("wgpu is not on Vulkan")?;
    let (instance, physical) = (hal.shared_instance().raw_instance(), hal.raw_physical_device());
    // SAFETY: wgpu makes its instance for Vulkan 1.3, where the loader has that.
    let mut wanted = unsafe { DeviceRequirements::for_device(instance, physical) }?;
    let mut extensions = hal.required_device_extensions(wants.required_features);
    extensions.extend(wanted.extensions());
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let mut features = hal.physical_device_features(&extensions, wants.required_features);
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(FAMILY).queue_priorities(&[1.0])];
    let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&names);
    // SAFETY: wgpu's features are here, in a chain that is valid; the device is made as wgpu would, with what is wanted
    // besides, and becomes wgpu's.
    unsafe {
        let create = wanted.enable_features(features.add_to_device_create(create));
        let raw = instance.create_device(physical, &create, None)?;
        let (limits, hints) = (&wants.required_limits, &wants.memory_hints);
        let of_hal =
            hal.device_from_raw(raw.clone(), None, &extensions, wants.required_features, limits, hints, FAMILY, 0)?;
        let foreign = ExternalDevice::new(instance.clone(), physical, raw, FAMILY, of_hal.queue.as_raw())
            .with_queue_lock(turns.clone())
            .with_requirements(&wanted);
        let (device, queue) = adapter.create_device_from_hal::<Vulkan>(of_hal, &wants)?;
        Ok((device, queue, foreign))
    }
}
