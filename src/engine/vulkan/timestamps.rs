//! Timestamp queries: the time that the device spends on each pass and each dispatch.

use std::sync::Arc;

use ash::vk;

use super::device::Device;
use crate::base::Error;

/// Times of a run, in milliseconds.
#[derive(Debug, Default)]
pub(crate) struct DeviceTimes {
    pub(crate) total_ms: f64,
    /// By pass name, in the order of first use.
    pub(crate) passes_ms: Vec<(&'static str, f64)>,
    /// The end of each span since the start of the run, in order. A span begins at the end of the previous one,
    /// although passes without a barrier between them may overlap.
    pub(crate) ends_ms: Vec<f64>,
}

impl DeviceTimes {
    /// Adds a span to the time of a pass.
    pub(crate) fn add(&mut self, name: &'static str, span_ms: f64) {
        match self.passes_ms.iter_mut().find(|(pass, _)| *pass == name) {
            Some((_, total)) => *total += span_ms,
            None => self.passes_ms.push((name, span_ms)),
        }
    }
}

/// Where a recording writes timestamps, with the capacity of its query pool.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Clock {
    Never,
    /// At the end of each part and between passes of different names. On lavapipe a timestamp costs as much as an empty
    /// dispatch.
    Passes(u32),
    /// After every dispatch.
    Dispatches(u32),
}

/// A query pool with a timestamp at the start of the recording and at the end of each span of dispatches.
#[derive(Default)]
pub(super) struct Timestamps {
    device: Option<Arc<Device>>,
    pool: vk::QueryPool,
    capacity: u32,
    is_per_dispatch: bool,
    /// The pass of the current span.
    current_pass: Option<&'static str>,
    /// The passes of the completed spans.
    span_passes: Vec<&'static str>,
    /// The number of completed spans at the end of each part.
    part_ends: Vec<usize>,
}

impl Timestamps {
    /// Creates the query pool. There is none if the queue family has no timestamps.
    pub(super) fn new(device: &Arc<Device>, clock: Clock) -> Result<Self, Error> {
        let (Clock::Passes(capacity) | Clock::Dispatches(capacity)) = clock else { return Ok(Self::default()) };
        if device.physical.timestamp_bits == 0 {
            return Ok(Self::default());
        }
        let capacity = capacity + 1;
        let create = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(capacity);
        // SAFETY: the query count is not zero.
        let pool = unsafe { device.handle.create_query_pool(&create, None) };
        Ok(Self {
            pool: device.check("vkCreateQueryPool", pool)?,
            device: Some(device.clone()),
            capacity,
            is_per_dispatch: matches!(clock, Clock::Dispatches(_)),
            current_pass: None,
            span_passes: Vec::new(),
            part_ends: Vec::new(),
        })
    }

    /// Records the reset of the pool, for each run, and the first timestamp.
    pub(super) fn reset(&self, commands: vk::CommandBuffer) {
        let Some(device) = &self.device else { return };
        // SAFETY: the command buffer is recording, and the queries lie within the pool.
        unsafe {
            device.handle.cmd_reset_query_pool(commands, self.pool, 0, self.capacity);
            device.handle.cmd_write_timestamp2(commands, vk::PipelineStageFlags2::ALL_COMMANDS, self.pool, 0);
        }
    }

    /// Ends the current span before a dispatch that begins another.
    pub(super) fn before_dispatch(&mut self, commands: vk::CommandBuffer, name: &'static str) {
        if self.is_per_dispatch || self.current_pass.is_some_and(|pass| pass != name) {
            self.end_span(commands);
        }
        self.current_pass = Some(name);
    }

    /// Ends the current span, if there is one.
    fn end_span(&mut self, commands: vk::CommandBuffer) {
        let (Some(device), Some(name)) = (&self.device, self.current_pass.take()) else { return };
        let index = self.span_passes.len() as u32 + 1;
        if index >= self.capacity {
            return;
        }
        self.span_passes.push(name);
        // SAFETY: the command buffer is recording; the query lies within the pool and is reset at the start of the
        // recording.
        unsafe {
            device.handle.cmd_write_timestamp2(commands, vk::PipelineStageFlags2::COMPUTE_SHADER, self.pool, index)
        };
    }

    /// Ends the current part.
    pub(super) fn end_part(&mut self, commands: vk::CommandBuffer) {
        self.end_span(commands);
        self.part_ends.push(self.span_passes.len());
    }

    /// Reads the times of a completed run. `is_submitted` states which of the first parts it submitted. The times are
    /// empty if the queue family has no timestamps.
    pub(super) fn read(&self, is_submitted: &[bool]) -> Result<DeviceTimes, Error> {
        let Some(device) = &self.device else { return Ok(DeviceTimes::default()) };
        let mut ticks = Vec::new();
        for (part, &is_submitted) in is_submitted.iter().enumerate() {
            let first = if part == 0 { 0 } else { self.part_ends[part - 1] + 1 };
            let count = self.part_ends[part] + 1 - first;
            let mut part_ticks = vec![ticks.last().copied().unwrap_or(0u64); count];
            if is_submitted && count > 0 {
                let flags = vk::QueryResultFlags::TYPE_64;
                // SAFETY: the run is complete, so that every query that its parts write is available.
                let read =
                    unsafe { device.handle.get_query_pool_results(self.pool, first as u32, &mut part_ticks, flags) };
                device.check("vkGetQueryPoolResults", read)?;
            }
            ticks.extend(part_ticks);
        }
        let Some((&first, &last)) = ticks.first().zip(ticks.last()) else { return Ok(DeviceTimes::default()) };
        let mask =
            if device.physical.timestamp_bits >= 64 { u64::MAX } else { (1 << device.physical.timestamp_bits) - 1 };
        let milliseconds = |from: u64, to: u64| {
            (to.wrapping_sub(from) & mask) as f64 * f64::from(device.physical.limits.timestamp_period) * 1e-6
        };
        let total_ms = milliseconds(first, last);
        let ends_ms = ticks[1..].iter().map(|&end| milliseconds(first, end)).collect();
        let mut times = DeviceTimes { total_ms, ends_ms, ..DeviceTimes::default() };
        for (pair, &name) in ticks.windows(2).zip(&self.span_passes) {
            times.add(name, milliseconds(pair[0], pair[1]));
        }
        Ok(times)
    }
}

impl Drop for Timestamps {
    fn drop(&mut self) {
        if let Some(device) = &self.device
            && !device.is_in_use()
        {
            // SAFETY: the recording that writes the pool is complete, or was never submitted.
            unsafe { device.handle.destroy_query_pool(self.pool, None) };
        }
    }
}
