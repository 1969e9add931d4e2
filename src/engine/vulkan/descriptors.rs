//! What passes bind, as descriptor sets.

use std::any::Any;
use std::collections::HashMap;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::memory::{Buffer, Image};
use super::pipeline::{Kind, Pipeline};
use crate::base::Error;

/// What a pass binds, in the order of its stage's bindings.
#[derive(Clone, Copy)]
pub(crate) enum Resource<'a> {
    Image(&'a Arc<Image>),
    Buffer(&'a Arc<Buffer>),
    Uniform(&'a Arc<Buffer>),
}

/// Descriptor sets that one pool holds; another is made when it is full.
const SETS_PER_POOL: u32 = 128;

/// The sets of a recording, each made once, and what they name, which lives as long.
pub(super) struct Descriptors {
    device: Arc<Device>,
    pools: Vec<vk::DescriptorPool>,
    left: u32,
    sets: HashMap<(vk::Pipeline, Vec<u64>), vk::DescriptorSet>,
    keep: Vec<Arc<dyn Any + Send + Sync>>,
}

impl Descriptors {
    pub(super) fn new(device: &Arc<Device>) -> Self {
        Self { device: device.clone(), pools: Vec::new(), left: 0, sets: HashMap::new(), keep: Vec::new() }
    }

    /// The set by which a pipeline binds these.
    pub(super) fn set(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
    ) -> Result<vk::DescriptorSet, Error> {
        let kinds: Vec<_> = resources.iter().map(|r| r.kind()).collect();
        let expected: Vec<_> = pipeline.bindings.iter().map(|b| b.kind).collect();
        assert_eq!(kinds, expected, "resources of {}", pipeline.name);
        let key = (pipeline.handle, resources.iter().map(|r| r.id()).collect::<Vec<_>>());
        if let Some(&set) = self.sets.get(&key) {
            return Ok(set);
        }
        let set = self.allocate(pipeline)?;
        for (index, resource) in (0..).zip(resources) {
            self.write(set, index, *resource);
        }
        self.keep.push(pipeline.clone());
        self.sets.insert(key, set);
        Ok(set)
    }

    fn allocate(&mut self, pipeline: &Pipeline) -> Result<vk::DescriptorSet, Error> {
        if self.left == 0 {
            // No stage binds more than twelve resources of a kind.
            let sizes = [Kind::Image, Kind::Buffer, Kind::Uniform].map(|kind| vk::DescriptorPoolSize {
                ty: kind.descriptor_type(),
                descriptor_count: 12 * SETS_PER_POOL,
            });
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(SETS_PER_POOL).pool_sizes(&sizes);
            // SAFETY: the device is alive.
            let pool = unsafe { self.device.handle.create_descriptor_pool(&create, None) };
            self.pools.push(self.device.check("vkCreateDescriptorPool", pool)?);
            self.left = SETS_PER_POOL;
        }
        self.left -= 1;
        let layouts = [pipeline.set_layout];
        let pool = self.pools.last().copied().unwrap_or_default();
        let create = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool has room for the set.
        let sets = unsafe { self.device.handle.allocate_descriptor_sets(&create) };
        Ok(self.device.check("vkAllocateDescriptorSets", sets)?[0])
    }

    fn write(&mut self, set: vk::DescriptorSet, index: u32, resource: Resource<'_>) {
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(index)
            .descriptor_type(resource.kind().descriptor_type());
        match resource {
            Resource::Image(image) => {
                let info =
                    [vk::DescriptorImageInfo::default().image_view(image.view).image_layout(vk::ImageLayout::GENERAL)];
                // SAFETY: the set is new and used by no submission; the view is kept alive.
                unsafe { self.device.handle.update_descriptor_sets(&[write.image_info(&info)], &[]) };
                self.keep.push(image.clone());
            }
            Resource::Buffer(buffer) | Resource::Uniform(buffer) => {
                let info = [vk::DescriptorBufferInfo { buffer: buffer.handle, offset: 0, range: vk::WHOLE_SIZE }];
                // SAFETY: the set is new and used by no submission; the buffer is kept alive.
                unsafe { self.device.handle.update_descriptor_sets(&[write.buffer_info(&info)], &[]) };
                self.keep.push(buffer.clone());
            }
        }
    }
}

impl Drop for Descriptors {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        for &pool in &self.pools {
            // SAFETY: the recording that they are of was waited for, or nothing of it was submitted.
            unsafe { self.device.handle.destroy_descriptor_pool(pool, None) };
        }
    }
}

impl Resource<'_> {
    fn kind(&self) -> Kind {
        match self {
            Resource::Image(_) => Kind::Image,
            Resource::Buffer(_) => Kind::Buffer,
            Resource::Uniform(_) => Kind::Uniform,
        }
    }

    fn id(&self) -> u64 {
        use ash::vk::Handle;
        match self {
            Resource::Image(image) => image.handle.as_raw(),
            Resource::Buffer(buffer) | Resource::Uniform(buffer) => buffer.handle.as_raw(),
        }
    }
}
