//! Compute pipelines.

use std::sync::Arc;

use ash::vk;

use super::device::Device;
use crate::base::Error;
use crate::engine::shaders::Shader;

/// How a shader sees what it binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// An array image of one or four floats a texel.
    Image,
    /// A storage buffer.
    Buffer,
    /// A uniform buffer.
    Uniform,
}

/// What a shader does to what it binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Read,
    Write,
    Update,
}

/// One thing that a shader binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Binding {
    pub(crate) kind: Kind,
    pub(crate) access: Access,
}

/// Specialization constants 2 to 5 of a stage, which compile variants of it.
pub(crate) type Variant = [bool; 4];

/// A shader, what it binds in order, and the bytes of its push constants.
#[derive(Debug)]
pub(crate) struct Stage {
    pub(crate) shader: &'static Shader,
    pub(crate) bindings: &'static [Binding],
    pub(crate) constant_bytes: usize,
    /// Workgroup width and height, specialization constants 0 and 1.
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
            Kind::Image => vk::DescriptorType::STORAGE_IMAGE,
            Kind::Buffer => vk::DescriptorType::STORAGE_BUFFER,
            Kind::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
        }
    }
}

impl Stage {
    /// Workgroups that cover `width` x `height` invocations.
    pub(crate) fn groups(&self, [width, height]: [u32; 2]) -> [u32; 3] {
        [width.div_ceil(self.workgroup[0]), height.div_ceil(self.workgroup[1]), 1]
    }
}

impl Pipeline {
    /// Compiles a stage, through the device's cache.
    pub(crate) fn new(device: &Arc<Device>, stage: &Stage) -> Result<Self, Error> {
        Self::variant(device, stage, [false; 4])
    }

    /// Compiles a stage with its specialization constants 2 to 5, all bool, as given.
    pub(crate) fn variant(device: &Arc<Device>, stage: &Stage, variant: Variant) -> Result<Self, Error> {
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
        pipeline.compile(stage, variant)?;
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
        // SAFETY: the device is alive; `bindings` outlives the call.
        let made = unsafe { device.handle.create_descriptor_set_layout(&create, None) };
        self.set_layout = device.check("vkCreateDescriptorSetLayout", made)?;
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
        // SAFETY: the set layout belongs to this device; the range is within the 128 bytes that every device has.
        let made = unsafe { device.handle.create_pipeline_layout(&create, None) };
        self.layout = device.check("vkCreatePipelineLayout", made)?;
        Ok(())
    }

    fn compile(&mut self, stage: &Stage, variant: Variant) -> Result<(), Error> {
        let device = &self.device;
        let spirv: Vec<u32> = bytemuck::pod_collect_to_vec(stage.shader.spirv);
        let create = vk::ShaderModuleCreateInfo::default().code(&spirv);
        // SAFETY: the words are SPIR-V that shaderc made.
        let module = unsafe { device.handle.create_shader_module(&create, None) };
        let module = device.check("vkCreateShaderModule", module)?;
        let entries =
            [0u32, 1, 2, 3, 4, 5].map(|id| vk::SpecializationMapEntry { constant_id: id, offset: id * 4, size: 4 });
        let [width, height] = stage.workgroup;
        let constants = [width, height, variant[0].into(), variant[1].into(), variant[2].into(), variant[3].into()];
        let specialization =
            vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(&constants));
        let shader = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&specialization);
        let create = [vk::ComputePipelineCreateInfo::default().stage(shader).layout(self.layout)];
        // SAFETY: module, layout and cache belong to this device; everything pointed to outlives the call.
        let made = unsafe { device.handle.create_compute_pipelines(device.pipeline_cache, &create, None) };
        // SAFETY: a pipeline no longer needs its module once it is made.
        unsafe { device.handle.destroy_shader_module(module, None) };
        let made = made.map_err(|(_, result)| result);
        self.handle = device.check(&format!("compiling {}", self.name), made)?[0];
        Ok(())
    }
}

impl Drop for Pipeline {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: recordings that use the pipeline were waited for; destroying a null handle does nothing.
        unsafe {
            self.device.handle.destroy_pipeline(self.handle, None);
            self.device.handle.destroy_pipeline_layout(self.layout, None);
            self.device.handle.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}
