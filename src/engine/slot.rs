//! Where everything of a solve is kept: a slot for each image and buffer, and what it holds as a type, so that a pass that
//! takes V cannot be given I1.

use std::marker::PhantomData;

use super::vulkan::{Access, Binding, Kind};

/// An image or a buffer of a solve. Those that only live within a level are shared by all levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Slot {
    /// Luminance of I1 (0) or of I2 (1) on a level; at the end a channel of it.
    Luminance { image: usize, level: usize },
    /// Which pixels of I1 (layer 0) and of I2 (layer 1) count on a level.
    Masks { level: usize },
    /// V of a level.
    RelativeBlur { level: usize },
    /// Stacks of blurred images, as spline coefficients: of I1, then of I2. At the end the results stand in the first layers.
    Stacks,
    /// Spline coefficients of I2.
    Spline2,
    /// Between the two directions of a separable filter.
    Scratch,
    /// Linear system for dV: right sides of the red (layer 0) and of the black pixels (layer 1).
    RightSides,
    /// Linear system for dV: weights of the right, left, lower and upper neighbour, likewise.
    Weights,
    /// dV of the red (0) or of the black pixels (1).
    Change { color: usize },
    /// What decided V, on every other pixel.
    Evidence,
    /// Luminance of all frames of a sweep on a level, a layer each.
    Frames { level: usize },
    /// All frames of a sweep on the reference's pixels, filtered, a layer each.
    Aligned,
    /// What the photographs say of each pixel: D and b of its equation, of a sweep the sums of those of all pairs, and q.
    NormalEquations,
    /// A bank of filter weights.
    Filters { bank: usize },
    /// Which tiles passes of a sweep are wanted for, mapped.
    Tiles,
    /// By pixel, which frames of a sweep do not count there, mapped.
    Hidden,
    /// T, gain and offset, and what the levels have done.
    State,
    /// A row of sums for each workgroup.
    Partials,
    /// By level and outer iteration.
    Energies,
    /// The rows of sums of the last iteration, mapped.
    EndPartials,
    /// Indirect arguments.
    Arguments,
    /// The photographs; mapped unless they are unpacked on the device.
    Photograph { image: usize },
    /// The photographs as a camera packs them, mapped.
    Packed { image: usize },
    /// A byte a pixel of I1, mapped: 0 where it does not count.
    Mask,
    /// State and arguments before a solve, mapped.
    StartState,
    /// See [`StartState`](Self::StartState).
    StartArguments,
    /// State while a level is under way, mapped.
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
    /// Whether it is mapped memory that a pair comes in or its results go out by.
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
    /// How a shader binds it.
    const KIND: Kind;
}

/// A quantity that is an image of one float a pixel.
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
    /// Any image of one float a pixel.
    Plane: Image;
    /// Shares of pixels that count.
    Masks: Image, Scalar;
    /// V.
    RelativeBlur: Image;
    /// Stacks of blurred images.
    Stacks: Image, Scalar;
    /// What stands in the first layers of the stacks at the end.
    Results: Image;
    /// Spline coefficients of I2.
    Spline2: Image, Scalar;
    /// Right sides of the linear system.
    RightSides: Image;
    /// Weights of the linear system.
    Weights: Image;
    /// dV of one colour.
    Change: Image;
    /// What decided V.
    Evidence: Image, Scalar;
    /// Filter weights.
    Filters: Uniform;
    /// T, gain, offset and levels.
    State: Buffer;
    /// Rows of sums.
    Partials: Buffer;
    /// Lists of tiles.
    Tiles: Buffer;
    /// A bit a frame that does not count at a pixel.
    Hidden: Buffer;
    /// Energies.
    Energies: Buffer;
    /// Indirect arguments.
    Arguments: Buffer;
    /// Indirect arguments before a solve.
    StartArguments: Buffer;
    /// Samples of a photograph.
    Samples: Buffer;
    /// A photograph as a camera packs it.
    Packed: Buffer;
    /// A byte a pixel of I1.
    MaskBytes: Buffer;
}

/// A slot, and what it holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Handle<Q> {
    slot: Slot,
    quantity: PhantomData<Q>,
}

impl<Q: Quantity> Handle<Q> {
    const fn new(slot: Slot) -> Self {
        Self { slot, quantity: PhantomData }
    }

    /// For a pass that reads it.
    pub(crate) fn read(self) -> Reads<Q> {
        Reads(self)
    }

    /// For a pass that writes all of what it is told to, and reads nothing.
    pub(crate) fn write(self) -> Writes<Q> {
        Writes(self)
    }

    /// For a pass that reads and writes.
    pub(crate) fn update(self) -> Updates<Q> {
        Updates(self)
    }
}

impl<Q: Scalar> Handle<Q> {
    /// For a pass that takes any image of one float a pixel.
    pub(crate) fn plane(self) -> Handle<Plane> {
        Handle::new(self.slot)
    }
}

pub(crate) const STACKS: Handle<Stacks> = Handle::new(Slot::Stacks);
pub(crate) const RESULTS: Handle<Results> = Handle::new(Slot::Stacks);
pub(crate) const SPLINE2: Handle<Spline2> = Handle::new(Slot::Spline2);
pub(crate) const SCRATCH: Handle<Plane> = Handle::new(Slot::Scratch);
pub(crate) const RIGHT_SIDES: Handle<RightSides> = Handle::new(Slot::RightSides);
pub(crate) const WEIGHTS: Handle<Weights> = Handle::new(Slot::Weights);
pub(crate) const EVIDENCE: Handle<Evidence> = Handle::new(Slot::Evidence);
pub(crate) const ALIGNED: Handle<Plane> = Handle::new(Slot::Aligned);
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

pub(crate) fn change(color: usize) -> Handle<Change> {
    Handle::new(Slot::Change { color })
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

/// A field of a pass's bindings: a slot of a stated quantity, and what the pass does to it.
pub(crate) trait Bound: Copy {
    /// For the pipeline's layout and for what a pass waits for.
    const BINDING: Binding;
    /// The slot.
    fn slot(self) -> Slot;
    /// A slot taken for this.
    fn of(slot: Slot) -> Self;
}

/// What a pass may read of, as `Q`.
pub(crate) trait Readable<Q>: Bound {}

/// What a pass may write to, as `Q`.
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
