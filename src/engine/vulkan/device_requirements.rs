//! What an engine asks of a device that someone else makes, beside whatever else that is made with.

use std::ffi::CStr;

use ash::vk::{self, StructureType};

use super::instance::Instance;
use super::optional_extensions::Liked;

/// The Vulkan version that instance and device must have been made for, at least.
pub const REQUIRED_VERSION: u32 = vk::API_VERSION_1_3;

/// Switches on the features that an engine requires of a device, in what the device will be made with: timeline semaphores,
/// synchronization2, maintenance4. Others stay as they are. [`DeviceRequirements`] does it in any chain, and with the [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS) that there are.
pub fn require(v12: &mut vk::PhysicalDeviceVulkan12Features<'_>, v13: &mut vk::PhysicalDeviceVulkan13Features<'_>) {
    v12.timeline_semaphore = vk::TRUE;
    v13.synchronization2 = vk::TRUE;
    v13.maintenance4 = vk::TRUE;
}

/// What a device is to be made with for an engine: the required features, and of the [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS) those that there are.
///
/// The structure of a feature may be in a chain once, and those of single features not beside that of the version which took them in. Who
/// writes the chain himself may use [`require`]; this is for chains that others have begun.
pub struct DeviceRequirements {
    timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures<'static>,
    synchronization2: vk::PhysicalDeviceSynchronization2Features<'static>,
    maintenance4: vk::PhysicalDeviceMaintenance4Features<'static>,
    conditional: Option<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'static>>,
    liked: Liked,
}

impl DeviceRequirements {
    /// Of a physical device.
    ///
    /// # Safety
    /// `physical` is of `instance`, which was made for [`REQUIRED_VERSION`] or later.
    pub unsafe fn of(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Self {
        let liked = Instance::foreign(instance.clone()).liked(physical);
        let conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
        Self {
            timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true),
            synchronization2: vk::PhysicalDeviceSynchronization2Features::default().synchronization2(true),
            maintenance4: vk::PhysicalDeviceMaintenance4Features::default().maintenance4(true),
            conditional: liked.conditional.then_some(conditional),
            liked,
        }
    }

    /// The extensions to enable, beside others.
    pub fn extensions(&self) -> Vec<&'static CStr> {
        self.liked.extensions().collect()
    }

    pub(super) fn liked(&self) -> Liked {
        self.liked
    }

    /// Switches the features on in the structures that are chained to `create`, and chains those that are not there; all else stays as it is. To
    /// be called last: a structure that is chained later may then be there twice.
    ///
    /// # Safety
    /// The chain is valid, and what is in it may be written, as what was chained by `push_next` may.
    pub unsafe fn switch_on<'a>(&'a mut self, mut create: vk::DeviceCreateInfo<'a>) -> vk::DeviceCreateInfo<'a> {
        // What an earlier call has chained.
        self.timeline_semaphore.p_next = std::ptr::null_mut();
        self.synchronization2.p_next = std::ptr::null_mut();
        self.maintenance4.p_next = std::ptr::null_mut();
        self.conditional.iter_mut().for_each(|conditional| conditional.p_next = std::ptr::null_mut());
        let mut found = [false; 4];
        let mut next = create.p_next.cast_mut().cast::<vk::BaseOutStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the chain is valid and may be written, by the caller.
            let (here, after) = unsafe { (switched_on(next), (*next).p_next) };
            (0..4).for_each(|n| found[n] |= here[n]);
            next = after;
        }
        let [timeline_semaphore, synchronization2, maintenance4, conditional] = found;
        if !timeline_semaphore {
            create = create.push_next(&mut self.timeline_semaphore);
        }
        if !synchronization2 {
            create = create.push_next(&mut self.synchronization2);
        }
        if !maintenance4 {
            create = create.push_next(&mut self.maintenance4);
        }
        if let Some(features) = self.conditional.as_mut().filter(|_| !conditional) {
            create = create.push_next(features);
        }
        create
    }
}

/// Switches on what a structure has of timeline semaphores, synchronization2, maintenance4 and conditional rendering, and says which. The last
/// stands in no chain whose device lacks it.
///
/// # Safety
/// It is of a valid chain, and may be written.
unsafe fn switched_on(structure: *mut vk::BaseOutStructure<'_>) -> [bool; 4] {
    // SAFETY: what stands in a chain is what its type says.
    unsafe {
        match (*structure).s_type {
            StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceVulkan12Features<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceTimelineSemaphoreFeatures<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES => {
                let features = structure.cast::<vk::PhysicalDeviceVulkan13Features<'_>>();
                ((*features).synchronization2, (*features).maintenance4) = (vk::TRUE, vk::TRUE);
                [false, true, true, false]
            }
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceSynchronization2Features<'_>>()).synchronization2 = vk::TRUE;
                [false, true, false, false]
            }
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceMaintenance4Features<'_>>()).maintenance4 = vk::TRUE;
                [false, false, true, false]
            }
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT => {
                let features = structure.cast::<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'_>>();
                (*features).conditional_rendering = vk::TRUE;
                [false, false, false, true]
            }
            _ => [false; 4],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted() -> DeviceRequirements {
        DeviceRequirements {
            timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true),
            synchronization2: vk::PhysicalDeviceSynchronization2Features::default().synchronization2(true),
            maintenance4: vk::PhysicalDeviceMaintenance4Features::default().maintenance4(true),
            conditional: Some(vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true)),
            liked: Liked { conditional: true, ..Liked::default() },
        }
    }

    /// What is chained, sorted.
    fn chained(create: &vk::DeviceCreateInfo<'_>) -> Vec<StructureType> {
        let mut types = Vec::new();
        let mut next = create.p_next.cast::<vk::BaseInStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the tests chain what outlives this.
            unsafe {
                types.push((*next).s_type);
                next = (*next).p_next;
            }
        }
        types.sort_unstable();
        types
    }

    #[test]
    fn each_feature_is_switched_on_once_wherever_its_place_is() {
        let mut alone = wanted();
        // SAFETY: there is no chain.
        let create = unsafe { alone.switch_on(vk::DeviceCreateInfo::default()) };
        let each = [
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT,
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES,
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES,
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES,
        ];
        assert_eq!(chained(&create), each);

        let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut v12).push_next(&mut v13);
        let mut beside = wanted();
        // SAFETY: both are here, and nobody else's.
        let types = chained(&unsafe { beside.switch_on(create) });
        let versions =
            [StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES];
        assert_eq!(types, [&versions[..], &each[..1]].concat());
        assert_eq!([v12.timeline_semaphore, v13.synchronization2, v13.maintenance4], [vk::TRUE; 3]);

        let mut maintenance4 = vk::PhysicalDeviceMaintenance4Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut maintenance4);
        let mut beside = wanted();
        // SAFETY: as above.
        assert_eq!(chained(&unsafe { beside.switch_on(create) }), each);
        assert_eq!(maintenance4.maintenance4, vk::TRUE);
    }
}
