//! What the twins work on: the slots of a solve in plain Rust and double precision.

use std::collections::HashMap;

use super::Field;
use super::state::DoubleState;
use super::sums::Sums;
use crate::base::{Frame, Mask};
use crate::engine::slot::{Partials, Readable, RightSides, Slot, State, Weights, Writable};

/// Every slot that something was written to. A layer of an image is as large as what was written there last; what was never
/// written is not to be read.
pub(crate) struct Memory<'a> {
    photographs: [&'a Frame; 2],
    mask: Option<&'a Mask>,
    layers: HashMap<Slot, Vec<Field>>,
    states: HashMap<Slot, DoubleState>,
    numbers: HashMap<Slot, Vec<f64>>,
    words: HashMap<Slot, Vec<u32>>,
    sums: Sums,
}

impl<'a> Memory<'a> {
    /// With a pair of photographs, the mask of I1, and the state before the solve.
    pub(crate) fn new(photographs: [&'a Frame; 2], mask: Option<&'a Mask>, start: DoubleState) -> Self {
        Self {
            photographs,
            mask,
            layers: HashMap::new(),
            states: HashMap::from([(Slot::StartState, start)]),
            numbers: HashMap::new(),
            words: HashMap::new(),
            sums: Sums::default(),
        }
    }

    /// A photograph; I1 for a slot that holds none.
    pub(crate) fn photograph<Q>(&self, from: impl Readable<Q>) -> &'a Frame {
        self.photographs[usize::from(from.slot() == Slot::Photograph { image: 1 })]
    }

    /// A byte for each pixel of I1, 0 where it does not count; `None`: all count.
    pub(crate) fn mask_bytes(&self) -> Option<&'a [u8]> {
        self.mask.map(Mask::bytes)
    }

    /// The layers of an image.
    pub(crate) fn layers<Q>(&self, from: impl Readable<Q>) -> &[Field] {
        &self.layers[&from.slot()]
    }

    /// A layer of an image.
    pub(crate) fn layer<Q>(&self, from: impl Readable<Q>, n: usize) -> &Field {
        &self.layers(from)[n]
    }

    /// A layer of an image, to be changed in place.
    pub(crate) fn layer_mut<Q>(&mut self, to: impl Writable<Q>, n: usize) -> &mut Field {
        let layers = self.layers.entry(to.slot()).or_default();
        if layers.len() <= n {
            layers.resize(n + 1, Field::zeros(0, 0));
        }
        &mut layers[n]
    }

    /// Writes a layer of an image.
    pub(crate) fn set_layer<Q>(&mut self, to: impl Writable<Q>, n: usize, field: Field) {
        *self.layer_mut(to, n) = field;
    }

    /// The linear system: right side, then the weights of the right, left, lower and upper neighbour.
    pub(crate) fn system(
        &self,
        right_sides: impl Readable<RightSides>,
        weights: impl Readable<Weights>,
    ) -> [&Field; 5] {
        let weights = self.layers(weights);
        std::array::from_fn(|i| if i == 0 { self.layer(right_sides, 0) } else { &weights[i - 1] })
    }

    /// The state.
    pub(crate) fn state(&self, from: impl Readable<State>) -> &DoubleState {
        &self.states[&from.slot()]
    }

    /// The state, to be changed.
    pub(crate) fn state_mut(&mut self, to: impl Writable<State>) -> &mut DoubleState {
        self.states.entry(to.slot()).or_default()
    }

    /// The registration integrals.
    pub(crate) fn sums(&self, _from: impl Readable<Partials>) -> &Sums {
        &self.sums
    }

    /// Leaves the registration integrals.
    pub(crate) fn set_sums(&mut self, _to: impl Writable<Partials>, sums: Sums) {
        self.sums = sums;
    }

    /// Filter weights, or energies.
    pub(crate) fn numbers<Q>(&self, from: impl Readable<Q>) -> &[f64] {
        &self.numbers[&from.slot()]
    }

    /// Energies, to be changed; there are at least `count`.
    pub(crate) fn numbers_mut<Q>(&mut self, to: impl Writable<Q>, count: usize) -> &mut Vec<f64> {
        let numbers = self.numbers.entry(to.slot()).or_default();
        numbers.resize(numbers.len().max(count), 0.0);
        numbers
    }

    /// Indirect arguments.
    pub(crate) fn words<Q>(&self, from: impl Readable<Q>) -> &[u32] {
        &self.words[&from.slot()]
    }

    /// Indirect arguments, to be changed.
    pub(crate) fn words_mut<Q>(&mut self, to: impl Writable<Q>) -> &mut Vec<u32> {
        self.words.entry(to.slot()).or_default()
    }
}

/// What the executor does besides passes.
impl Memory<'_> {
    /// What the host writes before a solve: a bank of filter weights.
    pub(crate) fn upload_filters(&mut self, bank: usize, weights: &[f64]) {
        self.numbers.insert(Slot::Filters { bank }, weights.to_vec());
    }

    /// What the host writes before a solve: the indirect arguments.
    pub(crate) fn upload_arguments(&mut self, words: &[u32]) {
        self.words.insert(Slot::StartArguments, words.to_vec());
    }

    /// Copies one slot to another of the same kind; of a state only what the levels have done, if `levels` alone.
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

    /// Zero in every pixel of an image of one layer.
    pub(crate) fn clear(&mut self, image: Slot, [width, height]: [u32; 2]) {
        self.layers.insert(image, vec![Field::zeros(width as usize, height as usize)]);
    }

    /// Whether a level's three words, from this one on, are those of any workgroups.
    pub(crate) fn runs(&self, word: usize) -> bool {
        self.words[&Slot::Arguments][word..word + 3].iter().all(|&groups| groups > 0)
    }

    /// The layers of an image, whatever it holds.
    pub(crate) fn take(&mut self, image: Slot) -> Vec<Field> {
        self.layers.remove(&image).unwrap_or_default()
    }

    /// The state in a slot.
    pub(crate) fn state_in(&self, slot: Slot) -> &DoubleState {
        &self.states[&slot]
    }

    /// The energies in a slot.
    pub(crate) fn energies_in(&self, slot: Slot) -> &[f64] {
        &self.numbers[&slot]
    }
}
