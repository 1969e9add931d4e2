//! A test rig that runs one pass on a device under validation, with fields as input and output.

use std::sync::{Arc, LazyLock};

use half::f16;

use super::stack::{Layer, Sampling, Slopes, layer};
use super::{Field, convolve, subdivide};
use crate::base::{Channels, Frame, Kernel, Samples};
use crate::engine::filter;
use crate::engine::vulkan::{
    Buffer, Clock, Device, Image, Pipeline, Recorder, Resource, Stage, Texel, Variant, Workgroups,
};

/// A device that all tests share. Validation messages fail the test that drops the rig first.
pub(crate) struct Rig {
    device: Arc<Device>,
}

/// Opened once: opening a device under validation takes as long as most tests.
static SHARED: LazyLock<Arc<Device>> = LazyLock::new(open);

fn open() -> Arc<Device> {
    crate::engine::open(&crate::engine::testing::options()).unwrap()
}

impl Rig {
    pub(crate) fn new() -> Self {
        Self { device: SHARED.clone() }
    }

    /// A rig with a device of its own, for a test that provokes messages.
    pub(crate) fn alone() -> Self {
        Self { device: open() }
    }

    pub(crate) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Whether validation is enabled.
    pub(crate) fn validates(&self) -> bool {
        crate::engine::testing::options().validation
    }

    /// Takes the validation messages so far, which then no longer fail the test.
    pub(crate) fn take_messages(&self) -> Vec<String> {
        self.device().instance.take_messages()
    }

    /// A mapped buffer with these bytes.
    pub(crate) fn upload(&self, bytes: &[u8]) -> Arc<Buffer> {
        let buffer = Buffer::for_readback(self.device(), "test buffer", bytes.len() as u64).unwrap();
        buffer.write(bytes).unwrap();
        buffer
    }

    /// An image of zeros.
    pub(crate) fn empty(&self, [width, height]: [u32; 2], layers: usize) -> Arc<Image> {
        self.image(&vec![Field::zeros(width as usize, height as usize); layers])
    }

    /// An image with this layer.
    pub(crate) fn field(&self, field: &Field) -> Arc<Image> {
        self.image(std::slice::from_ref(field))
    }

    /// An image with these layers.
    pub(crate) fn image(&self, layers: &[Field]) -> Arc<Image> {
        self.image_of(layers, Texel::One)
    }

    /// An image with four half-precision floats per pixel, which are adjacent in the fields.
    pub(crate) fn weights(&self, layers: &[Field]) -> Arc<Image> {
        self.image_of(layers, Texel::FourHalf)
    }

    fn image_of(&self, layers: &[Field], texel: Texel) -> Arc<Image> {
        let size = [(layers[0].width / texel.floats()) as u32, layers[0].height as u32];
        let image = Image::new(self.device(), "test image", size, layers.len() as u32, texel).unwrap();
        let values = layers.iter().flat_map(Field::to_f32);
        let bytes: Vec<u8> = match texel {
            Texel::One => values.flat_map(f32::to_le_bytes).collect(),
            Texel::FourHalf => values.flat_map(|v| f16::from_f32(v).to_le_bytes()).collect(),
        };
        let staging = self.upload(&bytes);
        self.record(|recorder, _| {
            recorder.initialize(&[&image]);
            recorder.copy_buffer_to_image(&staging, &image);
        });
        image
    }

    /// Records and runs commands.
    pub(crate) fn record(&self, fill: impl FnOnce(&mut Recorder, &dyn Fn(&Stage) -> Arc<Pipeline>)) {
        let mut recorder = Recorder::new(self.device(), Clock::Never).unwrap();
        fill(&mut recorder, &|stage| Arc::new(Pipeline::new(self.device(), stage).unwrap()));
        recorder.finish().unwrap().run().unwrap();
    }

    /// Runs one pass with `size` invocations.
    pub(crate) fn run<C: bytemuck::Pod>(
        &self,
        stage: &Stage,
        resources: &[Resource<'_>],
        constants: &C,
        size: [u32; 2],
    ) {
        let groups = [size[0].div_ceil(stage.workgroup[0]), size[1].div_ceil(stage.workgroup[1]), 1];
        self.run_groups(stage, resources, constants, groups);
    }

    /// Runs one pass with `groups` workgroups.
    pub(crate) fn run_groups<C: bytemuck::Pod>(
        &self,
        stage: &Stage,
        resources: &[Resource<'_>],
        constants: &C,
        groups: [u32; 3],
    ) {
        self.run_variant(stage, [false; 4], resources, constants, groups);
    }

    /// Runs a variant of a pass with `groups` workgroups.
    pub(crate) fn run_variant<C: bytemuck::Pod>(
        &self,
        stage: &Stage,
        variant: Variant,
        resources: &[Resource<'_>],
        constants: &C,
        groups: [u32; 3],
    ) {
        let pipeline = Arc::new(Pipeline::variant(self.device(), stage, variant).unwrap());
        self.record(|recorder, _| {
            recorder.dispatch(&pipeline, resources, bytemuck::bytes_of(constants), Workgroups::Direct(groups)).unwrap();
        });
    }

    /// The layers of an image.
    pub(crate) fn layers(&self, image: &Arc<Image>) -> Vec<Field> {
        let (width, height) = (image.width as usize * image.texel.floats(), image.height as usize);
        let count = width * height * image.layers as usize;
        let staging = self.upload(&vec![0; count * if image.texel == Texel::One { 4 } else { 2 }]);
        self.record(|recorder, _| recorder.copy_image_to_buffer(image, 0..image.layers, &staging));
        let values: Vec<f32> = match image.texel {
            Texel::One => self.floats(&staging),
            Texel::FourHalf => {
                staging.read(0, count).unwrap().into_iter().map(|v| f16::from_bits(v).to_f32()).collect()
            }
        };
        values.chunks_exact(width * height).map(|l| Field::from_f32(width, height, l)).collect()
    }

    pub(crate) fn floats(&self, buffer: &Buffer) -> Vec<f32> {
        buffer.read(0, buffer.size() as usize / 4).unwrap()
    }

    pub(crate) fn words(&self, buffer: &Buffer) -> Vec<u32> {
        buffer.read(0, buffer.size() as usize / 4).unwrap()
    }

    pub(crate) fn value<T: bytemuck::Pod>(&self, buffer: &Buffer) -> T {
        buffer.read(0, 1).unwrap()[0]
    }

    /// Asserts that each number of the image is within `tolerance` of the expected one, or both are NaN.
    #[track_caller]
    pub(crate) fn assert_close(&self, image: &Arc<Image>, expected: &[Field], tolerance: f64) {
        let actual = self.layers(image);
        assert_eq!(actual.len(), expected.len(), "layers");
        for (layer, (actual, expected)) in actual.iter().zip(expected).enumerate() {
            for (i, (f, e)) in actual.data.iter().zip(&expected.data).enumerate() {
                let (x, y) = (i % actual.width, i / actual.width);
                let close = (f - e).abs() <= tolerance || (f.is_nan() && e.is_nan());
                assert!(close, "layer {layer}, ({x}, {y}): {f}, not {e} ± {tolerance}");
            }
        }
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        let messages = self.take_messages();
        assert!(std::thread::panicking() || messages.is_empty(), "validation: {messages:#?}");
    }
}

/// The layers of an image's [blur stack](super::stack), by direct filters: spline coefficients first.
pub(crate) fn build_stack(image: &Field, kernel: &Kernel, nodes: usize) -> Vec<Field> {
    let prefilter = filter::spline_prefilter();
    let mut stack =
        vec![convolve::cpu_reference(&convolve::cpu_reference(image, &prefilter, 1, false), &prefilter, 1, true)];
    // The last layer computed on every other pixel, before subdivision.
    let mut half: Option<Field> = None;
    for n in 1..nodes * Slopes::of(kernel).layers() {
        let Layer { from, sampling, terms } = layer(kernel, n);
        if sampling != Sampling::Every {
            let made = on_half(half.as_ref().unwrap_or(&stack[from]), &terms[0], sampling, image);
            stack.push(subdivide::cpu_reference([image.width, image.height], &made));
            half = Some(made);
            continue;
        }
        let mut sum = Field::zeros(image.width, image.height);
        for [along_x, along_y] in &terms {
            let term =
                convolve::cpu_reference(&convolve::cpu_reference(&stack[from], along_x, 1, false), along_y, 1, true);
            sum.data.iter_mut().zip(term.data).for_each(|(sum, t)| *sum += t);
        }
        stack.push(sum);
    }
    stack
}

/// A layer on every other pixel of the image.
fn on_half(from: &Field, [along_x, along_y]: &[filter::Filter; 2], sampling: Sampling, image: &Field) -> Field {
    if sampling == Sampling::Halving {
        return convolve::cpu_reference(&convolve::cpu_reference(from, along_x, 2, false), along_y, 2, true);
    }
    let rows = convolve::cpu_reference_mirrored(from, along_x, 1, false, image.width - 1);
    convolve::cpu_reference_mirrored(&rows, along_y, 1, true, image.height - 1)
}

/// Numbers in [0, 1), reproducible by the seed (splitmix64).
pub(crate) fn random(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    std::iter::repeat_with(|| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    })
    .take(count)
    .collect()
}

/// Frames of each number of channels and depth, in some odd sizes.
pub(crate) fn frames() -> Vec<Frame> {
    let mut frames = Vec::new();
    for (width, height) in [(37, 19), (16, 16), (33, 8)] {
        for channels in [Channels::Gray, Channels::Rgb] {
            let values = random((width * height * channels.count()) as usize, 3);
            let samples = [
                Samples::U8(values.iter().map(|v| (v * 255.0) as u8).collect()),
                Samples::U16(values.iter().map(|v| (v * 65535.0) as u16).collect()),
                Samples::F32(values.iter().map(|&v| v as f32).collect()),
            ];
            frames.extend(samples.map(|samples| Frame::new(width, height, channels, samples).unwrap()));
        }
    }
    frames
}

/// White noise in [0, 1).
pub(crate) fn random_field(width: usize, height: usize, seed: u64) -> Field {
    Field { width, height, data: random(width * height, seed) }
}

/// White noise smoothed to σ 2 px, around ½.
pub(crate) fn smooth_field(width: usize, height: usize, seed: u64) -> Field {
    let filter = filter::gaussian(4.0);
    let noise = random_field(width, height, seed);
    let mut field =
        super::convolve::cpu_reference(&super::convolve::cpu_reference(&noise, &filter, 1, false), &filter, 1, true);
    field.data.iter_mut().for_each(|v| *v = 0.5 + 3.0 * (*v - 0.5));
    field
}
