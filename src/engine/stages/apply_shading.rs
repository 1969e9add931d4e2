//! Applies the shading to I2, on levels where I2 is not warped onto I1's pixels.
//!
//! Shading is smooth and hardly changes within a blur kernel, so that blur and shading may be applied in either order.

use super::pass::{Memory, Pass};
use super::state::from_centre;
use super::{Number, Raster};
use crate::base::Shading;
use crate::engine::vulkan::Variant;

pub use super::interface::apply_shading::*;

impl Pass for Bindings {
    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let shading = memory.state(self.state).shading;
        let applied_shading = cpu_reference(c, &shading, memory.layer(self.from, 0));
        memory.set_layer(self.to, c.layer as usize, applied_shading);
        memory.state_mut(self.state).applied_shading = shading;
    }
}

/// I2 times the shading.
pub fn cpu_reference<N: Number>(c: &Constants, shading: &Shading, i2: &Raster<N>) -> Raster<N> {
    let centre = c.centre.map(f64::from);
    let factor = |x: usize, y: usize| shading.at(from_centre([x as f64, y as f64], centre));
    Raster::from_fn(i2.width, i2.height, |x, y| factor(x, y) * i2.get(x, y))
}
