//! V where it is valid, NaN elsewhere, and its confidence `D/(D + Σa)`, section 7 of `docs/method.md`.

use bytemuck::{Pod, Zeroable};

use super::state::{Registration, inside};
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
    /// The image centre, pixels.
    pub centre: [f32; 2],
}

/// V, weights of the linear system, result (layer 0: V, layer 1: confidence), state.
pub(crate) const STAGE: Stage = Stage {
    shader: &shaders::CONFIDENCE,
    bindings: &[Binding::Image, Binding::Image, Binding::Image, Binding::Buffer],
    constant_bytes: size_of::<Constants>(),
    workgroup: WORKGROUP,
};

/// Bytes that must move: V and four weights read, V and confidence written.
pub(crate) fn bytes(c: &Constants) -> u64 {
    28 * pixels(c.width, c.height)
}

/// V and confidence, from the last [linear system](super::linearise::Linearised).
pub fn twin(c: &Constants, r: &Registration, v: &Field, system: &[Field; 5]) -> [Field; 2] {
    let size = [v.width, v.height];
    let valid = |x, y| inside([x, y], r.displacement(x, y, 1.0, c.centre.map(f64::from)), size, v.get(x, y), r.scale());
    let confidence = Field::from_fn(v.width, v.height, |x, y| {
        // The weights are stored over D + Σa; what a sum falls short of 1 by less than 1e-5 is rounding.
        let confidence = 1.0 - system[1..].iter().map(|a| a.get(x, y)).sum::<f64>();
        if valid(x, y) && confidence > 1e-5 { confidence } else { 0.0 }
    });
    [Field::from_fn(v.width, v.height, |x, y| if valid(x, y) { v.get(x, y) } else { f64::NAN }), confidence]
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::interleaved;
    use super::super::state::State;
    use super::*;
    use crate::vulkan::Resource;
    use crate::{Photometric, Similarity};

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(37usize, 21usize), (64, 16)] {
            let v = random_field(width, height, 1);
            let mut system: [Field; 5] = std::array::from_fn(|i| random_field(width, height, 2 + i as u64));
            system.iter_mut().for_each(|f| f.data.iter_mut().for_each(|a| *a *= 0.24));
            let registration = Registration::new(&Similarity::new(2.2, -1.0, 0.5, 1.03), &Photometric::IDENTITY);
            let state = State::new(&registration);
            let c = Constants {
                width: width as u32,
                height: height as u32,
                centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0],
            };
            let rig = Rig::new();
            let weights = rig.weights(&interleaved(&system));
            let (image, result) = (rig.image(std::slice::from_ref(&v)), rig.empty([width as u32, height as u32], 2));
            let buffer = rig.upload(bytemuck::bytes_of(&state));
            let images = [&image, &weights, &result].map(Resource::Image);
            let resources = [&images[..], &[Resource::Buffer(&buffer)]].concat();
            rig.run(&STAGE, &resources, &c, [width as u32, height as u32]);
            let expected = twin(&c, &state.registration(), &v, &system);
            assert!(expected[0].data.iter().any(|v| v.is_nan()) && expected[0].data.iter().any(|v| !v.is_nan()));
            rig.assert_close(&result, &expected, 1e-6);
        }
    }
}
