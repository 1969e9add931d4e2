//! A pass of a script: typed bindings, push constants, and the CPU reference at work on [`Memory`].

use std::collections::HashMap;

use bytemuck::Pod;

use super::Field;
use super::state::DoubleState;
use super::sums::Sums;
use crate::base::{Frame, Mask};
use crate::engine::slot::{Partials, Readable, RightSides, Slot, State, Weights, Writable};
use crate::engine::vulkan::{Stage, Variant};

/// The bindings of a stage as a struct. [`bindings!`] implements it.
pub(crate) trait Bindings: Copy {
    /// The push constants.
    type Constants: Pod;
    /// The shader and its layout.
    const STAGE: &'static Stage;
    /// The slots in the shader's order.
    fn slots(&self) -> Vec<Slot>;
    /// The bindings of slots in the shader's order.
    fn of(slots: &[Slot]) -> Self;
}

/// A stage that scripts can dispatch.
pub(crate) trait Pass: Bindings {
    /// Compulsory traffic, bytes: each input element read once, each output element written once.
    fn bytes(constants: &Self::Constants, variant: Variant) -> u64;
    /// Runs the CPU reference on the slots.
    fn run(&self, constants: &Self::Constants, variant: Variant, memory: &mut Memory);
}

/// Declares the push constants of a stage: the members of the shader's block in its order, at most 128 bytes.
macro_rules! push_constants {
    ($($(#[$doc:meta])* $field:ident: $kind:ty,)*) => {
        /// Push constants.
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct Constants {
            $($(#[$doc])* pub $field: $kind,)*
        }
    };
}
pub(crate) use push_constants;

/// Declares the stage of a shader and its bindings, in the shader's order. Each field is
/// [`Reads`](crate::engine::slot::Reads), [`Writes`](crate::engine::slot::Writes) or
/// [`Updates`](crate::engine::slot::Updates) of a quantity. A test compares order and accesses with the shader's text.
macro_rules! bindings {
    ($shader:ident: $($(#[$doc:meta])* $field:ident: $access:ident<$quantity:ident>,)*) => {
        /// The bindings of the shader, in its order.
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct Bindings {
            $($(#[$doc])* pub(crate) $field: $crate::engine::slot::$access<$crate::engine::slot::$quantity>,)*
        }

        /// The shader and its layout.
        pub(crate) const STAGE: $crate::engine::vulkan::Stage = $crate::engine::vulkan::Stage {
            shader: &$crate::engine::shaders::$shader,
            bindings: &[$(
                <$crate::engine::slot::$access<$crate::engine::slot::$quantity> as $crate::engine::slot::Bound>::BINDING
            ),*],
            constant_bytes: size_of::<Constants>(),
            workgroup: $crate::engine::stages::WORKGROUP,
        };

        impl $crate::engine::stages::pass::Bindings for Bindings {
            type Constants = Constants;
            const STAGE: &'static $crate::engine::vulkan::Stage = &STAGE;

            fn slots(&self) -> Vec<$crate::engine::slot::Slot> {
                use $crate::engine::slot::Bound;
                vec![$(self.$field.slot()),*]
            }

            fn of(slots: &[$crate::engine::slot::Slot]) -> Self {
                use $crate::engine::slot::Bound;
                let &[$($field),*] = slots else { unreachable!("{} slots for {} bindings", slots.len(), STAGE.bindings.len()) };
                Self { $($field: Bound::of($field)),* }
            }
        }
    };
}
pub(crate) use bindings;

/// The contents of the slots, for the CPU references. A layer has the size of the field that was last written to it.
/// Slots that were never written must not be read.
pub(crate) struct Memory<'a> {
    pub(super) photographs: [&'a Frame; 2],
    pub(super) mask: Option<&'a Mask>,
    pub(super) layers: HashMap<Slot, Vec<Field>>,
    pub(super) states: HashMap<Slot, DoubleState>,
    pub(super) numbers: HashMap<Slot, Vec<f64>>,
    pub(super) words: HashMap<Slot, Vec<u32>>,
    pub(super) sums: Sums,
}

impl<'a> Memory<'a> {
    /// The memory of a pair of photographs, with the mask of I1 and the state before the solve.
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

    /// A photograph; I1 for slots of other kinds.
    pub(crate) fn photograph<Q>(&self, from: impl Readable<Q>) -> &'a Frame {
        self.photographs[usize::from(from.slot() == Slot::Photograph { image: 1 })]
    }

    /// A byte for each pixel of I1, 0 where it does not count; `None` if all count.
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

    /// A layer of an image, mutably.
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

    /// The state, mutably.
    pub(crate) fn state_mut(&mut self, to: impl Writable<State>) -> &mut DoubleState {
        self.states.entry(to.slot()).or_default()
    }

    /// The registration integrals.
    pub(crate) fn sums(&self, _from: impl Readable<Partials>) -> &Sums {
        &self.sums
    }

    /// Sets the registration integrals.
    pub(crate) fn set_sums(&mut self, _to: impl Writable<Partials>, sums: Sums) {
        self.sums = sums;
    }

    /// Filter weights, or energies.
    pub(crate) fn numbers<Q>(&self, from: impl Readable<Q>) -> &[f64] {
        &self.numbers[&from.slot()]
    }

    /// Energies, mutably: at least `count`.
    pub(crate) fn numbers_mut<Q>(&mut self, to: impl Writable<Q>, count: usize) -> &mut Vec<f64> {
        let numbers = self.numbers.entry(to.slot()).or_default();
        numbers.resize(numbers.len().max(count), 0.0);
        numbers
    }

    /// Indirect arguments.
    pub(crate) fn words<Q>(&self, from: impl Readable<Q>) -> &[u32] {
        &self.words[&from.slot()]
    }

    /// Indirect arguments, mutably.
    pub(crate) fn words_mut<Q>(&mut self, to: impl Writable<Q>) -> &mut Vec<u32> {
        self.words.entry(to.slot()).or_default()
    }
}

/// Uploads, copies and results, for the executor.
impl Memory<'_> {
    /// Sets a bank of filter weights.
    pub(crate) fn upload_filters(&mut self, bank: usize, weights: &[f64]) {
        self.numbers.insert(Slot::Filters { bank }, weights.to_vec());
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

    /// Sets an image to one layer of zeros.
    pub(crate) fn clear(&mut self, image: Slot, [width, height]: [u32; 2]) {
        self.layers.insert(image, vec![Field::zeros(width as usize, height as usize)]);
    }

    /// Whether the indirect grid at a word has any workgroups.
    pub(crate) fn runs(&self, word: usize) -> bool {
        self.words[&Slot::Arguments][word..word + 3].iter().all(|&groups| groups > 0)
    }

    /// Takes the layers of an image.
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
