//! Draws V into a wgpu texture.

use std::error::Error;

use parfocal::interop::ash::vk;
use parfocal::interop::{DeviceSolution, SharedQueue};
use wgpu::hal::{api::Vulkan, vulkan};

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// A texture with a picture of V, and the pipeline that draws it.
pub struct Canvas<'a> {
    device: &'a wgpu::Device,
    queue: &'a wgpu::Queue,
    shared_queue: &'a SharedQueue,
    size: [u32; 2],
    pipeline: wgpu::RenderPipeline,
    texture: wgpu::Texture,
    /// The host-visible copy.
    buffer: wgpu::Buffer,
}

impl<'a> Canvas<'a> {
    pub fn new(
        device: &'a wgpu::Device,
        queue: &'a wgpu::Queue,
        shared_queue: &'a SharedQueue,
        size: [u32; 2],
        range: f32,
    ) -> Self {
        let [width, height] = size;
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: u64::from(row(width) * height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self { device, queue, shared_queue, size, pipeline: pipeline(device, width, range), texture, buffer }
    }

    /// Submits a draw of V. The device waits for the results; the host does not.
    ///
    /// # Safety
    /// The picture is [read](Self::read) before the pair is dropped.
    pub unsafe fn draw(&self, results: &DeviceSolution) -> Result<(), Box<dyn Error>> {
        // SAFETY: the buffer belongs to this device and lives as long as the solver. wgpu does not destroy it.
        let v = unsafe {
            let raw = vulkan::Buffer::from_raw_externally_owned(results.buffer, Box::new(|| ()));
            let usage = wgpu::BufferUsages::STORAGE;
            let described =
                wgpu::BufferDescriptor { label: Some("V"), size: results.bytes, usage, mapped_at_creation: false };
            self.device.create_buffer_from_hal::<Vulkan>(raw, &described)
        };
        let commands = self.commands(&v);
        let _guard = self.shared_queue.acquire();
        // SAFETY: the semaphore belongs to this device. The queue is locked, so the next submission is the one below.
        unsafe {
            let queue = self.queue.as_hal::<Vulkan>().ok_or("wgpu is not on Vulkan")?;
            let stage = vk::PipelineStageFlags::FRAGMENT_SHADER;
            queue.add_wait_semaphore(results.semaphore, Some(results.value), stage);
        }
        self.queue.submit([commands]);
        Ok(())
    }

    fn commands(&self, v: &wgpu::Buffer) -> wgpu::CommandBuffer {
        let [width, height] = self.size;
        let bytes = std::num::NonZero::new(u64::from(4 * width * height));
        let v = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: v, offset: 0, size: bytes });
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: v }],
        });
        let view = self.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations::default(),
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row(width)), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout };
        encoder.copy_texture_to_buffer(self.texture.as_image_copy(), to, self.texture.size());
        encoder.finish()
    }

    /// Waits for the picture and returns its RGBA pixels, row by row.
    pub fn read(&self) -> Result<Vec<u8>, Box<dyn Error>> {
        self.buffer.map_async(wgpu::MapMode::Read, .., |mapped| mapped.expect("the buffer is mapped"));
        self.device.poll(wgpu::PollType::wait_indefinitely())?;
        let [width, _] = self.size.map(|n| n as usize);
        let rows = self.buffer.get_mapped_range(..)?;
        let picture =
            rows.chunks_exact(row(self.size[0]) as usize).flat_map(|row| &row[..4 * width]).copied().collect();
        drop(rows);
        self.buffer.unmap();
        Ok(picture)
    }
}

/// Returns the bytes per row that wgpu requires in copies.
fn row(width: u32) -> u32 {
    (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

fn pipeline(device: &wgpu::Device, width: u32, range: f32) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("blur.wgsl"));
    let constants = [("width", f64::from(width)), ("range", f64::from(range))];
    let compilation_options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("screen"),
            compilation_options: compilation_options.clone(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("blur"),
            compilation_options,
            targets: &[Some(FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
