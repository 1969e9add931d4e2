//! Where the time goes on the device, by named pass and by dispatch.

use std::sync::Arc;

use ash::vk;

use super::device::Device;
use crate::base::Error;

/// Milliseconds in all, and by pass name in order of first use.
#[derive(Debug, Default)]
pub(crate) struct DeviceTimes {
    pub(crate) total_ms: f64,
    pub(crate) passes_ms: Vec<(&'static str, f64)>,
    /// When each span ended, in order, since the start; each is taken to begin as the one before it ends, though passes that do not
    /// wait for each other may overlap.
    pub(crate) ends_ms: Vec<f64>,
}

/// When a recording reads the device's clock, with room for so many readings.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Clock {
    Never,
    /// At the end of each part and wherever a pass follows one of another name: on lavapipe a reading costs as much as an
    /// empty dispatch.
    Passes(u32),
    /// After every dispatch.
    Dispatches(u32),
}

/// A timestamp at the start, and one at the end of every span of dispatches.
#[derive(Default)]
pub(super) struct Timestamps {
    device: Option<Arc<Device>>,
    pool: vk::QueryPool,
    capacity: u32,
    each_dispatch: bool,
    /// The pass of the span under way.
    open: Option<&'static str>,
    /// The passes of the spans that have ended.
    spans: Vec<&'static str>,
    /// How many there were when each part ended.
    part_ends: Vec<usize>,
}

impl Timestamps {
    /// None where the queue has no clock.
    pub(super) fn new(device: &Arc<Device>, clock: Clock) -> Result<Self, Error> {
        let (Clock::Passes(capacity) | Clock::Dispatches(capacity)) = clock else { return Ok(Self::default()) };
        if device.physical.timestamp_bits == 0 {
            return Ok(Self::default());
        }
        let capacity = capacity + 1;
        let create = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(capacity);
        // SAFETY: the device is alive.
        let pool = unsafe { device.handle.create_query_pool(&create, None) };
        Ok(Self {
            pool: device.check("vkCreateQueryPool", pool)?,
            device: Some(device.clone()),
            capacity,
            each_dispatch: matches!(clock, Clock::Dispatches(_)),
            open: None,
            spans: Vec::new(),
            part_ends: Vec::new(),
        })
    }

    /// Resets the pool within the recording, so that a replay starts afresh, and takes the first time.
    pub(super) fn reset(&self, part: vk::CommandBuffer) {
        let Some(device) = &self.device else { return };
        // SAFETY: the part is being recorded, and the queries lie within the pool.
        unsafe {
            device.handle.cmd_reset_query_pool(part, self.pool, 0, self.capacity);
            device.handle.cmd_write_timestamp2(part, vk::PipelineStageFlags2::ALL_COMMANDS, self.pool, 0);
        }
    }

    /// Takes the time before a dispatch, if it begins a span.
    pub(super) fn before(&mut self, part: vk::CommandBuffer, name: &'static str) {
        if self.each_dispatch || self.open.is_some_and(|open| open != name) {
            self.end_span(part);
        }
        self.open = Some(name);
    }

    /// Ends the span under way, if there is one.
    fn end_span(&mut self, part: vk::CommandBuffer) {
        let (Some(device), Some(name)) = (&self.device, self.open.take()) else { return };
        let index = self.spans.len() as u32 + 1;
        if index >= self.capacity {
            return;
        }
        self.spans.push(name);
        // SAFETY: the part is being recorded; the query lies within the pool and was reset at the start of the recording.
        unsafe { device.handle.cmd_write_timestamp2(part, vk::PipelineStageFlags2::COMPUTE_SHADER, self.pool, index) };
    }

    /// The part ends here.
    pub(super) fn end_part(&mut self, part: vk::CommandBuffer) {
        self.end_span(part);
        self.part_ends.push(self.spans.len());
    }

    /// The times of a run that has ended, by which of the first parts it ran; nothing where the queue has no clock.
    pub(super) fn read(&self, ran: &[bool]) -> Result<DeviceTimes, Error> {
        let Some(device) = &self.device else { return Ok(DeviceTimes::default()) };
        let mut ticks = Vec::new();
        for (part, &ran) in ran.iter().enumerate() {
            let before = if part == 0 { 0 } else { self.part_ends[part - 1] + 1 };
            let count = self.part_ends[part] + 1 - before;
            let mut of_part = vec![ticks.last().copied().unwrap_or(0u64); count];
            if ran && count > 0 {
                let flags = vk::QueryResultFlags::TYPE_64;
                // SAFETY: the run has ended, so every query that its parts write has a value.
                let read =
                    unsafe { device.handle.get_query_pool_results(self.pool, before as u32, &mut of_part, flags) };
                device.check("vkGetQueryPoolResults", read)?;
            }
            ticks.extend(of_part);
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
        for (pair, &name) in ticks.windows(2).zip(&self.spans) {
            let spent = milliseconds(pair[0], pair[1]);
            match times.passes_ms.iter_mut().find(|(known, _)| *known == name) {
                Some((_, total)) => *total += spent,
                None => times.passes_ms.push((name, spent)),
            }
        }
        Ok(times)
    }
}

impl Drop for Timestamps {
    fn drop(&mut self) {
        if let Some(device) = &self.device
            && !device.is_in_use()
        {
            // SAFETY: the recording that writes the pool has been waited for, or was never submitted.
            unsafe { device.handle.destroy_query_pool(self.pool, None) };
        }
    }
}
