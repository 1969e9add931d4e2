//! The slots of a solve, one for each image and buffer, and the names by which shaders bind them.

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
    /// Partial sums, a row for each workgroup. Other passes use it for the numbers of windows by which law and kernel are
    /// found, and for samples of the blur-matched pair.
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
    /// No slot: a binding that the script has yet to choose.
    Unbound,
}

impl Slot {
    /// For a pass that reads it.
    pub(crate) fn read(self) -> Reads {
        Reads(self)
    }

    /// For a pass that writes it without reading.
    pub(crate) fn write(self) -> Writes {
        Writes(self)
    }

    /// For a pass that reads and writes it.
    pub(crate) fn update(self) -> Updates {
        Updates(self)
    }

    /// The slot that a binding of this name means in all shaders, on a level. `Unbound`: the script chooses it.
    pub(crate) fn named(name: &str, level: usize) -> Self {
        match name {
            "image1" | "channel1" => Self::Luminance { image: 0, level },
            "image2" => Self::Luminance { image: 1, level },
            "masks" => Self::Masks { level },
            "relative_blur" | "focus" | "unknown" => Self::RelativeBlur { level },
            "stacks" | "results" | "result" => Self::Stacks,
            "smoothed" => Self::Scratch,
            "spline" | "spline2" => Self::Spline2,
            "weights" => Self::Weights,
            "equations" | "grid_equations" => Self::GridEquations,
            "steps" | "own_steps" | "listed" => Self::GridSteps,
            "terms" | "pair" | "kept" => Self::UncertaintyTerms,
            "aligned" => Self::Aligned,
            "normal_equations" | "system" => Self::NormalEquations,
            "tiles" => Self::Tiles,
            "hidden" => Self::Hidden,
            "state" | "updated" => Self::State,
            "partials" | "means" => Self::Partials,
            "energies" => Self::Energies,
            "arguments" => Self::Arguments,
            "start_arguments" => Self::StartArguments,
            "mask" => Self::Mask,
            _ => Self::Unbound,
        }
    }

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

/// A field of a pass's bindings: a slot, and how the pass accesses it.
pub(crate) trait Bound: Copy {
    fn slot(self) -> Slot;
    /// A slot as this binding.
    fn of(slot: Slot) -> Self;
}

/// A binding that a pass may read.
pub(crate) trait Readable: Bound {}

/// A binding that a pass may write.
pub(crate) trait Writable: Bound {}

macro_rules! accesses {
    ($($(#[$doc:meta])* $name:ident: $($may:ident),*;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $name(Slot);
        impl Bound for $name {
            fn slot(self) -> Slot {
                self.0
            }
            fn of(slot: Slot) -> Self {
                Self(slot)
            }
        }
        $(impl $may for $name {})*
    )*};
}

accesses! {
    /// A slot that a pass reads.
    Reads: Readable;
    /// A slot that a pass writes.
    Writes: Writable;
    /// A slot that a pass reads and writes.
    Updates: Readable, Writable;
}
