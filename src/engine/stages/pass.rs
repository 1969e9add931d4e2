//! A pass of a script: typed bindings, push constants, and the CPU reference at work on [`Memory`].

use std::collections::HashMap;
use std::ops::Range;

use bytemuck::Pod;

use super::stack::White;
use super::state::DoubleState;
use super::sums::{Layout, Sums};
use super::{Number, Raster, pixels};
use crate::base::{Frame, Mask};
#[cfg(test)]
use crate::engine::arguments::Grid;
use crate::engine::slot::{Readable, Slot, Writable};
use crate::engine::vulkan::{Access, Binding, Kind, Stage, Variant};

/// The bindings of a stage as a struct, which `build.rs` writes from the shader's text.
pub(crate) trait Bindings: Copy {
    /// The push constants.
    type Constants: Pod;
    /// The shader and its layout.
    const STAGE: &'static Stage;
    /// The slots in the shader's order.
    fn slots(&self) -> Vec<Slot>;
    /// The bindings of slots in the shader's order.
    fn of(slots: &[Slot]) -> Self;
    /// Width and height of the push constants; zero if there are none.
    fn size(constants: &Self::Constants) -> [u32; 2];
}

/// The bindings of a stage on a level, each to the slot that its name means. A script states the others:
/// `Bindings { to, ..Bindings::on(level) }`.
pub(crate) fn on<B: Bindings>(level: usize) -> B {
    B::of(&B::STAGE.bindings.iter().map(|binding| Slot::named(binding.name, level)).collect::<Vec<_>>())
}

/// A stage that scripts can dispatch.
pub(crate) trait Pass: Bindings {
    /// Compulsory traffic, bytes: each input element read once, each output element written once. By default a float
    /// per pixel of each image that is bound, two of one that is read and written. A pass that differs states its own.
    fn bytes(constants: &Self::Constants, _variant: Variant) -> u64 {
        let floats = |binding: &Binding| match (binding.kind, binding.access) {
            (Kind::Buffer | Kind::Uniform, _) => 0,
            (_, Access::Update) => 2,
            _ => 1,
        };
        let [width, height] = Self::size(constants);
        4 * Self::STAGE.bindings.iter().map(floats).sum::<u64>() * pixels(width, height)
    }
    /// Runs the CPU reference on the slots.
    fn run<N: Number>(&self, constants: &Self::Constants, variant: Variant, memory: &mut Memory<N>);
}

/// The contents of the slots, for the CPU references. A layer has the size of the field that was last written to it.
/// Slots that were never written must not be read.
pub(crate) struct Memory<N> {
    photographs: [Option<Frame>; 2],
    mask: Option<Mask>,
    pub(super) layers: HashMap<Slot, Vec<Raster<N>>>,
    pub(super) states: HashMap<Slot, DoubleState>,
    pub(super) numbers: HashMap<Slot, Vec<N>>,
    pub(super) words: HashMap<Slot, Vec<u32>>,
    /// Rasters whose memory passes use for what they do not store.
    spare: Vec<Raster<N>>,
}

impl<N: Number> Memory<N> {
    /// Memory in which nothing was written yet.
    pub(crate) fn new() -> Self {
        Self {
            photographs: [None, None],
            mask: None,
            layers: HashMap::new(),
            states: HashMap::new(),
            numbers: HashMap::new(),
            words: HashMap::new(),
            spare: Vec::new(),
        }
    }

    /// A raster of any size and contents.
    pub(super) fn take_spare(&mut self) -> Raster<N> {
        self.spare.pop().unwrap_or_default()
    }

    /// Keeps a raster for [`Self::take_spare`].
    pub(super) fn keep_spare(&mut self, raster: Raster<N>) {
        self.spare.push(raster);
    }

    /// Memory in which only the banks of filter weights were written.
    pub(crate) fn with_filters(banks: &[Vec<f64>]) -> Self {
        let mut memory = Self::new();
        for (bank, weights) in banks.iter().enumerate() {
            memory.numbers.insert(Slot::Filters { bank }, weights.iter().map(|&w| N::of(w)).collect());
        }
        memory
    }

    /// A photograph. A binding of any other slot than that of I2 gives I1.
    pub(crate) fn photograph(&self, from: impl Readable) -> &Frame {
        let image = usize::from(from.slot() == Slot::Photograph { image: 1 });
        self.photograph_of(image)
    }

    /// A byte for each pixel of I1, 0 where it does not count; `None` if all count.
    pub(crate) fn mask_bytes(&self) -> Option<&[u8]> {
        self.mask.as_ref().map(Mask::bytes)
    }

    /// The layers of an image.
    pub(crate) fn layers(&self, from: impl Readable) -> &[Raster<N>] {
        &self.layers[&from.slot()]
    }

    /// A layer of an image.
    pub(crate) fn layer(&self, from: impl Readable, n: usize) -> &Raster<N> {
        &self.layers(from)[n]
    }

    /// A layer of an image, mutably.
    pub(crate) fn layer_mut(&mut self, to: impl Writable, n: usize) -> &mut Raster<N> {
        let layers = self.layers.entry(to.slot()).or_default();
        if layers.len() <= n {
            layers.resize(n + 1, Raster::default());
        }
        &mut layers[n]
    }

    /// Writes a layer of an image.
    pub(crate) fn set_layer(&mut self, to: impl Writable, n: usize, field: Raster<N>) {
        *self.layer_mut(to, n) = field;
    }

    /// Takes a layer of an image to write it again.
    pub(crate) fn take_layer(&mut self, to: impl Writable, n: usize) -> Raster<N> {
        std::mem::take(self.layer_mut(to, n))
    }

    /// The linear system of one color: right side, in a layer, then the weights of the right, left, lower and upper
    /// neighbour.
    pub(crate) fn system(
        &self,
        (right_sides, layer): (impl Readable, usize),
        weights: impl Readable,
        color: usize,
    ) -> [&Raster<N>; 5] {
        let weights = self.layers(weights);
        std::array::from_fn(|i| if i == 0 { self.layer(right_sides, layer) } else { &weights[4 * color + i - 1] })
    }

    /// Writes the weights of the linear system of one color.
    pub(crate) fn set_weights(&mut self, to: impl Writable, color: usize, weights: [Raster<N>; 4]) {
        weights.into_iter().enumerate().for_each(|(n, weight)| self.set_layer(to, 4 * color + n, weight));
    }

    /// The state.
    pub(crate) fn state(&self, from: impl Readable) -> &DoubleState {
        &self.states[&from.slot()]
    }

    /// The state, mutably.
    pub(crate) fn state_mut(&mut self, to: impl Writable) -> &mut DoubleState {
        self.states.entry(to.slot()).or_default()
    }

    /// White of the blur stacks that a variant of a pass writes; `None` if it does not pack them.
    pub(super) fn white(&self, variant: Variant) -> Option<White> {
        White::of(variant, self.states.get(&Slot::State).map_or(0.0, |state| state.white))
    }

    /// The registration integrals, of rows of partial sums.
    pub(crate) fn sums(&self, from: impl Readable, layout: Layout) -> Sums {
        Sums::from_partials(self.numbers(from), layout)
    }

    /// The numbers in a buffer: filter weights, energies, partial sums or equations.
    pub(crate) fn numbers(&self, from: impl Readable) -> &[N] {
        &self.numbers[&from.slot()]
    }

    /// Takes numbers to write them again.
    pub(crate) fn take_numbers(&mut self, to: impl Writable) -> Vec<N> {
        std::mem::take(self.numbers.entry(to.slot()).or_default())
    }

    /// Puts numbers back.
    pub(crate) fn put_numbers(&mut self, to: impl Writable, numbers: Vec<N>) {
        self.numbers.insert(to.slot(), numbers);
    }

    /// Writes numbers from the first on.
    pub(crate) fn set_numbers(&mut self, to: impl Writable, numbers: &[f64]) {
        let slot = self.numbers.entry(to.slot()).or_default();
        slot.clear();
        slot.extend(numbers.iter().map(|&number| N::of(number)));
    }

    /// The numbers in a buffer, mutably: at least `count`.
    pub(crate) fn numbers_mut(&mut self, to: impl Writable, count: usize) -> &mut Vec<N> {
        let numbers = self.numbers.entry(to.slot()).or_default();
        numbers.resize(numbers.len().max(count), N::default());
        numbers
    }

    /// The words in a buffer: indirect arguments, or bits.
    pub(crate) fn words(&self, from: impl Readable) -> &[u32] {
        self.words.get(&from.slot()).map_or(&[], Vec::as_slice)
    }

    /// The words in a buffer, mutably.
    pub(crate) fn words_mut(&mut self, to: impl Writable) -> &mut Vec<u32> {
        self.words.entry(to.slot()).or_default()
    }
}

/// For tests of all devices on the same inputs.
#[cfg(test)]
impl<N: Number> Memory<N> {
    /// A copy of the photographs, of the mask and of some slots, in another precision.
    pub(crate) fn part<M: Number>(&self, slots: &[Slot]) -> Memory<M> {
        let converted = |numbers: &[N]| numbers.iter().map(|&number| M::of(number.into())).collect::<Vec<M>>();
        let raster = |r: &Raster<N>| Raster { width: r.width, height: r.height, data: converted(&r.data) };
        let mut part = Memory { photographs: self.photographs.clone(), mask: self.mask.clone(), ..Memory::new() };
        for &slot in slots {
            if let Some(layers) = self.layers.get(&slot) {
                part.layers.insert(slot, layers.iter().map(raster).collect());
            }
            if let Some(numbers) = self.numbers.get(&slot) {
                part.numbers.insert(slot, converted(numbers));
            }
            part.states.extend(self.states.get(&slot).map(|state| (slot, state.clone())));
            part.words.extend(self.words.get(&slot).map(|words| (slot, words.clone())));
        }
        part
    }

    /// The layers of an image; none if it was never written.
    pub(crate) fn layers_in(&self, slot: Slot) -> &[Raster<N>] {
        self.layers.get(&slot).map_or(&[], Vec::as_slice)
    }

    /// The workgroups of a dispatch.
    pub(crate) fn groups(&self, grid: Grid) -> [u32; 3] {
        match (grid, grid.word()) {
            (Grid::Direct(groups), _) => groups,
            (_, word) => {
                let first = word.unwrap_or_default();
                std::array::from_fn(|n| self.words[&Slot::Arguments][first + n])
            }
        }
    }
}

/// Uploads, copies and results, for the executor.
impl<N: Number> Memory<N> {
    /// The photograph of an image.
    pub(crate) fn photograph_of(&self, image: usize) -> &Frame {
        self.photographs[image].as_ref().expect("photographs are uploaded before a pass reads them")
    }

    /// Sets a photograph.
    pub(crate) fn upload_photograph(&mut self, image: usize, frame: Frame) {
        self.photographs[image] = Some(frame);
    }

    /// Sets the mask of I1; `None`: all pixels count.
    pub(crate) fn upload_mask(&mut self, mask: Option<Mask>) {
        self.mask = mask;
    }

    /// Sets the state before the solve.
    pub(crate) fn upload_state(&mut self, start: DoubleState) {
        self.states.insert(Slot::StartState, start);
    }

    /// Sets the indirect arguments before a solve.
    pub(crate) fn upload_arguments(&mut self, words: &[u32]) {
        self.words.insert(Slot::StartArguments, words.to_vec());
    }

    /// Copies one slot to another of the same kind; with `levels` only the levels of a state.
    pub(crate) fn copy(&mut self, from: Slot, to: Slot, levels: bool) {
        if let Some(state) = self.states.get(&from).cloned() {
            let target = self.states.entry(to).or_default();
            if levels {
                target.levels = state.levels;
            } else {
                *target = state;
            }
        }
        if let Some(words) = self.words.get(&from).cloned() {
            self.words.insert(to, words);
        }
        if let Some(numbers) = self.numbers.get(&from).cloned() {
            self.numbers.insert(to, numbers);
        }
    }

    /// Sets layers of an image to zero.
    pub(crate) fn clear(&mut self, image: Slot, [width, height]: [u32; 2], layers: Range<u32>) {
        let all = self.layers.entry(image).or_default();
        all.resize(all.len().max(layers.end as usize), Raster::default());
        for layer in &mut all[layers.start as usize..layers.end as usize] {
            *layer = Raster::zeros(width as usize, height as usize);
        }
    }

    /// Sets the first numbers in a slot to zero.
    pub(crate) fn clear_numbers(&mut self, slot: Slot, count: usize) {
        let numbers = self.numbers.entry(slot).or_default();
        numbers.resize(numbers.len().max(count), N::default());
        numbers[..count].fill(N::default());
    }

    /// Writes the words in a slot.
    pub(crate) fn write_words(&mut self, slot: Slot, words: &[u32]) {
        self.words.insert(slot, words.to_vec());
    }

    /// A layer of an image in double precision.
    pub(crate) fn layer_in(&self, image: Slot, n: usize) -> Raster<f64> {
        let Raster { width, height, data } = &self.layers[&image][n];
        Raster { width: *width, height: *height, data: data.iter().map(|&number| number.into()).collect() }
    }

    /// Writes the only layer of an image.
    pub(crate) fn write_layer(&mut self, image: Slot, field: &Raster<f64>) {
        let data = field.data.iter().map(|&number| N::of(number)).collect();
        self.layers.insert(image, vec![Raster { width: field.width, height: field.height, data }]);
    }

    /// Whether the indirect grid at a word has any workgroups.
    pub(crate) fn runs(&self, word: usize) -> bool {
        self.words[&Slot::Arguments][word..word + 3].iter().all(|&groups| groups > 0)
    }

    /// Appends the numbers of the first `count` layers of an image.
    pub(crate) fn download(&self, image: Slot, count: u32, to: &mut Vec<N>) {
        self.layers[&image][..count as usize].iter().for_each(|layer| to.extend_from_slice(&layer.data));
    }

    /// Takes the layers of an image.
    #[cfg(any(test, debug_assertions, feature = "reference"))]
    pub(crate) fn take(&mut self, image: Slot) -> Vec<Raster<N>> {
        self.layers.remove(&image).unwrap_or_default()
    }

    /// The state in a slot.
    pub(crate) fn state_in(&self, slot: Slot) -> &DoubleState {
        &self.states[&slot]
    }

    /// The numbers in a slot; none if it was never written.
    pub(crate) fn numbers_in(&self, slot: Slot) -> &[N] {
        self.numbers.get(&slot).map_or(&[], Vec::as_slice)
    }
}
