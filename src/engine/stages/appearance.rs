//! Dense registration without a blur model, equation 36 of the paper.
//!
//! ```text
//! E(T) = ∫ ψ(S²) dx,  S = I1 - J,  J = g I2(T x) + o
//! N = Σ w j jᵀ,  g = Σ w j S,  j = ∂S/∂ζ,  w = ψ'(S²)
//! ```
//!
//! The sums run over all pixels that T maps into I2. [`update_transform`](super::update_transform) then steps T as in
//! the unified method.

use super::mask::{self, Masks};
use super::pass::{Memory, Pass};
use super::state::{Registration, inside};
use super::sums::{Layout, Line};
use super::{Number, Raster, linearise, pixels, spline};
use crate::base::workers;
use crate::engine::vulkan::Variant;

pub use super::interface::appearance::*;

impl Pass for Bindings {
    /// Compulsory traffic: I1 and the spline of I2 read, a row of sums a workgroup written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        8 * pixels(c.width, c.height) + linearise::row_bytes([c.width, c.height], c.rows, Layout::of_variant(variant))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let r = memory.state(self.state).registration;
        let masks = mask::of(memory, self.masks, variant);
        let layout = Layout::of_variant(variant);
        let sums = cpu_reference(c, layout, &r, memory.layer(self.image1, 0), memory.layer(self.spline2, 0), masks);
        memory.set_numbers(self.partials, &sums);
    }
}

/// One pass over a level. `spline2` holds the spline coefficients of I2.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    layout: Layout,
    r: &Registration,
    i1: &Raster<N>,
    spline2: &Raster<N>,
    masks: Option<&Masks<N>>,
) -> Vec<f64> {
    let centre = c.centre.map(f64::from);
    let lines = workers::map(i1.height, |y| {
        let mut line = Line::default();
        for x in 0..i1.width {
            let d = r.displacement(x, y, c.factor.into(), centre);
            if !inside([x, y], d, [i1.width, i1.height], [0.0; 2], 1.0) {
                continue;
            }
            let i2 = spline::read(spline2, x as f64 + d[0], y as f64 + d[1]);
            let s = i1.get(x, y) - (r.gain * i2.value + r.offset);
            let psi = s.hypot(c.eta.into());
            let share = mask::counts(masks, [x, y], d);
            let [gx, gy] = r.in_first([i2.dx, i2.dy]).map(|d| r.gain * d);
            let w = share / psi;
            let place = (x as f64 - centre[0]) / f64::from(c.length);
            line.add([w * gx * gx, w * gx * gy, w * gy * gy], [-w * gx * s, -w * gy * s], place);
            line.energy += share * psi;
            line.valid += share;
        }
        line
    });
    let mut partials = vec![0.0; layout.length];
    for (y, line) in lines.iter().enumerate() {
        line.add_to(&mut partials, (y as f64 - centre[1]) / f64::from(c.length), layout);
    }
    partials
}

#[cfg(test)]
mod tests {

    use super::super::harness::{build_stack, smooth_field};
    use super::super::linearise::rows_on_processor;

    use super::super::sums::{Sums, UNKNOWNS};
    use super::super::update_transform;
    use super::*;
    use crate::base::{Homography, Kernel, Photometric};

    fn constants(width: usize, height: usize) -> Constants {
        Constants {
            width: width as u32,
            height: height as u32,
            rows: rows_on_processor([width as u32, height as u32]),
            factor: 2.0,
            centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 0.5) / 2.0],
            length: 20.0,
            eta: 0.01,
        }
    }

    #[test]
    fn the_gradient_is_that_of_the_energy() {
        let (i1, i2) = (smooth_field(60, 50, 1), smooth_field(60, 50, 2));
        let spline = build_stack(&i2, &Kernel::Gaussian, 1);
        // The transform is well inside the image, so that each pixel is valid on both sides of the difference.
        let c = Constants { factor: 1.0, ..constants(60, 50) };
        let start = Registration::new(
            Homography::from_matrix([[0.9, -0.03, 0.4], [0.03, 0.9, -0.3], [0.0, 0.0, 1.0]]).unwrap(),
            &Photometric { gain: 1.1, offset: -0.05 },
        );
        let layout = Layout::of(true);
        let sums = |r: &Registration| Sums::from_partials(&cpu_reference(&c, layout, r, &i1, &spline[0], None), layout);
        let gradient = sums(&start).gradient;
        let step = 1e-5;
        let moved = |i: usize, by: f64| {
            let mut x = [0.0; UNKNOWNS];
            x[i] = by;
            let r = start.after(&update_transform::displacing(f64::from(c.length), 1.0, x));
            sums(&r).energy
        };
        for (i, actual) in gradient.iter().enumerate() {
            let expected = (moved(i, step) - moved(i, -step)) / (2.0 * step);
            assert!((actual - expected).abs() < 1e-4 * expected.abs().max(1.0), "{i}: {actual}, not {expected}");
        }
    }
}
