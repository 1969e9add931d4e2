//! What makes a stage part of a [`Script`](crate::engine::script): typed bindings, and its twin at work in [`Memory`].

use bytemuck::Pod;

use super::memory::Memory;
use crate::engine::slot::Slot;
use crate::engine::vulkan::{Stage, Variant};

/// The bindings of a stage as a struct, from which [`bindings!`] derives the pipeline's layout.
pub(crate) trait Bindings: Copy {
    /// The slots in the shader's order.
    fn slots(&self) -> Vec<Slot>;
    /// From the slots in the shader's order.
    fn of(slots: &[Slot]) -> Self;
}

/// A stage with what it binds.
pub(crate) trait Pass: Bindings {
    /// Its push constants.
    type Constants: Pod;
    /// The shader and its layout.
    const STAGE: &'static Stage;
    /// Bytes that must move at least: every input element read once, every output element written once.
    fn bytes(constants: &Self::Constants, variant: Variant) -> u64;
    /// Does on the twins' memory what the shader does on the device.
    fn run(&self, constants: &Self::Constants, variant: Variant, memory: &mut Memory);
}

/// Declares the stage of a shader and what it binds, in the shader's order: each field is of [`Reads`](crate::engine::slot::Reads),
/// [`Writes`](crate::engine::slot::Writes) or [`Updates`](crate::engine::slot::Updates) of a quantity. A test compares the
/// order and the accesses with the shader's text.
macro_rules! bindings {
    ($shader:ident: $($(#[$doc:meta])* $field:ident: $access:ident<$quantity:ident>,)*) => {
        /// What the shader binds, in its order.
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct Bindings {
            $($(#[$doc])* pub(crate) $field: $crate::engine::slot::$access<$crate::engine::slot::$quantity>,)*
        }

        /// The shader, and how it binds them.
        pub(crate) const STAGE: $crate::engine::vulkan::Stage = $crate::engine::vulkan::Stage {
            shader: &$crate::engine::shaders::$shader,
            bindings: &[$(
                <$crate::engine::slot::$access<$crate::engine::slot::$quantity> as $crate::engine::slot::Bound>::BINDING
            ),*],
            constant_bytes: size_of::<Constants>(),
            workgroup: $crate::engine::stages::WORKGROUP,
        };

        impl $crate::engine::stages::pass::Bindings for Bindings {
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
