//! Turns the nodes of Gaussians' blur stacks into those of disks, in place.
//!
//! It adds a disk's departure from a Gaussian where the [kernel that was found](super::lens) is a disk. The slope at a
//! node stays half the Laplacian, which is exact only for a Gaussian. Between nodes a disk's image is then off by a
//! ninth of its difference from a Gaussian's, less than the departure itself leaves.

use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels, stack};
use crate::engine::vulkan::Variant;

pub use super::interface::shape::*;

/// Workgroups over the blur stacks of `planes` images. Packed ones count as one.
pub(crate) fn groups(size: [u32; 2], planes: u32) -> [u32; 3] {
    let [x, y, _] = STAGE.groups(size);
    [x, y, planes]
}

impl Pass for Bindings {
    /// Compulsory traffic: every node read, every one but the sharp image written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        stack::bytes(c.planes, stack::is_packed(variant)) * u64::from(2 * c.nodes - 1) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let is_shaped = if c.are_gaussian != 0 { state.kernel_shape != 0.0 } else { state.becomes_disk != 0 };
        for plane in (0..c.planes).filter(|_| is_shaped) {
            let first = (c.first + plane * c.step) as usize;
            let shaped = cpu_reference(&memory.layers(self.stacks)[first..first + c.nodes as usize]);
            for (k, node) in shaped.into_iter().enumerate() {
                memory.set_layer(self.stacks, first + k, stack::stored(node, memory.white(variant)));
            }
        }
    }
}

/// The nodes of a disk, from those of a Gaussian.
pub fn cpu_reference<N: Number>(nodes: &[Raster<N>]) -> Vec<Raster<N>> {
    let node = |k: usize| {
        // The departure is linear in the values of the nodes.
        let weight = |n: usize| {
            N::of(stack::departure_of(k, nodes.len(), |at| f64::from(u8::from(at == n))) + f64::from(u8::from(k == n)))
        };
        let weights: Vec<_> = (k.saturating_sub(2)..nodes.len().min(k + 3)).map(|n| (n, weight(n))).collect();
        let mut shaped = Raster::zeros(nodes[k].width, nodes[k].height);
        shaped.fill_rows(|y, row| {
            for &(n, weight) in &weights {
                row.iter_mut().zip(nodes[n].row(y)).for_each(|(value, own)| *value += weight * *own);
            }
        });
        shaped
    };
    (0..nodes.len()).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::build_stack;
    use super::super::stack::{Slopes, node_count};

    use super::*;
    use crate::base::Kernel;

    #[test]
    fn a_shape_of_one_is_a_disk() {
        // A disk damps waves by 2 J1(2 k √v)/(2 k √v).
        for (n, periods) in [(129, 8.0), (129, 14.0), (257, 20.0)] {
            let k = std::f64::consts::PI * periods / (n - 1) as f64;
            let wave = Field::from_fn(n, 3, |x, _| (k * x as f64).cos());
            let gaussian = build_stack(&wave, &Kernel::Gaussian, node_count(36.0));
            let disk = cpu_reference(&gaussian);
            for v in [1.0, 2.2, 4.0, 7.0, 12.0, 20.0] {
                let w = k * f64::sqrt(v);
                if w > 1.6 {
                    continue; // past the first zero, at 1.9, less than a tenth of the contrast is left
                }
                let at = |stack: &[Field]| stack::read(stack, Slopes::Laplacian, v, 64.0, 1.0).value / (k * 64.0).cos();
                let expected = libm::j1(2.0 * w) / w;
                let [actual, before] = [at(&disk), at(&gaussian)].map(|value| (value - expected).abs());
                println!("w {w:.2}: disk {actual:.4}, Gaussian {before:.4}");
                assert!(actual < 0.02 + 0.5 * before, "v {v}, w {w}: {actual} {before}");
            }
        }
    }
}
