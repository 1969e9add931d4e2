//! The images and buffers of a solver on the device, allocated by its plan's layout.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::plan::{Allocation, AllocationKind, HostAccess, Plan};
use super::slot::Slot;
use super::vulkan::{Buffer, Device, Image};
use crate::base::Error;

/// The image or buffer of each slot.
pub(crate) struct Workspace {
    images: BTreeMap<Slot, Arc<Image>>,
    buffers: BTreeMap<Slot, Arc<Buffer>>,
}

impl Workspace {
    /// Allocates for pairs.
    pub(crate) fn new(device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        Self::allocate(device, plan, &plan.pair_layout())
    }

    /// Allocates for sweeps of `frames` frames.
    pub(crate) fn for_sweep(device: &Arc<Device>, plan: &Plan, frames: u32) -> Result<Self, Error> {
        Self::allocate(device, plan, &plan.sweep_layout(frames))
    }

    /// For another pair in flight: allocates its input and output buffers, and shares all else.
    pub(crate) fn beside(&self, device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        let mut beside = Self { images: self.images.clone(), buffers: self.buffers.clone() };
        for allocation in plan.pair_layout().iter().filter(|a| a.slot.is_of_one_pair() && a.is_mapped()) {
            beside.add(device, allocation)?;
        }
        Ok(beside)
    }

    fn allocate(device: &Arc<Device>, plan: &Plan, layout: &[Allocation]) -> Result<Self, Error> {
        let mut workspace = Self { images: BTreeMap::new(), buffers: BTreeMap::new() };
        for allocation in layout {
            workspace.add(device, allocation)?;
        }
        for (bank, weights) in plan.weights.banks.iter().enumerate() {
            let single: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
            workspace.buffer(Slot::Filters { bank }).write(bytemuck::cast_slice(&single))?;
        }
        Ok(workspace)
    }

    fn add(&mut self, device: &Arc<Device>, &Allocation { slot, kind }: &Allocation) -> Result<(), Error> {
        let name = format!("{slot:?}");
        match kind {
            AllocationKind::Image { size, layers, texel } => {
                self.images.insert(slot, Image::new(device, &name, size, layers, texel)?);
            }
            AllocationKind::Buffer { bytes, host } => {
                let allocate = match host {
                    HostAccess::None => Buffer::device_local,
                    HostAccess::Upload => Buffer::for_upload,
                    HostAccess::Readback => Buffer::for_readback,
                    HostAccess::Results => Buffer::for_borrowed_readback,
                };
                self.buffers.insert(slot, allocate(device, &name, bytes)?);
            }
        }
        Ok(())
    }

    /// The image of a slot.
    pub(crate) fn image(&self, slot: Slot) -> &Arc<Image> {
        &self.images[&slot]
    }

    /// The buffer of a slot.
    pub(crate) fn buffer(&self, slot: Slot) -> &Arc<Buffer> {
        &self.buffers[&slot]
    }

    /// All images, which must be prepared once before their first use.
    pub(crate) fn images(&self) -> Vec<&Arc<Image>> {
        self.images.values().collect()
    }
}
