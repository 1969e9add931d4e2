//! Where the time goes on the device, by named pass and by dispatch.

use std::sync::Arc;

use ash::vk;

use super::device::Device;
use crate::Error;

/// Milliseconds in all, and by pass name in order of first use.
#[derive(Debug, Default)]
pub(crate) struct DeviceTimes {
    pub(crate) total_ms: f64,
    pub(crate) passes_ms: Vec<(&'static str, f64)>,
    /// When each pass ended, in order, since the start; each begins as the one before it ends.
    pub(crate) ends_ms: Vec<f64>,
}

/// A timestamp at the start and after every pass.
#[derive(Default)]
pub(super) struct Timestamps {
    device: Option<Arc<Device>>,
    pool: vk::QueryPool,
    capacity: u32,
    names: Vec<&'static str>,
    /// Passes recorded when each part ended.
    part_ends: Vec<usize>,
}

impl Timestamps {
    /// Room for that many passes; none where the queue has no clock.
    pub(super) fn new(device: &Arc<Device>, capacity: u32) -> Result<Self, Error> {
        if device.physical.timestamp_bits == 0 || capacity == 0 {
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
            names: Vec::new(),
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

    /// Takes the time after a pass.
    pub(super) fn after(&mut self, part: vk::CommandBuffer, name: &'static str) {
        let Some(device) = &self.device else { return };
        let index = self.names.len() as u32 + 1;
        if index >= self.capacity {
            return;
        }
        self.names.push(name);
        // SAFETY: the part is being recorded; the query lies within the pool and was reset at the start of the recording.
        unsafe { device.handle.cmd_write_timestamp2(part, vk::PipelineStageFlags2::COMPUTE_SHADER, self.pool, index) };
    }

    /// Notes that a part ends here.
    pub(super) fn end_part(&mut self) {
        self.part_ends.push(self.names.len());
    }

    /// The times of a run of the first parts that has ended; nothing where the queue has no clock.
    pub(super) fn read(&self, parts: usize) -> Result<DeviceTimes, Error> {
        let Some(device) = &self.device else { return Ok(DeviceTimes::default()) };
        let names = &self.names[..parts.checked_sub(1).map_or(0, |last| self.part_ends[last])];
        let mut ticks = vec![0u64; names.len() + 1];
        // SAFETY: the run has ended, so every query that its parts write has a value.
        let read =
            unsafe { device.handle.get_query_pool_results(self.pool, 0, &mut ticks, vk::QueryResultFlags::TYPE_64) };
        device.check("vkGetQueryPoolResults", read)?;
        let mask =
            if device.physical.timestamp_bits >= 64 { u64::MAX } else { (1 << device.physical.timestamp_bits) - 1 };
        let milliseconds = |from: u64, to: u64| {
            (to.wrapping_sub(from) & mask) as f64 * f64::from(device.physical.limits.timestamp_period) * 1e-6
        };
        let total_ms = milliseconds(ticks[0], ticks[names.len()]);
        let ends_ms = ticks[1..].iter().map(|&end| milliseconds(ticks[0], end)).collect();
        let mut times = DeviceTimes { total_ms, ends_ms, ..DeviceTimes::default() };
        for (pair, &name) in ticks.windows(2).zip(names) {
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
            && !device.is_poisoned()
        {
            // SAFETY: the recording that writes the pool has been waited for, or was never submitted.
            unsafe { device.handle.destroy_query_pool(self.pool, None) };
        }
    }
}
