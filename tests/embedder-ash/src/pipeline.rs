//! The graphics pipeline that draws V.

use std::io::Cursor;

use parfocal::interop::ash::{self, util, vk};

const SCREEN: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/screen.vert.spv"));
const BLUR: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/blur.frag.spv"));

/// Size of the push constants, bytes: the width, and |V| at which the colour saturates.
pub const CONSTANTS: u32 = 8;

/// A pipeline that draws V from a storage buffer, with its descriptor set.
pub struct Pipeline {
    pub handle: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    pub set: vk::DescriptorSet,
    set_layout: vk::DescriptorSetLayout,
    pool: vk::DescriptorPool,
}

impl Pipeline {
    pub fn new(device: &ash::Device, format: vk::Format) -> Result<Self, vk::Result> {
        let kind = vk::DescriptorType::STORAGE_BUFFER;
        let bindings = [vk::DescriptorSetLayoutBinding::default()
            .descriptor_type(kind)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::FRAGMENT)];
        let constants = [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::FRAGMENT).size(CONSTANTS)];
        let sizes = [vk::DescriptorPoolSize::default().ty(kind).descriptor_count(1)];
        // SAFETY: all handles belong to this device. The structs that are pointed to outlive the calls.
        unsafe {
            let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            let set_layout = device.create_descriptor_set_layout(&create, None)?;
            let set_layouts = [set_layout];
            let create =
                vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts).push_constant_ranges(&constants);
            let layout = device.create_pipeline_layout(&create, None)?;
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
            let pool = device.create_descriptor_pool(&create, None)?;
            let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&set_layouts);
            let set = device.allocate_descriptor_sets(&allocate)?[0];
            let handle = pipeline(device, layout, format)?;
            Ok(Self { handle, layout, set, set_layout, pool })
        }
    }

    /// Sets the buffer from which V is read.
    ///
    /// # Safety
    /// The buffer belongs to this device, and no draw is pending.
    pub unsafe fn read_from(&self, device: &ash::Device, buffer: vk::Buffer) {
        let buffers = [vk::DescriptorBufferInfo::default().buffer(buffer).range(vk::WHOLE_SIZE)];
        let write = vk::WriteDescriptorSet::default()
            .dst_set(self.set)
            .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
            .buffer_info(&buffers);
        // SAFETY: guaranteed by the caller.
        unsafe { device.update_descriptor_sets(&[write], &[]) };
    }

    /// # Safety
    /// No draw is pending, and none follows.
    pub unsafe fn destroy(&self, device: &ash::Device) {
        // SAFETY: guaranteed by the caller.
        unsafe {
            device.destroy_pipeline(self.handle, None);
            device.destroy_descriptor_pool(self.pool, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

fn shader(device: &ash::Device, spirv: &[u8]) -> Result<vk::ShaderModule, vk::Result> {
    let words = util::read_spv(&mut Cursor::new(spirv)).expect("SPIR-V");
    // SAFETY: shaderc generated the SPIR-V, so it is valid.
    unsafe { device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(&words), None) }
}

/// Creates a pipeline for dynamic rendering, without a render pass object.
fn pipeline(device: &ash::Device, layout: vk::PipelineLayout, format: vk::Format) -> Result<vk::Pipeline, vk::Result> {
    let modules = [shader(device, SCREEN)?, shader(device, BLUR)?];
    let stages = [vk::ShaderStageFlags::VERTEX, vk::ShaderStageFlags::FRAGMENT];
    let stage =
        |n: usize| vk::PipelineShaderStageCreateInfo::default().stage(stages[n]).module(modules[n]).name(c"main");
    let stages = [stage(0), stage(1)];
    let vertices = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
    let viewports = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
    let raster = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
    let samples = vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
    let attachments =
        [vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA)];
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&attachments);
    let formats = [format];
    let mut rendering = vk::PipelineRenderingCreateInfo::default().color_attachment_formats(&formats);
    let create = vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages)
        .vertex_input_state(&vertices)
        .input_assembly_state(&assembly)
        .viewport_state(&viewports)
        .dynamic_state(&dynamic)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .color_blend_state(&blend)
        .layout(layout)
        .push_next(&mut rendering);
    // SAFETY: all handles belong to this device, and the structs outlive the call. The shaders match the layout and the
    // format.
    unsafe {
        let made = device.create_graphics_pipelines(vk::PipelineCache::null(), &[create], None);
        modules.iter().for_each(|&module| device.destroy_shader_module(module, None));
        made.map(|pipelines| pipelines[0]).map_err(|(_, result)| result)
    }
}
