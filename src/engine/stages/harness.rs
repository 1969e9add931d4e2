//! The test rig: runs one pass on a device under validation, and notes figures for `docs/reliability.md`.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock, Mutex};

use half::f16;

use super::stack::{Layer, Sampling, Slopes, White, layer};
use super::{Field, NO_VARIANT, separable, subdivide};
use crate::base::{Frame, Kernel};
use crate::engine::vulkan::{
    Buffer, Clock, Device, Image, Pipeline, Recorder, Resource, Stage, Texel, Variant, Workgroups,
};
use crate::engine::{EngineOptions, filter};

/// The device that PARFOCAL_DEVICE names, or the default one, with validation unless PARFOCAL_VALIDATE is 0.
pub(crate) fn options() -> EngineOptions {
    EngineOptions {
        device: std::env::var("PARFOCAL_DEVICE").ok().or(Some("vulkan".into())),
        validation: std::env::var("PARFOCAL_VALIDATE").as_deref() != Ok("0"),
        ..EngineOptions::default()
    }
}

/// The device that PARFOCAL_DEVICE names, or the CPU device: for results that are the same on all devices.
pub(crate) fn on_any() -> EngineOptions {
    let device = std::env::var("PARFOCAL_DEVICE").unwrap_or_else(|_| "cpu".into());
    EngineOptions { validation: device != "cpu" && options().validation, device: Some(device), ..options() }
}

/// The environment variable that names the file in which `tools/trust` collects figures.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<std::ffi::OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Whether this run tries all cases. Otherwise it tries a share.
pub(crate) fn is_long() -> bool {
    notes().is_some()
}

/// Appends a figure for `docs/reliability.md`.
pub(crate) fn note(name: &str, figure: &str) {
    use std::io::Write;

    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
        // In one write: tests run in parallel.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}

/// A device that all tests share. Validation messages fail the test that drops the rig first.
pub(crate) struct Rig {
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
}

/// Pipelines by shader, workgroup and variant: on lavapipe compiling one takes longer than running it.
type Pipelines = Mutex<BTreeMap<(&'static str, [u32; 2], Variant), Arc<Pipeline>>>;

/// Opened once: opening a device under validation takes as long as most tests.
static SHARED: LazyLock<(Arc<Device>, Arc<Pipelines>)> = LazyLock::new(|| (open(), Arc::default()));

fn open() -> Arc<Device> {
    crate::engine::open(&options()).unwrap().as_vulkan().expect("a Vulkan device").clone()
}

impl Rig {
    pub(crate) fn new() -> Self {
        let (device, pipelines) = SHARED.clone();
        Self { device, pipelines }
    }

    /// A rig with a device of its own, for a test that provokes messages.
    pub(crate) fn alone() -> Self {
        Self { device: open(), pipelines: Arc::default() }
    }

    pub(crate) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Whether validation is enabled.
    pub(crate) fn validates(&self) -> bool {
        options().validation
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

    /// A mapped buffer with these numbers in single precision.
    pub(crate) fn numbers(&self, numbers: impl IntoIterator<Item = f64>) -> Arc<Buffer> {
        let numbers: Vec<f32> = numbers.into_iter().map(|number| number as f32).collect();
        self.upload(bytemuck::cast_slice(&numbers))
    }

    /// A bank of filter weights that holds a filter from an offset on, in units of four weights, and 9 before it.
    pub(crate) fn filter(&self, offset: u32, filter: &[f64]) -> Arc<Buffer> {
        let mut weights = [vec![9.0; 4 * offset as usize], filter.to_vec()].concat();
        weights.resize(separable::WEIGHTS, 0.0);
        self.numbers(weights)
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

    /// An image of blur stacks with the layers of I1, then of I2, packed.
    pub(crate) fn packed(&self, layers: &[Field], white: White) -> Arc<Image> {
        let (first, second) = layers.split_at(layers.len() / 2);
        let bits = |c: f64| u32::from(white.root(c) as u16);
        let texel = |(a, b): (&f64, &f64)| bits(*a) | bits(*b) << 16;
        let texels = first.iter().zip(second).flat_map(|(a, b)| a.data.iter().zip(&b.data).map(texel));
        let staging = self.upload(bytemuck::cast_slice(&texels.collect::<Vec<u32>>()));
        let size = [layers[0].width as u32, layers[0].height as u32];
        let image = Image::new(self.device(), "packed image", size, first.len() as u32, Texel::One).unwrap();
        self.record(|recorder, _| {
            recorder.initialize(&[&image]);
            recorder.copy_buffer_to_image(&staging, &image);
        });
        image
    }

    /// The layers of I1, then of I2, of packed blur stacks.
    pub(crate) fn unpacked(&self, image: &Arc<Image>, white: White) -> Vec<Field> {
        let (width, height) = (image.width as usize, image.height as usize);
        let staging = self.upload(&vec![0; 4 * width * height * image.layers as usize]);
        self.record(|recorder, _| recorder.copy_image_to_buffer(image, 0..image.layers, &staging));
        let texels = self.words(&staging);
        let layers = [0, 16].map(|bit| {
            let coefficient = |texel: &u32| white.coefficient((texel >> bit) as u16 as i16);
            let layer = |texels: &[u32]| Field { width, height, data: texels.iter().map(coefficient).collect() };
            texels.chunks_exact(width * height).map(layer).collect::<Vec<_>>()
        });
        layers.concat()
    }

    /// Records and runs commands.
    pub(crate) fn record(&self, fill: impl FnOnce(&mut Recorder, &dyn Fn(&Stage) -> Arc<Pipeline>)) {
        let mut recorder = Recorder::new(self.device(), Clock::Never).unwrap();
        fill(&mut recorder, &|stage| self.pipeline(stage, NO_VARIANT));
        recorder.finish().unwrap().run().unwrap();
    }

    /// Runs one pass with `groups` workgroups.
    pub(crate) fn run_groups<C: bytemuck::Pod>(
        &self,
        stage: &Stage,
        resources: &[Resource<'_>],
        constants: &C,
        groups: [u32; 3],
    ) {
        self.run_variant(stage, NO_VARIANT, resources, constants, groups);
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
        self.run_bytes(stage, variant, resources, bytemuck::bytes_of(constants), groups);
    }

    /// The same with push constants as bytes.
    pub(crate) fn run_bytes(
        &self,
        stage: &Stage,
        variant: Variant,
        resources: &[Resource<'_>],
        constants: &[u8],
        groups: [u32; 3],
    ) {
        let pipeline = self.pipeline(stage, variant);
        self.record(|recorder, _| {
            recorder.dispatch(&pipeline, resources, constants, Workgroups::Direct(groups)).unwrap();
        });
    }

    /// The pipeline of a variant. No lock is held while it is compiled: two tests at once may both compile it.
    fn pipeline(&self, stage: &Stage, variant: Variant) -> Arc<Pipeline> {
        let key = (stage.shader.name, stage.workgroup, variant);
        let compiled = self.pipelines.lock().unwrap().get(&key).cloned();
        compiled.unwrap_or_else(|| {
            let pipeline = Arc::new(Pipeline::variant(self.device(), stage, variant).unwrap());
            self.pipelines.lock().unwrap().insert(key, pipeline.clone());
            pipeline
        })
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
        assert_all_close(&self.layers(image), expected, tolerance);
    }
}

/// Asserts that each number of the layers is within `tolerance` of the expected one, or both are NaN. Around an
/// expected layer that is smaller, 0 is expected.
#[track_caller]
pub(crate) fn assert_all_close(actual: &[Field], expected: &[Field], tolerance: f64) {
    assert_eq!(actual.len(), expected.len(), "layers");
    for (layer, (actual, expected)) in actual.iter().zip(expected).enumerate() {
        for (i, &f) in actual.data.iter().enumerate() {
            let (x, y) = (i % actual.width, i / actual.width);
            let e = if x < expected.width && y < expected.height { expected.get(x, y) } else { 0.0 };
            let close = (f - e).abs() <= tolerance || (f.is_nan() && e.is_nan());
            assert!(close, "layer {layer}, ({x}, {y}): {f}, not {e} ± {tolerance}");
        }
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        let messages = self.take_messages();
        assert!(std::thread::panicking() || messages.is_empty(), "validation: {messages:#?}");
    }
}

/// Asserts that each number is within `tolerance` of the expected one, or both are NaN.
#[track_caller]
pub(crate) fn assert_numbers(actual: &[f32], expected: &[f64], tolerance: f64) {
    for (n, (f, e)) in actual.iter().map(|&f| f64::from(f)).zip(expected).enumerate() {
        assert!((f - e).abs() <= tolerance || (f.is_nan() && e.is_nan()), "{n}: {f}, not {e} ± {tolerance}");
    }
}

/// The layers of an image's [blur stack](super::stack), by direct filters: spline coefficients first.
pub(crate) fn build_stack(image: &Field, kernel: &Kernel, nodes: usize) -> Vec<Field> {
    let prefilter = filter::spline_prefilter();
    let mut stack = vec![separable::filtered(image, [&prefilter; 2], 1)];
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
            let term = separable::filtered(&stack[from], [along_x, along_y], 1);
            sum.data.iter_mut().zip(term.data).for_each(|(sum, t)| *sum += t);
        }
        stack.push(sum);
    }
    stack
}

/// A layer on every other pixel of the image.
fn on_half(from: &Field, [along_x, along_y]: &[filter::Filter; 2], sampling: Sampling, image: &Field) -> Field {
    if sampling == Sampling::Halving {
        return separable::filtered(from, [along_x, along_y], 2);
    }
    separable::filtered_mirrored(from, [along_x, along_y], 1, [image.width - 1, image.height - 1])
}

/// Two photographs of a smooth texture. The first has the more contrast.
pub(crate) fn pair([width, height]: [u32; 2]) -> [Frame; 2] {
    [0.4, 0.3].map(|soft| {
        let value = |i: u32| 0.5 + soft * ((i % width) as f32 * 1.1).sin() * ((i / width) as f32 * 0.9).cos();
        Frame::gray(width, height, (0..width * height).map(value).collect()).unwrap()
    })
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

/// White noise in [0, 1).
pub(crate) fn random_field(width: usize, height: usize, seed: u64) -> Field {
    Field { width, height, data: random(width * height, seed) }
}

/// White noise smoothed to σ 2 px, around ½.
pub(crate) fn smooth_field(width: usize, height: usize, seed: u64) -> Field {
    let mut field = separable::smoothed(&random_field(width, height, seed), 2.0);
    field.data.iter_mut().for_each(|v| *v = 0.5 + 3.0 * (*v - 0.5));
    field
}
