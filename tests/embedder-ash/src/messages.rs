//! Collects validation messages.

use std::ffi::c_void;
use std::sync::{Arc, Mutex, PoisonError};

use parfocal::interop::ash::{self, ext, vk};

/// A debug messenger and the messages that it has collected.
pub struct Messages {
    utils: ext::debug_utils::Instance,
    messenger: vk::DebugUtilsMessengerEXT,
    // In an `Arc`, so that its address does not change.
    kept: Arc<Mutex<Vec<String>>>,
}

impl Messages {
    /// Collects the messages of an instance that has the validation layer and `VK_EXT_debug_utils`.
    pub fn of(entry: &ash::Entry, instance: &ash::Instance) -> Result<Self, vk::Result> {
        let utils = ext::debug_utils::Instance::new(entry, instance);
        let kept = Arc::<Mutex<Vec<String>>>::default();
        let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(keep))
            .user_data(Arc::as_ptr(&kept).cast_mut().cast());
        // SAFETY: the instance has the extension. The target of `user_data` outlives the messenger.
        let messenger = unsafe { utils.create_debug_utils_messenger(&create, None) }?;
        Ok(Self { utils, messenger, kept })
    }

    /// Ends the collection and returns the messages.
    pub fn end(self) -> Vec<String> {
        // SAFETY: `Gpu` destroys the instance later, and no other code uses the messenger.
        unsafe { self.utils.destroy_debug_utils_messenger(self.messenger, None) };
        std::mem::take(&mut *self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

extern "system" fn keep(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    kept: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data, and `kept` is the list that `of` passed as `user_data`.
    let (message, kept) = unsafe { ((*data).message_as_c_str(), &*kept.cast::<Mutex<Vec<String>>>()) };
    let message = message.map(|m| m.to_string_lossy().into_owned()).unwrap_or_default();
    kept.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    vk::FALSE
}
