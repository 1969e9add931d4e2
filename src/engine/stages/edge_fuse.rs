//! Computes one channel of the fused image behind a depth edge, without the light of what is in front. Section 7 of
//! `docs/method.md`.
//!
//! The photograph in which the far side is in focus shows the front out of focus there, beyond its rim. With the mask m of
//! what is in front, the fused image F there, and `h` a Gaussian whose variance is |V| of the front, that photograph is
//! `h * (m F) + (1 - h * m)` times what is behind, where what is behind varies little over h.

use super::edge::SIDES;
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Field, pixels};
use crate::engine::shaders::edge_fuse as shader;
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width, pixels.
    width: u32,
    /// Height, pixels.
    height: u32,
    /// Layer of the channel.
    layer: u32,
}

bindings! {
    EDGE_FUSE:
    /// Layers: sides, and the channel.
    results: Updates<Results>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the side of each pixel read. What is read and written at edges depends on the scene.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let layer = c.layer as usize;
        let fused = cpu_reference(memory.layer(self.results, SIDES), memory.layer(self.results, layer));
        memory.set_layer(self.results, layer, fused);
    }
}

/// The channel of the fused image.
pub(crate) fn cpu_reference(sides: &Field, fused: &Field) -> Field {
    Field::from_fn(fused.width, fused.height, |x, y| {
        let variance = -sides.get(x, y);
        if variance <= 0.0 {
            return fused.get(x, y);
        }
        let reach = (3.0 * variance.sqrt()).ceil() as usize;
        let (mut sum, mut in_front, mut light) = (0.0, 0.0, 0.0);
        for j in y.saturating_sub(reach)..=(y + reach).min(fused.height - 1) {
            for i in x.saturating_sub(reach)..=(x + reach).min(fused.width - 1) {
                let weight = (-((i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2)) as f64) / (2.0 * variance)).exp();
                sum += weight;
                if sides.get(i, j) > 0.0 {
                    in_front += weight;
                    light += weight * fused.get(i, j);
                }
            }
        }
        if in_front == 0.0 {
            return fused.get(x, y);
        }
        ((fused.get(x, y) - light / sum) / (1.0 - in_front / sum).max(shader::LEAST_SHARE)).max(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Input, Trial, random_field};
    use super::*;
    use crate::engine::stages::NO_VARIANT;
    use crate::engine::stages::edge::LAYERS;

    const LAYER: usize = 3;

    /// A front left of a curve, of two values of |V|, and what is behind within 11 px of it.
    fn sides(width: usize, height: usize) -> Field {
        Field::from_fn(width, height, |x, y| {
            let behind = x as f64 - 0.4 * width as f64 - 3.0 * (y as f64 / 7.0).sin();
            let variance = if y < height / 2 { 5.0 } else { 1.3 };
            if behind < 0.0 {
                variance
            } else if behind < 11.0 {
                -variance
            } else {
                0.0
            }
        })
    }

    #[test]
    fn matches_the_cpu_reference() {
        for [width, height] in [[37u32, 21u32], [64, 16], [130, 19]] {
            let mut results = vec![Field::zeros(width as usize, height as usize); LAYERS as usize];
            results[SIDES] = sides(width as usize, height as usize);
            results[LAYER] = random_field(width as usize, height as usize, 4);
            let c = Constants { width, height, layer: LAYER as u32 };
            let trial =
                Trial::run::<Bindings>(&[Input::Image(&results)], &c, NO_VARIANT, STAGE.groups([width, height]));
            // Light of up to 1 over a share of at least a quarter.
            trial.assert_within(2e-5);
        }
    }

    #[test]
    fn behind_a_bright_front_the_dark_ground_is_as_dark_as_far_from_it() {
        let (width, height) = (60, 40);
        let sides = Field::from_fn(width, height, |x, _| {
            if x < 25 {
                4.0
            } else if x < 36 {
                -4.0
            } else {
                0.0
            }
        });
        // The ground in focus, with the front's blur over it: half of the front's light at the rim.
        let share = |x: usize| {
            let (near, all): (Vec<f64>, Vec<f64>) = (-9..=9)
                .map(|d: i32| ((-f64::from(d * d) / 8.0).exp(), x as i32 + d < 25))
                .map(|(weight, in_front)| (if in_front { weight } else { 0.0 }, weight))
                .unzip();
            near.iter().sum::<f64>() / all.iter().sum::<f64>()
        };
        let fused = Field::from_fn(width, height, |x, _| if x < 25 { 0.9 } else { 0.1 + 0.8 * share(x) });
        assert!(fused.get(25, 20) > 0.4);
        let cleared = cpu_reference(&sides, &fused);
        for (n, (cleared, fused)) in cleared.data.iter().zip(&fused.data).enumerate() {
            // 0.002: both Gaussians end at 3 and at 4.5 σ.
            let expected = if n % width < 25 { 0.9 } else { 0.1 };
            assert!((cleared - expected).abs() < 0.002, "{}: {cleared}, {fused}", n % width);
        }
    }
}
