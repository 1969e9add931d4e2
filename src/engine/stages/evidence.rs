//! What decided V: D, b² and (∇²V)² out of the last linear system, on every other pixel; section 7 of `docs/method.md`.
//!
//! V answers the pixels around as far as the smoothness reaches, so what one pixel says means little. Averaged over a
//! [window](fn@window), they give V's standard deviation (see [`uncertainty`](mod@super::uncertainty)).

use bytemuck::{Pod, Zeroable};

use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::{Field, pixels};
use crate::engine::filter::{self, Filter};
use crate::engine::vulkan::{Stage, Variant};

/// Layers: D, b², (∇²V)²; then the squared [residual](mod@super::residual).
pub const LAYERS: usize = 4;
/// Which of them is the residual.
pub const RESIDUAL: usize = 3;
/// σ of the window in px of the image.
pub const WINDOW: f64 = 4.0;
/// Least standard deviation of a residual, intensities: values of 8 bits are rounded by 0.0011.
pub const NOISE: f32 = 1e-3;

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row of the image.
    pub width: u32,
    /// Rows of the image.
    pub height: u32,
    /// η of the data term, intensities.
    pub eta: f32,
    /// η of the smoothness term, px² a pixel.
    pub smoothness_eta: f32,
    /// Least standard deviation of a residual, intensities.
    pub noise: f32,
}

bindings! {
    EVIDENCE:
    /// V.
    v: Reads<RelativeBlur>,
    /// Right sides of the linear system.
    right_sides: Reads<RightSides>,
    /// Weights of the linear system.
    weights: Reads<Weights>,
    /// Evidence, of that the first three layers.
    evidence: Writes<Evidence>,
    /// State, with the α that the system was made with.
    state: Reads<State>,
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: V read; on every fourth pixel right side and weights read, three values written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = size([c.width, c.height]);
        4 * pixels(c.width, c.height) + 32 * pixels(width, height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let alpha = memory.state(self.state).alpha;
        let found = twin(c, alpha, memory.layer(self.v, 0), &memory.system(self.right_sides, self.weights));
        found.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.evidence, n, field));
    }
}

/// The pixels of the evidence.
pub(crate) fn size([width, height]: [u32; 2]) -> [u32; 2] {
    [width.div_ceil(2), height.div_ceil(2)]
}

/// The filter along x and y that makes the window, on every other pixel.
pub fn window() -> Filter {
    filter::gaussian((WINDOW / 2.0).powi(2))
}

/// D, b² (of residuals of `noise` at least) and (∇²V)² on every other pixel, the last by the divergence of central differences,
/// which noise of single pixels does not lift.
pub fn twin(c: &Constants, alpha: f64, v: &Field, system: &[&Field; 5]) -> [Field; 3] {
    let [eta, smoothness_eta, noise] = [c.eta, c.smoothness_eta, c.noise].map(f64::from);
    let gradient = |x: isize, y: isize| {
        [(v.clamped(x + 1, y) - v.clamped(x - 1, y)) / 2.0, (v.clamped(x, y + 1) - v.clamped(x, y - 1)) / 2.0]
    };
    let square = |[gx, gy]: [f64; 2]| gx * gx + gy * gy;
    let phi = |x, y| 1.0 / (square(gradient(x, y)) + smoothness_eta * smoothness_eta).sqrt();
    let of = |x: usize, y: usize| {
        let (column, row) = (x as isize, y as isize);
        let (mut smoothness, mut pull) = (0.0, 0.0);
        for (nx, ny) in [(column + 1, row), (column - 1, row), (column, row + 1), (column, row - 1)] {
            if nx >= 0 && ny >= 0 && nx < v.width as isize && ny < v.height as isize {
                let a = 0.5 * alpha * (phi(column, row) + phi(nx, ny));
                smoothness += a;
                pull += a * (v.clamped(nx, ny) - v.get(x, y));
            }
        }
        let share: f64 = system[1..].iter().map(|a| a.get(x, y)).sum();
        let (missing, both) = (1.0 - share, smoothness / share.max(1e-12));
        let [right, left, down, up] = [(2, 0), (-2, 0), (0, 2), (0, -2)].map(|(x, y)| v.clamped(column + x, row + y));
        let bend = 0.25 * (right + left + down + up) - v.get(x, y);
        let bend = bend * bend;
        if missing <= 1e-6 {
            return [0.0, 0.0, bend];
        }
        let (d, b) = (both * missing, both * system[0].get(x, y) - pull);
        [d, b * b + noise * noise / eta * d, bend]
    };
    let (width, height) = (v.width.div_ceil(2), v.height.div_ceil(2));
    std::array::from_fn(|layer| Field::from_fn(width, height, |x, y| of(2 * x, 2 * y)[layer]))
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::{half, interleaved};
    use super::super::state::{DoubleState, State};
    use super::*;
    use crate::engine::vulkan::Resource;

    fn constants(v: &Field) -> Constants {
        let (width, height) = (v.width as u32, v.height as u32);
        Constants { width, height, eta: 0.01, smoothness_eta: 0.1, noise: NOISE }
    }

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(37usize, 21usize), (64, 16), (1, 2)] {
            let v = random_field(width, height, 1);
            let mut system: [Field; 5] = std::array::from_fn(|i| random_field(width, height, 2 + i as u64));
            system[1..].iter_mut().for_each(|f| f.data.iter_mut().for_each(|a| *a *= 0.24));
            let rig = Rig::new();
            let right_sides = rig.image(&[half(&system[0], 0), half(&system[0], 1)]);
            let (v_image, weights) = (rig.image(std::slice::from_ref(&v)), rig.weights(&interleaved(&system)));
            let found = rig.empty(size([width as u32, height as u32]), LAYERS);
            let state = State::new(&DoubleState::default().registration);
            let buffer = rig.upload(bytemuck::bytes_of(&state));
            let images = [&v_image, &right_sides, &weights, &found].map(Resource::Image);
            let resources = [&images[..], &[Resource::Buffer(&buffer)]].concat();
            rig.run(&STAGE, &resources, &constants(&v), size([width as u32, height as u32]));
            // D is up to 0.3 where the random weights hardly add up to anything, else some 0.01.
            let mut expected = twin(&constants(&v), state.alpha.into(), &v, &system.each_ref()).to_vec();
            expected.push(Field::zeros(expected[0].width, expected[0].height));
            rig.assert_close(&found, &expected, 1e-4);
        }
    }

    #[test]
    fn a_system_of_known_terms_gives_them_back() {
        // V flat, so a = α/η each; D = 3 a and b = 0.02 inside the image.
        let v = Field::zeros(8, 8);
        let a: f64 = 0.03;
        let over = 1.0 / (7.0 * a);
        let system: [Field; 5] =
            std::array::from_fn(|i| Field::from_fn(8, 8, |_, _| if i == 0 { 0.02 } else { a } * over));
        let c = Constants { noise: 0.0, ..constants(&v) };
        let [d, b2, g] = twin(&c, 0.003, &v, &system.each_ref());
        assert!((d.get(2, 2) / (3.0 * a) - 1.0).abs() < 1e-6, "{}", d.get(2, 2));
        assert!((b2.get(2, 2) / 4e-4 - 1.0).abs() < 1e-5 && g.get(2, 2) == 0.0);
    }
}
