//! Computes one channel of the fused image behind a depth edge, without the light of what is in front. Section 7 of
//! `docs/method.md`.
//!
//! The photograph in which what is behind is in focus shows the front out of focus there, beyond its rim. With the mask
//! m of what is in front, the fused image F there, and `h` a Gaussian whose variance is |V| of the front, that
//! photograph is `h * (m F) + (1 - h * m)` times what is behind, where what is behind varies little over h. The other
//! photograph shows what is behind too, blurred, which limits what a wrong outline does.

use super::edge::SIDES;
use super::pass::{Memory, Pass};
use super::state::Displacement;
use super::{Number, Raster, fuse, pixels};
use crate::base::Shading;
use crate::engine::vulkan::Variant;

pub use super::interface::edge_fuse::*;
use crate::engine::shaders::edge_fuse as shader;

impl Pass for Bindings {
    /// Compulsory traffic: the side of each pixel read. What is read and written at edges depends on the scene.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (state, layer) = (memory.state(self.state), c.layer as usize);
        let fused = cpu_reference(
            (
                Displacement { r: &state.registration.in_intensities(state.unit), ..state.displacement(1.0, c.centre) },
                &state.applied_shading,
            ),
            [memory.layer(self.channel1, 0), memory.layer(self.spline2, 0)],
            memory.layer(self.relative_blur, 0),
            [memory.layer(self.results, SIDES), memory.layer(self.results, layer)],
        );
        memory.set_layer(self.results, layer, fused);
    }
}

/// The channel of the fused image.
fn cpu_reference<N: Number>(
    state: (Displacement, &Shading),
    photographs: [&Raster<N>; 2],
    v: &Raster<N>,
    [sides, fused]: [&Raster<N>; 2],
) -> Raster<N> {
    Raster::from_fn(fused.width, fused.height, |x, y| {
        let variance = -sides.get(x, y);
        if variance <= 0.0 {
            return fused.get(x, y);
        }
        // A quarter of σ apart, rounded up: 25 x 25 samples at most.
        let apart = ((variance.sqrt() / shader::SAMPLES).ceil() as usize).max(1);
        let reach = (3.0 * variance.sqrt()).ceil() as usize;
        // The weight of a pixel is the product of one for its column and one for its row.
        let samples = |x: usize, size: usize| {
            let last = (x + reach).min(size - 1);
            let places = (x - x.min(reach) / apart * apart..=last).step_by(apart);
            places.map(move |i| (i, (-(i.abs_diff(x).pow(2) as f64) / (2.0 * variance)).exp()))
        };
        let columns: Vec<_> = samples(x, fused.width).collect();
        let (mut sum, mut in_front, mut light) = (0.0, 0.0, 0.0);
        for (j, of_row) in samples(y, fused.height) {
            let (sides, fused) = (sides.row(j), fused.row(j));
            for &(i, of_column) in &columns {
                let weight = of_row * of_column;
                sum += weight;
                if sides[i] > N::default() {
                    in_front += weight;
                    light += weight * fused[i].into();
                }
            }
        }
        if in_front == 0.0 {
            return fused.get(x, y);
        }
        let before = fused.get(x, y);
        let behind = (before - light / sum) / (1.0 - in_front / sum).max(shader::LEAST_SHARE);
        let v = v.get(x, y);
        let [i1, j] = fuse::photographs(state, photographs, ([x, y], v));
        let blurred = if v < 0.0 { i1 } else { j };
        let most = shader::MOST_BEYOND * (before - blurred).abs();
        behind.clamp(before.min(blurred - most), before.max(blurred + most))
    })
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::super::state::DoubleState;
    use super::*;

    const LAYER: usize = 3;

    fn constants([width, height]: [u32; 2]) -> Constants {
        let centre = [(width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0];
        Constants { width, height, layer: LAYER as u32, centre }
    }

    /// The fused image before and after: a front of 0.9 left of column 25, as in I1, and the ground of 0.1 of J with
    /// the front's blur over it. The sides have the front end at `rim`.
    fn cleared(rim: usize) -> [Field; 2] {
        let (width, height) = (60, 40);
        let sides = Field::from_fn(width, height, |x, _| {
            if x < rim {
                4.0
            } else if x < rim + 11 {
                -4.0
            } else {
                0.0
            }
        });
        let share = |x: usize| {
            let (near, all): (Vec<f64>, Vec<f64>) = (-9..=9)
                .map(|d: i32| ((-f64::from(d * d) / 8.0).exp(), x as i32 + d < 25))
                .map(|(weight, in_front)| (if in_front { weight } else { 0.0 }, weight))
                .unzip();
            near.iter().sum::<f64>() / all.iter().sum::<f64>()
        };
        let i1 = Field::from_fn(width, height, |x, _| if x < 25 { 0.9 } else { 0.1 });
        let j = Field::from_fn(width, height, |x, _| 0.1 + 0.8 * share(x));
        let fused = Field::from_fn(width, height, |x, y| if x < rim { i1.get(x, y) } else { j.get(x, y) });
        let v = Field::from_fn(width, height, |x, _| if x < rim { 4.0 } else { -4.0 });
        let state = DoubleState::default();
        let c = constants([width as u32, height as u32]);
        let displacement = state.displacement(1.0, c.centre);
        let cleared = cpu_reference((displacement, &Shading::default()), [&i1, &j], &v, [&sides, &fused]);
        [fused, cleared]
    }

    #[test]
    fn behind_a_bright_front_the_dark_ground_is_as_dark_as_far_from_it() {
        let [fused, cleared] = cleared(25);
        assert!(fused.get(25, 20) > 0.4);
        for (n, cleared) in cleared.data.iter().enumerate() {
            // 0.002: both Gaussians end at 3 and at 4.5 σ.
            let expected = if n % 60 < 25 { 0.9 } else { 0.1 };
            assert!((cleared - expected).abs() < 0.002, "{}: {cleared}", n % 60);
        }
    }

    #[test]
    fn an_outline_in_the_wrong_place_makes_no_black_rim() {
        for rim in [23, 27] {
            let [fused, cleared] = cleared(rim);
            for (n, (cleared, fused)) in cleared.data.iter().zip(&fused.data).enumerate() {
                // Half of what the ground was too bright by, at most.
                let least = 0.1 - 0.5 * (fused - 0.1).abs() - 0.002;
                assert!((least..=0.9 + 0.002).contains(cleared), "{}: {cleared}, {fused}", n % 60);
            }
        }
    }
}
