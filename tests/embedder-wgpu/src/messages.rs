//! Collects the validation messages that wgpu passes to the crate `log`.

use std::sync::{Mutex, PoisonError};

struct Messages(Mutex<Vec<String>>);

static MESSAGES: Messages = Messages(Mutex::new(Vec::new()));

/// Starts to collect messages.
pub fn start_collecting() {
    log::set_logger(&MESSAGES).expect("no other logger is set");
    log::set_max_level(log::LevelFilter::Warn);
}

/// Returns the messages collected so far.
pub fn collected() -> Vec<String> {
    MESSAGES.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl log::Log for Messages {
    fn enabled(&self, of: &log::Metadata<'_>) -> bool {
        of.target().starts_with("wgpu_hal::vulkan")
    }

    fn log(&self, record: &log::Record<'_>) {
        let message = record.args().to_string();
        // Validation layers of 2022 reject the SPIR-V of wgpu. Messages that are not validation errors are ignored.
        let is_known = message.contains("Invalid source language operand: 10");
        if self.enabled(record.metadata()) && message.starts_with("VALIDATION") && !is_known {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(message);
        }
    }

    fn flush(&self) {}
}
