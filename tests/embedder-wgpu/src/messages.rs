//! Validation messages, which wgpu passes to the crate `log`.

use std::sync::{Mutex, PoisonError};

struct Messages(Mutex<Vec<String>>);

static MESSAGES: Messages = Messages(Mutex::new(Vec::new()));

/// Begins to collect messages.
pub fn listen() {
    log::set_logger(&MESSAGES).expect("nobody else listens");
    log::set_max_level(log::LevelFilter::Warn);
}

/// The messages so far.
pub fn heard() -> Vec<String> {
    MESSAGES.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl log::Log for Messages {
    fn enabled(&self, of: &log::Metadata<'_>) -> bool {
        of.target().starts_with("wgpu_hal::vulkan")
    }

    fn log(&self, record: &log::Record<'_>) {
        let message = record.args().to_string();
        // Layers of 2022 reject wgpu's SPIR-V. Performance warnings are wgpu's own.
        let is_known = message.contains("Invalid source language operand: 10");
        if self.enabled(record.metadata()) && message.starts_with("VALIDATION") && !is_known {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(message);
        }
    }

    fn flush(&self) {}
}
