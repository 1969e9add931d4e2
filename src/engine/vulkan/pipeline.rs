//! Compute pipelines, and the descriptor sets that bind their resources.

use std::any::Any;
use std::collections::HashMap;
use std::ops::BitOr;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::memory::{Buffer, Image};
use crate::base::Error;
use crate::engine::shaders::Shader;

/// The descriptor type of a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A storage image, a 2D array of one or four floats per texel.
    Image,
    /// A storage image of one float per texel, read as the words of their bits.
    Words,
    /// A storage buffer.
    Buffer,
    /// A uniform buffer.
    Uniform,
}

/// How a shader accesses a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Read,
    Write,
    /// Reads and writes.
    Update,
}

/// One binding of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Binding {
    /// Its name in the shader.
    pub(crate) name: &'static str,
    pub(crate) kind: Kind,
    pub(crate) access: Access,
}

/// The flags that are set in a variant of a stage: bit n for the boolean specialization constant n. The shaders declare
/// them, and `build.rs` makes a constant of each: `Variant::MASKED`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Variant(u8);

impl Variant {
    /// No flag.
    pub(crate) const NONE: Self = Self(0);

    /// The flag of a specialization constant.
    pub(crate) const fn flag(id: u32) -> Self {
        Self(1 << id)
    }

    /// The flags of both.
    pub(crate) const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// These flags, or none.
    pub(crate) fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Whether all these flags are set.
    pub(crate) fn has(self, flags: Self) -> bool {
        self.0 & flags.0 == flags.0
    }

    /// The value of a specialization constant.
    fn constant(self, id: u32) -> u32 {
        u32::from(self.0 >> id & 1)
    }
}

// The constants of the flags.
include!(concat!(env!("OUT_DIR"), "/flags.rs"));

impl BitOr for Variant {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        self.or(other)
    }
}

/// A shader with its bindings, in order, and the size of its push constants in bytes.
#[derive(Debug)]
pub(crate) struct Stage {
    pub(crate) shader: &'static Shader,
    pub(crate) bindings: &'static [Binding],
    pub(crate) constant_bytes: usize,
    /// The flags that it has.
    pub(crate) flags: Variant,
    /// Width and height of a workgroup, the specialization constants 0 and 1. One of more than 256 invocations may be
    /// less high, so that its shader must not depend on the height.
    pub(crate) workgroup: [u32; 2],
}

/// A compiled stage.
pub(crate) struct Pipeline {
    pub(super) handle: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    pub(super) set_layout: vk::DescriptorSetLayout,
    pub(super) bindings: &'static [Binding],
    pub(super) constant_bytes: usize,
    pub(crate) name: &'static str,
    device: Arc<Device>,
}

impl Kind {
    pub(super) fn descriptor_type(self) -> vk::DescriptorType {
        match self {
            Kind::Image | Kind::Words => vk::DescriptorType::STORAGE_IMAGE,
            Kind::Buffer => vk::DescriptorType::STORAGE_BUFFER,
            Kind::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
        }
    }
}

impl Stage {
    /// Returns the number of workgroups that cover `width` x `height` invocations.
    pub(crate) fn groups(&self, [width, height]: [u32; 2]) -> [u32; 3] {
        [width.div_ceil(self.workgroup[0]), height.div_ceil(self.workgroup[1]), 1]
    }
}

impl Pipeline {
    /// Compiles a stage, with the device's pipeline cache.
    pub(crate) fn new(device: &Arc<Device>, stage: &Stage) -> Result<Self, Error> {
        Self::variant(device, stage, Variant::NONE)
    }

    /// Compiles a variant of a stage, with the device's pipeline cache.
    pub(crate) fn variant(device: &Arc<Device>, stage: &Stage, variant: Variant) -> Result<Self, Error> {
        Self::with_flags(device, stage, variant, vk::PipelineCreateFlags::empty())
    }

    pub(super) fn with_flags(
        device: &Arc<Device>,
        stage: &Stage,
        variant: Variant,
        flags: vk::PipelineCreateFlags,
    ) -> Result<Self, Error> {
        let name = stage.shader.name;
        let mut pipeline = Self {
            handle: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            bindings: stage.bindings,
            constant_bytes: stage.constant_bytes,
            name,
            device: device.clone(),
        };
        pipeline.create_layouts()?;
        pipeline.compile(stage, variant, flags)?;
        device.name(pipeline.handle, name);
        Ok(pipeline)
    }

    fn create_layouts(&mut self) -> Result<(), Error> {
        let device = &self.device;
        let bindings: Vec<_> = (0..)
            .zip(self.bindings)
            .map(|(index, binding)| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(index)
                    .descriptor_type(binding.kind.descriptor_type())
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: the bindings are valid and outlive the call.
        let created = unsafe { device.handle.create_descriptor_set_layout(&create, None) };
        self.set_layout = device.check("vkCreateDescriptorSetLayout", created)?;
        let set_layouts = [self.set_layout];
        let ranges = [vk::PushConstantRange {
            stage_flags: vk::ShaderStageFlags::COMPUTE,
            offset: 0,
            size: u32::try_from(self.constant_bytes).unwrap_or(u32::MAX),
        }];
        let mut create = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts);
        if self.constant_bytes > 0 {
            create = create.push_constant_ranges(&ranges);
        }
        // SAFETY: the set layout belongs to this device; the range is within the 128 bytes that every device supports.
        let created = unsafe { device.handle.create_pipeline_layout(&create, None) };
        self.layout = device.check("vkCreatePipelineLayout", created)?;
        Ok(())
    }

    /// Width and height of a workgroup, which is smaller on devices that do not take its invocations.
    fn workgroup(&self, stage: &Stage) -> [u32; 2] {
        let most = self.device.physical.limits.max_compute_work_group_invocations;
        let [width, height] = stage.workgroup;
        [width, height.min(most / width)]
    }

    fn compile(&mut self, stage: &Stage, variant: Variant, flags: vk::PipelineCreateFlags) -> Result<(), Error> {
        let device = &self.device;
        let spirv: Vec<u32> = bytemuck::pod_collect_to_vec(stage.shader.spirv);
        let create = vk::ShaderModuleCreateInfo::default().code(&spirv);
        // SAFETY: the words are SPIR-V from shaderc.
        let module = unsafe { device.handle.create_shader_module(&create, None) };
        let module = device.check("vkCreateShaderModule", module)?;
        let entries =
            [0, 1, 2, 3, 4, 5, 6, 7].map(|id| vk::SpecializationMapEntry { constant_id: id, offset: id * 4, size: 4 });
        let workgroup = self.workgroup(stage);
        let constants: [u32; 8] = std::array::from_fn(|id| match workgroup.get(id) {
            Some(&side) => side,
            None => variant.constant(id as u32),
        });
        let specialization =
            vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(&constants));
        let shader = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&specialization);
        let create = [vk::ComputePipelineCreateInfo::default().flags(flags).stage(shader).layout(self.layout)];
        // SAFETY: module, layout and cache belong to this device; the referenced structures outlive the call.
        let created = unsafe { device.handle.create_compute_pipelines(device.pipeline_cache, &create, None) };
        // SAFETY: a pipeline does not need its module after its creation.
        unsafe { device.handle.destroy_shader_module(module, None) };
        let created = created.map_err(|(_, result)| result);
        self.handle = device.check(&format!("compiling {}", self.name), created)?[0];
        Ok(())
    }
}

impl Drop for Pipeline {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: the recordings that use the pipeline are complete; destroying a null handle has no effect.
        unsafe {
            self.device.handle.destroy_pipeline(self.handle, None);
            self.device.handle.destroy_pipeline_layout(self.layout, None);
            self.device.handle.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// A resource of a dispatch, in the order of the stage's bindings.
#[derive(Clone, Copy)]
pub(crate) enum Resource<'a> {
    Image(&'a Arc<Image>),
    Buffer(&'a Arc<Buffer>),
    Uniform(&'a Arc<Buffer>),
}

/// The number of descriptor sets per pool.
const SETS_PER_POOL: u32 = 128;

/// The descriptor sets of a recording, each created once, and the resources that they retain.
pub(super) struct DescriptorSets {
    device: Arc<Device>,
    pools: Vec<vk::DescriptorPool>,
    /// The number of sets that the last pool can still allocate.
    free_sets: u32,
    sets: HashMap<(vk::Pipeline, Vec<u64>), vk::DescriptorSet>,
    retained: Vec<Arc<dyn Any + Send + Sync>>,
}

impl DescriptorSets {
    pub(super) fn new(device: &Arc<Device>) -> Self {
        Self { device: device.clone(), pools: Vec::new(), free_sets: 0, sets: HashMap::new(), retained: Vec::new() }
    }

    /// Returns the set that binds the resources of a pipeline.
    pub(super) fn get(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
    ) -> Result<vk::DescriptorSet, Error> {
        let kinds: Vec<_> = resources.iter().map(|r| r.kind().descriptor_type()).collect();
        let expected: Vec<_> = pipeline.bindings.iter().map(|b| b.kind.descriptor_type()).collect();
        assert_eq!(kinds, expected, "resources of {}", pipeline.name);
        let key = (pipeline.handle, resources.iter().map(|r| r.id()).collect::<Vec<_>>());
        if let Some(&set) = self.sets.get(&key) {
            return Ok(set);
        }
        let set = self.allocate(pipeline)?;
        for (index, (resource, binding)) in (0..).zip(resources.iter().zip(pipeline.bindings)) {
            self.write(set, index, *resource, binding.kind);
        }
        self.retained.push(pipeline.clone());
        self.sets.insert(key, set);
        Ok(set)
    }

    fn allocate(&mut self, pipeline: &Pipeline) -> Result<vk::DescriptorSet, Error> {
        if self.free_sets == 0 {
            // No stage has more than twelve bindings of a kind.
            let sizes = [Kind::Image, Kind::Buffer, Kind::Uniform].map(|kind| vk::DescriptorPoolSize {
                ty: kind.descriptor_type(),
                descriptor_count: 12 * SETS_PER_POOL,
            });
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(SETS_PER_POOL).pool_sizes(&sizes);
            // SAFETY: the sizes are not zero and outlive the call.
            let pool = unsafe { self.device.handle.create_descriptor_pool(&create, None) };
            self.pools.push(self.device.check("vkCreateDescriptorPool", pool)?);
            self.free_sets = SETS_PER_POOL;
        }
        self.free_sets -= 1;
        let layouts = [pipeline.set_layout];
        let pool = self.pools.last().copied().unwrap_or_default();
        let create = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool can allocate another set, and only this recording uses it.
        let sets = unsafe { self.device.handle.allocate_descriptor_sets(&create) };
        Ok(self.device.check("vkAllocateDescriptorSets", sets)?[0])
    }

    fn write(&mut self, set: vk::DescriptorSet, index: u32, resource: Resource<'_>, kind: Kind) {
        let write =
            vk::WriteDescriptorSet::default().dst_set(set).dst_binding(index).descriptor_type(kind.descriptor_type());
        match resource {
            Resource::Image(image) => {
                let view = if kind == Kind::Words { image.words } else { image.view };
                let info = [vk::DescriptorImageInfo::default().image_view(view).image_layout(vk::ImageLayout::GENERAL)];
                // SAFETY: the set is new, so that no submission uses it; the view is retained, and has the type of the
                // shader's declaration.
                unsafe { self.device.handle.update_descriptor_sets(&[write.image_info(&info)], &[]) };
                self.retained.push(image.clone());
            }
            Resource::Buffer(buffer) | Resource::Uniform(buffer) => {
                let info = [vk::DescriptorBufferInfo { buffer: buffer.handle, offset: 0, range: vk::WHOLE_SIZE }];
                // SAFETY: the set is new, so that no submission uses it; the buffer is retained.
                unsafe { self.device.handle.update_descriptor_sets(&[write.buffer_info(&info)], &[]) };
                self.retained.push(buffer.clone());
            }
        }
    }
}

impl Drop for DescriptorSets {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        for &pool in &self.pools {
            // SAFETY: the recording of the sets is complete, or was never submitted.
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
