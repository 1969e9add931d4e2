//! What validation says, which wgpu hands to the crate `log`.

use std::sync::{Mutex, PoisonError};

struct Messages(Mutex<Vec<String>>);

static MESSAGES: Messages = Messages(Mutex::new(Vec::new()));

/// Keeps them from now on.
pub fn listen() {
    log::set_logger(&MESSAGES).expect("nobody else listens");
    log::set_max_level(log::LevelFilter::Warn);
}

/// All so far.
pub fn heard() -> Vec<String> {
    MESSAGES.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl log::Log for Messages {
    fn enabled(&self, of: &log::Metadata<'_>) -> bool {
        of.target().starts_with("wgpu_hal::vulkan")
    }

    fn log(&self, record: &log::Record<'_>) {
        let message = record.args().to_string();
        // Layers of 2022 know no SPIR-V of WGSL, and take it for wrong. What is slow is wgpu's affair.
        let is_known = message.contains("Invalid source language operand: 10");
        if self.enabled(record.metadata()) && message.starts_with("VALIDATION") && !is_known {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(message);
        }
    }

    fn flush(&self) {}
}
