//! What a driver's compiler states about a pipeline, on a machine without its GPU. For `tools/gpu-model`.

use std::collections::BTreeMap;
use std::ffi::CStr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ash::{khr, vk};

use super::device::Device;
use super::instance::{Instance, text, vulkan_error};
use super::interop::enable_required_features;
use super::pipeline::{Pipeline, Stage, Variant};
use crate::base::Error;

/// The numbers that a compiler states, by name.
pub type Statistics = BTreeMap<String, u64>;

/// Opens the device if it is Mesa's null hardware, which only compiles: it has no memory, and its queue runs nothing.
///
/// # Errors
/// [`Error::NoLoader`], [`Error::NoDevice`] for other devices, [`Error::Vulkan`].
pub(crate) fn null_hardware() -> Result<Arc<Device>, Error> {
    let instance = Instance::new(false)?;
    let mut devices = instance.physical_devices()?.into_iter();
    let Some(physical) = devices.find(|device| device.info.name.contains("Null hardware")) else {
        return Err(Error::NoDevice(" for the model (run tools/gpu-model)".into()));
    };
    let queues =
        [vk::DeviceQueueCreateInfo::default().queue_family_index(physical.queue_family).queue_priorities(&[1.0])];
    let (mut v12, mut v13) = Default::default();
    enable_required_features(&mut v12, &mut v13);
    let mut statistics =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    let extensions = [khr::pipeline_executable_properties::NAME].map(CStr::as_ptr);
    let create = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&extensions)
        .push_next(&mut v12)
        .push_next(&mut v13)
        .push_next(&mut statistics);
    // SAFETY: the physical device belongs to this instance. RADV has the extension on all of its hardware.
    let handle = unsafe { instance.handle.create_device(physical.handle, &create, None) }
        .map_err(|e| vulkan_error("vkCreateDevice", &physical.info.name, e))?;
    // SAFETY: the device was created with one queue of the family.
    let queue = unsafe { handle.get_device_queue(physical.queue_family, 0) };
    // Null hardware crashes when it is waited for, so the device is not destroyed, nor is its instance.
    std::mem::forget(instance.clone());
    Device::from_handles(instance, physical, (handle, Arc::new(Mutex::new(queue)), None), false, Duration::ZERO)
}

/// Compiles a variant of a stage on [`null_hardware`], and returns what the compiler states about it.
///
/// # Errors
/// [`Error::Vulkan`].
pub(crate) fn statistics(device: &Arc<Device>, stage: &Stage, variant: Variant) -> Result<Statistics, Error> {
    let pipeline = Pipeline::with_flags(device, stage, variant, vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR)?;
    let functions = khr::pipeline_executable_properties::Device::new(&device.instance.handle, &device.handle);
    let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline.handle);
    // SAFETY: the device has the extension and its feature (`null_hardware`). The pipeline was created with the flag
    // for statistics, and a compute pipeline has one executable.
    let stated = unsafe { functions.get_pipeline_executable_statistics(&info) };
    let stated = device.check("vkGetPipelineExecutableStatisticsKHR", stated)?;
    let entry = |statistic: &vk::PipelineExecutableStatisticKHR<'_>| {
        let is_integer = statistic.format == vk::PipelineExecutableStatisticFormatKHR::UINT64;
        // SAFETY: the format says which member of the union is set.
        is_integer.then(|| (text(statistic.name_as_c_str()), unsafe { statistic.value.u64 }))
    };
    Ok(stated.iter().filter_map(entry).collect())
}
