//! The test rig: runs one pass on a device under validation, and notes figures for `docs/reliability.md`.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock, Mutex};

use half::f16;

use super::pass::{Memory, Pass};
use super::stack::{self, Layer, Sampling, Slopes, White, layer};
use super::state::{DoubleState, Registration, State};
use super::sums::{Layout, Sums};
use super::{Field, NO_VARIANT, separable, subdivide};
use crate::base::{Channels, Frame, Kernel, Mask, Samples};
use crate::engine::slot::Slot;
use crate::engine::vulkan::{
    Access, Buffer, Clock, Device, Image, Kind, Pipeline, Recorder, Resource, Stage, Texel, Variant, Workgroups,
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
        let pipeline = self.pipeline(stage, variant);
        self.record(|recorder, _| {
            recorder.dispatch(&pipeline, resources, bytemuck::bytes_of(constants), Workgroups::Direct(groups)).unwrap();
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

/// What a slot holds before a pass.
#[derive(Clone)]
pub(crate) enum Input<'a> {
    /// An image that the pass does not read.
    Unread,
    /// Layers of an image.
    Image(&'a [Field]),
    /// Partial sums, energies or filter weights.
    Numbers(&'a [f64]),
    /// Arguments, lists of tiles or bits of pixels.
    Words(&'a [u32]),
    State(&'a State),
    /// Samples of a photograph.
    Photograph(&'a Frame),
    /// A byte per pixel of I1.
    Mask(&'a Mask),
}

/// The slots after a pass, by its CPU reference and on a device, numbered as the shader binds them.
pub(crate) struct Trial {
    rig: Rig,
    stage: &'static Stage,
    /// White of packed blur stacks.
    white: Option<White>,
    expected: Memory<f64>,
    images: BTreeMap<usize, Arc<Image>>,
    buffers: BTreeMap<usize, Arc<Buffer>>,
}

fn slot(n: usize) -> Slot {
    Slot::Frames { level: n }
}

impl Trial {
    /// Runs a pass on slots with these contents, in the shader's order: `groups` workgroups on the device. Bindings of
    /// words are blur stacks; a variant for packed ones packs them.
    pub(crate) fn run<P: Pass>(
        inputs: &[Input<'_>],
        constants: &P::Constants,
        variant: Variant,
        groups: [u32; 3],
    ) -> Self {
        let (mut memory, bindings) = (Memory::new(), P::STAGE.bindings);
        let states =
            || inputs.iter().filter_map(|input| if let Input::State(state) = input { Some(*state) } else { None });
        let white = White::of(variant, states().next().map_or(0.0, |state| state.white.into()));
        let packs = |n: usize| white.filter(|_| bindings[n].kind == Kind::Words);
        for (n, input) in inputs.iter().enumerate() {
            match input {
                Input::Unread => {}
                Input::Image(layers) => {
                    let layers = layers.iter().map(|layer| stack::stored(layer.clone(), packs(n)));
                    memory.layers.insert(slot(n), layers.collect());
                }
                Input::Numbers(numbers) => drop(memory.numbers.insert(slot(n), numbers.to_vec())),
                Input::Words(words) => drop(memory.words.insert(slot(n), words.to_vec())),
                Input::State(state) => {
                    for slot in [slot(n), Slot::State] {
                        memory.states.insert(slot, (*state).into());
                    }
                }
                Input::Photograph(frame) => {
                    [0, 1].iter().for_each(|&image| memory.upload_photograph(image, (*frame).clone()))
                }
                Input::Mask(mask) => memory.upload_mask(Some((*mask).clone())),
            }
        }
        let slots: Vec<Slot> = (0..inputs.len()).map(slot).collect();
        P::of(&slots).run(constants, variant, &mut memory);

        let (rig, stage) = (Rig::new(), P::STAGE);
        let (mut images, mut buffers) = (BTreeMap::new(), BTreeMap::new());
        for (n, input) in inputs.iter().enumerate() {
            let mut image = |layers: &[Field]| drop(images.insert(n, rig.image(layers)));
            let mut buffer = |bytes: &[u8]| drop(buffers.insert(n, rig.upload(bytes)));
            match input {
                Input::Unread => image(&blank(memory.layers.get(&slot(n)))),
                Input::Image(layers) => match packs(n) {
                    Some(white) => drop(images.insert(n, rig.packed(layers, white))),
                    None => image(layers),
                },
                Input::Numbers(numbers) => drop(buffers.insert(n, rig.numbers(numbers.iter().copied()))),
                Input::Words(words) => buffer(bytemuck::cast_slice(words)),
                Input::State(state) => buffer(bytemuck::bytes_of(*state)),
                Input::Photograph(frame) => buffer(frame.bytes()),
                Input::Mask(mask) => buffer(mask.bytes()),
            }
        }
        let resources = stage.bindings.iter().enumerate().map(|(n, binding)| match binding.kind {
            Kind::Image | Kind::Words => Resource::Image(&images[&n]),
            Kind::Buffer => Resource::Buffer(&buffers[&n]),
            Kind::Uniform => Resource::Uniform(&buffers[&n]),
        });
        rig.run_variant(stage, variant, &resources.collect::<Vec<_>>(), constants, groups);
        Self { rig, stage, white, expected: memory, images, buffers }
    }

    /// Asserts that the images and states that the pass writes are within `tolerance` of those of the CPU reference.
    #[track_caller]
    pub(crate) fn assert_within(&self, tolerance: f64) {
        for n in (0..self.stage.bindings.len()).filter(|&n| self.stage.bindings[n].access != Access::Read) {
            if let Some(image) = self.images.get(&n) {
                let blank = Field::zeros(image.width as usize, image.height as usize);
                let written = |layer: &Field| if layer.data.is_empty() { blank.clone() } else { layer.clone() };
                let mut expected: Vec<Field> = self.layers(n).iter().map(written).collect();
                if let Some(white) = self.white.filter(|_| self.stage.bindings[n].kind == Kind::Words) {
                    assert_all_close(&self.rig.unpacked(image, white), &expected, tolerance);
                    continue;
                }
                expected.resize(image.layers as usize, blank.clone());
                self.rig.assert_close(image, &expected, tolerance);
            } else if self.expected.states.contains_key(&slot(n)) {
                let [actual, expected] = self.states(n).map(|state| {
                    let of = |r: &Registration| [&r.transform.matrix().concat()[..], &[r.gain, r.offset]].concat();
                    let own = vec![
                        state.correlation,
                        state.alpha,
                        state.kernel_shape,
                        state.spread,
                        state.scale_deviation,
                        state.correlated,
                        state.unit,
                        state.white,
                    ];
                    let shading = [state.shading, state.applied_shading].map(|s| s.coefficients.to_vec()).concat();
                    [of(&state.registration), of(&state.warped), own, shading].concat()
                });
                let close = actual.iter().zip(&expected).all(|(a, e)| (a - e).abs() <= tolerance);
                assert!(close, "{actual:?}, not {expected:?} ± {tolerance}");
            }
        }
    }

    /// The state on the device, and by the CPU reference.
    pub(crate) fn states(&self, n: usize) -> [DoubleState; 2] {
        [(&self.rig.value::<State>(&self.buffers[&n])).into(), self.expected.states[&slot(n)].clone()]
    }

    /// Numbers on the device, and by the CPU reference.
    pub(crate) fn numbers(&self, n: usize) -> (Vec<f32>, &[f64]) {
        (self.rig.floats(&self.buffers[&n]), &self.expected.numbers[&slot(n)])
    }

    /// Words on the device, and by the CPU reference.
    pub(crate) fn words(&self, n: usize) -> [Vec<u32>; 2] {
        [self.rig.words(&self.buffers[&n]), self.expected.words[&slot(n)].clone()]
    }

    /// The sums of the registration on the device, and by the CPU reference.
    pub(crate) fn sums(&self, n: usize, layout: Layout) -> [Sums; 2] {
        let (actual, expected) = self.numbers(n);
        [Sums::from_partials(&actual, layout), Sums::from_partials(expected, layout)]
    }

    /// Layers of an image by the CPU reference.
    pub(crate) fn layers(&self, n: usize) -> &[Field] {
        &self.expected.layers[&slot(n)]
    }
}

/// Asserts that each number is within `tolerance` of the expected one, or both are NaN.
#[track_caller]
pub(crate) fn assert_numbers(actual: &[f32], expected: &[f64], tolerance: f64) {
    for (n, (f, e)) in actual.iter().map(|&f| f64::from(f)).zip(expected).enumerate() {
        assert!((f - e).abs() <= tolerance || (f.is_nan() && e.is_nan()), "{n}: {f}, not {e} ± {tolerance}");
    }
}

/// Zeros in the shape of an image that the CPU reference wrote.
fn blank(written: Option<&Vec<Field>>) -> Vec<Field> {
    let layers = written.map_or(&[][..], Vec::as_slice);
    let [width, height] = layers.last().map_or([1, 1], |last| [last.width, last.height]);
    vec![Field::zeros(width, height); layers.len().max(1)]
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
    let mut field = separable::smoothed(&random_field(width, height, seed), 2.0);
    field.data.iter_mut().for_each(|v| *v = 0.5 + 3.0 * (*v - 0.5));
    field
}
