//! The slots of a solve, one for each image and buffer, and typed handles to them.
//!
//! By the types, a pass that binds V cannot be given I1.

use std::marker::PhantomData;

use super::vulkan::{Access, Binding, Kind};

/// An image or a buffer of a solve. Those that are used only within a level are shared by all levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Slot {
    /// Luminance of I1 (0) or of I2 (1) on a level; for the fused image one of its channels.
    Luminance { image: usize, level: usize },
    /// Which pixels of I1 (layer 0) and of I2 (layer 1) count on a level.
    Masks { level: usize },
    /// V of a level.
    RelativeBlur { level: usize },
    /// Blur stacks of I1, then of I2, as spline coefficients. At the end the first layers hold the results.
    Stacks,
    /// Spline coefficients of I2.
    Spline2,
    /// The intermediate images of separable filters. Until the next filter, their left halves hold the right sides of
    /// the linear system for dV: of the red (layer 0) and of the black pixels (layer 1). On GPUs layer 0 holds the
    /// means of D over the window, and layer 1 the right sides at their pixels.
    Scratch,
    /// Weights of the linear system for dV, of the right, left, lower and upper neighbour, likewise.
    Weights,
    /// Equations of the coarse grids of the cascade.
    GridEquations,
    /// dV of the coarse grids of the cascade, and of the level if it takes several dispatches. After the solve the list of the cells at depth edges.
    GridSteps,
    /// Terms of the uncertainty, on every other pixel; before the end the blur-matched pair, and the latest whole step
    /// of V.
    UncertaintyTerms,
    /// Luminance of all frames of a sweep on a level, a layer each.
    Frames { level: usize },
    /// All frames of a sweep on the reference's pixels, band-passed, a layer each.
    Aligned,
    /// Coefficients of each pixel's equation: D and b; of a sweep the sums over all pairs, and q.
    NormalEquations,
    /// A bank of filter weights.
    Filters { bank: usize },
    /// Lists of the tiles that passes of a sweep run over, mapped.
    Tiles,
    /// A bit per pixel and frame of a sweep: set where the frame does not count, mapped.
    Hidden,
    /// T, gain, offset, shading and the progress of the levels.
    State,
    /// Partial sums, a row for each workgroup; in between the windows of the kernel's shape, and the samples of the
    /// blur-matched pair.
    Partials,
    /// Energies by level and outer iteration.
    Energies,
    /// The partial sums of the last iteration, mapped.
    EndPartials,
    /// Indirect arguments.
    Arguments,
    /// Samples of a photograph; mapped unless the device unpacks them.
    Photograph { image: usize },
    /// A photograph in its camera's packed format, mapped.
    Packed { image: usize },
    /// A byte for each pixel of I1, mapped: 0 where it does not count.
    Mask,
    /// State and arguments before a solve, mapped.
    StartState,
    /// See [`StartState`](Self::StartState).
    StartArguments,
    /// State within a level, for progress, mapped.
    Progress,
    /// State and energies once the registration is known, mapped.
    RegisteredState,
    /// See [`RegisteredState`](Self::RegisteredState).
    RegisteredEnergies,
    /// State and energies at the end, mapped.
    EndState,
    /// See [`EndState`](Self::EndState).
    EndEnergies,
    /// V, its standard deviation, the residual and the fused channels, mapped.
    EndMaps,
}

impl Slot {
    /// Whether each pair in flight has its own: input or output of one pair.
    pub(crate) fn is_of_one_pair(self) -> bool {
        matches!(
            self,
            Self::Photograph { .. }
                | Self::Packed { .. }
                | Self::Mask
                | Self::StartState
                | Self::StartArguments
                | Self::Progress
                | Self::EndMaps
                | Self::EndPartials
                | Self::EndState
                | Self::EndEnergies
                | Self::RegisteredState
                | Self::RegisteredEnergies
        )
    }
}

/// What a slot holds.
pub(crate) trait Quantity: Copy {
    /// The kind of binding in a shader.
    const KIND: Kind;
}

/// A quantity that is an image with one float per pixel.
pub(crate) trait Scalar: Quantity {}

macro_rules! quantities {
    ($($(#[$doc:meta])* $name:ident: $kind:ident $(, $scalar:ident)?;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) enum $name {}
        impl Quantity for $name {
            const KIND: Kind = Kind::$kind;
        }
        $(impl $scalar for $name {})?
    )*};
}

quantities! {
    /// Luminance of I1.
    I1: Image;
    /// Luminance of I2.
    I2: Image;
    /// Any image with one float per pixel.
    Plane: Image;
    /// The same by its bits.
    Words: Words;
    /// The share by which each pixel counts.
    Masks: Image, Scalar;
    /// V.
    RelativeBlur: Image, Scalar;
    /// Blur stacks.
    Stacks: Words, Scalar;
    /// Results, in the first layers of the stacks.
    Results: Image, Scalar;
    /// Spline coefficients of I2.
    Spline2: Image, Scalar;
    /// Right sides of the linear system.
    /// Weights of the linear system.
    Weights: Image;
    /// dV of one colour.
    /// Equations of the coarse grids.
    GridEquations: Buffer;
    /// dV of the coarse grids.
    GridSteps: Buffer;
    /// The list of the cells at depth edges.
    EdgeList: Buffer;
    /// Terms of the uncertainty, a blur-matched pair, or a step of V.
    UncertaintyTerms: Image, Scalar;
    /// Filter weights.
    Filters: Uniform;
    /// T, gain, offset, shading and levels.
    State: Buffer;
    /// Partial sums.
    Partials: Buffer;
    /// Lists of tiles.
    Tiles: Buffer;
    /// A bit per pixel and frame.
    Hidden: Buffer;
    /// Energies.
    Energies: Buffer;
    /// Indirect arguments.
    Arguments: Buffer;
    /// Indirect arguments before a solve.
    StartArguments: Buffer;
    /// Samples of a photograph.
    Samples: Buffer;
    /// A photograph in its camera's packed format.
    Packed: Buffer;
    /// A byte per pixel of I1.
    MaskBytes: Buffer;
}

/// A slot that holds the quantity `Q`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Handle<Q> {
    slot: Slot,
    quantity: PhantomData<Q>,
}

impl<Q: Quantity> Handle<Q> {
    const fn new(slot: Slot) -> Self {
        Self { slot, quantity: PhantomData }
    }

    /// The slot.
    pub(crate) fn slot(self) -> Slot {
        self.slot
    }

    /// For a pass that reads it.
    pub(crate) fn read(self) -> Reads<Q> {
        Reads(self)
    }

    /// For a pass that writes it without reading.
    pub(crate) fn write(self) -> Writes<Q> {
        Writes(self)
    }

    /// For a pass that reads and writes it.
    pub(crate) fn update(self) -> Updates<Q> {
        Updates(self)
    }
}

impl<Q: Scalar> Handle<Q> {
    /// For a pass that takes any image with one float per pixel.
    pub(crate) fn plane(self) -> Handle<Plane> {
        Handle::new(self.slot)
    }
}

impl Handle<Plane> {
    /// For a pass that takes it by its bits.
    pub(crate) fn words(self) -> Handle<Words> {
        Handle::new(self.slot)
    }
}

pub(crate) const STACKS: Handle<Stacks> = Handle::new(Slot::Stacks);
pub(crate) const RESULTS: Handle<Results> = Handle::new(Slot::Stacks);
pub(crate) const SPLINE2: Handle<Spline2> = Handle::new(Slot::Spline2);
pub(crate) const SCRATCH: Handle<Plane> = Handle::new(Slot::Scratch);
pub(crate) const WEIGHTS: Handle<Weights> = Handle::new(Slot::Weights);
pub(crate) const GRID_EQUATIONS: Handle<GridEquations> = Handle::new(Slot::GridEquations);
pub(crate) const GRID_STEPS: Handle<GridSteps> = Handle::new(Slot::GridSteps);
pub(crate) const EDGE_LIST: Handle<EdgeList> = Handle::new(Slot::GridSteps);
pub(crate) const UNCERTAINTY_TERMS: Handle<UncertaintyTerms> = Handle::new(Slot::UncertaintyTerms);
pub(crate) const ALIGNED: Handle<Plane> = Handle::new(Slot::Aligned);
/// Frames of a sweep on one frame's pixels, in the place of I1 and of I2.
pub(crate) const ALIGNED_AS_PAIR: (Handle<I1>, Handle<I2>) = (Handle::new(Slot::Aligned), Handle::new(Slot::Aligned));
pub(crate) const NORMAL_EQUATIONS: Handle<Plane> = Handle::new(Slot::NormalEquations);
pub(crate) const STATE: Handle<State> = Handle::new(Slot::State);
pub(crate) const PARTIALS: Handle<Partials> = Handle::new(Slot::Partials);
pub(crate) const TILES: Handle<Tiles> = Handle::new(Slot::Tiles);
pub(crate) const HIDDEN: Handle<Hidden> = Handle::new(Slot::Hidden);
pub(crate) const ENERGIES: Handle<Energies> = Handle::new(Slot::Energies);
pub(crate) const ARGUMENTS: Handle<Arguments> = Handle::new(Slot::Arguments);
pub(crate) const START_ARGUMENTS: Handle<StartArguments> = Handle::new(Slot::StartArguments);
pub(crate) const MASK: Handle<MaskBytes> = Handle::new(Slot::Mask);

pub(crate) fn i1(level: usize) -> Handle<I1> {
    Handle::new(Slot::Luminance { image: 0, level })
}

pub(crate) fn i2(level: usize) -> Handle<I2> {
    Handle::new(Slot::Luminance { image: 1, level })
}

pub(crate) fn frames(level: usize) -> Handle<Plane> {
    Handle::new(Slot::Frames { level })
}

/// I1 or I2, for passes that treat both alike.
pub(crate) fn luminance(image: usize, level: usize) -> Handle<Plane> {
    Handle::new(Slot::Luminance { image, level })
}

pub(crate) fn masks(level: usize) -> Handle<Masks> {
    Handle::new(Slot::Masks { level })
}

pub(crate) fn relative_blur(level: usize) -> Handle<RelativeBlur> {
    Handle::new(Slot::RelativeBlur { level })
}

pub(crate) fn filters(bank: usize) -> Handle<Filters> {
    Handle::new(Slot::Filters { bank })
}

pub(crate) fn samples(image: usize) -> Handle<Samples> {
    Handle::new(Slot::Photograph { image })
}

pub(crate) fn packed(image: usize) -> Handle<Packed> {
    Handle::new(Slot::Packed { image })
}

/// A field of a pass's bindings: a slot with its quantity and how the pass accesses it.
pub(crate) trait Bound: Copy {
    /// Kind and access, for the pipeline's layout and for barriers.
    const BINDING: Binding;
    /// The slot.
    fn slot(self) -> Slot;
    /// A slot as this binding.
    fn of(slot: Slot) -> Self;
}

/// A binding that a pass may read as `Q`.
pub(crate) trait Readable<Q>: Bound {}

/// A binding that a pass may write as `Q`.
pub(crate) trait Writable<Q>: Bound {}

macro_rules! accesses {
    ($($(#[$doc:meta])* $name:ident = $access:ident: $($may:ident),*;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $name<Q>(Handle<Q>);
        impl<Q: Quantity> Bound for $name<Q> {
            const BINDING: Binding = Binding { kind: Q::KIND, access: Access::$access };
            fn slot(self) -> Slot {
                self.0.slot
            }
            fn of(slot: Slot) -> Self {
                Self(Handle::new(slot))
            }
        }
        $(impl<Q: Quantity> $may<Q> for $name<Q> {})*
    )*};
}

accesses! {
    /// A slot that a pass reads.
    Reads = Read: Readable;
    /// A slot that a pass writes.
    Writes = Write: Writable;
    /// A slot that a pass reads and writes.
    Updates = Update: Readable, Writable;
}
