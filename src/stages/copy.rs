//! A field as it is, from image to image. No part of the method: [`bench`](crate::bench) measures by it what the memory
//! under the other passes does at most.

use bytemuck::{Pod, Zeroable};

use super::{Field, WORKGROUP, pixels};
use crate::shaders;
use crate::vulkan::{Binding, Stage};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// From, to.
pub(crate) const STAGE: Stage = Stage {
    shader: &shaders::COPY,
    bindings: &[Binding::Image, Binding::Image],
    constant_bytes: size_of::<Constants>(),
    workgroup: WORKGROUP,
};

/// Bytes that must move: every pixel read, every pixel written.
pub(crate) fn bytes(c: &Constants) -> u64 {
    8 * pixels(c.width, c.height)
}

/// The same field.
pub fn twin(from: &Field) -> Field {
    from.clone()
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::vulkan::Resource;

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(37, 21), (64, 4), (1, 1)] {
            let rig = Rig::new();
            let field = random_field(width, height, 5);
            let size = [width as u32, height as u32];
            let (from, to) = (rig.image(std::slice::from_ref(&field)), rig.empty(size, 1));
            let constants = Constants { width: size[0], height: size[1] };
            rig.run(&STAGE, &[Resource::Image(&from), Resource::Image(&to)], &constants, size);
            // 1e-7: the field in single precision.
            rig.assert_close(&to, &[twin(&field)], 1e-7);
        }
    }
}
