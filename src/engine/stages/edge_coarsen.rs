//! Computes V and its standard deviation on a coarser level from those of the finest one, for the search for outlines.
//!
//! Both are means under a tent, of samples of the finest level that are one or three pixels apart. The deviation is NaN
//! where it is NaN on all of them, so that excluded areas do not grow.

use super::edge::COARSE_DEVIATION;
use super::pass::{Memory, Pass};
use super::segments::vectorised;
use super::{Number, Raster, pixels};
use crate::engine::plan::Level;
use crate::engine::vulkan::Variant;

pub use super::interface::edge_coarsen::*;

impl Constants {
    /// Those of a level of a pair: V depends on the size of pixels. Noise makes an edge of V wind, so that the normals
    /// of its cells do not agree; a wide tent makes it straight.
    pub(crate) fn of_pair(level: &Level, finest: [u32; 2]) -> Self {
        let ([width, height], pixels) = (level.size, 1 << level.index);
        Self { width, height, finest, pixels, apart: 3, scale: 1.0 / (pixels * pixels) as f32 }
    }

    /// Those of a level of a sweep.
    pub(crate) fn of_sweep(level: &Level, finest: [u32; 2]) -> Self {
        Self { apart: 1, scale: 1.0, ..Self::of_pair(level, finest) }
    }
}

impl Pass for Bindings {
    /// Compulsory traffic: V and its deviation read, both written on the coarser level.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * (pixels(c.finest[0], c.finest[1]) + pixels(c.width, c.height))
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let [v, deviation] = cpu_reference(c, memory.layer(self.relative_blur, 0), memory.layer(self.results, 1));
        memory.set_layer(self.coarse, 0, v);
        memory.set_layer(self.results, COARSE_DEVIATION, deviation);
    }
}

/// V and its standard deviation on the coarser level.
pub(crate) fn cpu_reference<N: Number>(c: &Constants, v: &Raster<N>, deviation: &Raster<N>) -> [Raster<N>; 2] {
    let [pixels, apart] = [c.pixels, c.apart].map(|n| n as isize);
    // Samples of a tent about a pixel of the coarser level, and their weights.
    let tent = |x: usize, size: usize| {
        let place = move |i: isize| (pixels * x as isize + apart * i).clamp(0, size as isize - 1) as usize;
        (1 - pixels..pixels).map(move |i| (place(i), (pixels - i.abs()) as f64))
    };
    [v, deviation].map(|field| {
        let mut coarse = Raster::zeros(c.width as usize, c.height as usize);
        coarse.fill_rows(|y, row| {
            // Down each column: the weighted sum of what is a number, and the weights.
            let [mut sums, mut weights] = [(); 2].map(|()| vec![0.0; field.width]);
            for (y, share) in tent(y, field.height) {
                let (sums, weights) = (&mut sums[..field.width], &mut weights[..field.width]);
                let values = &field.row(y)[..field.width];
                vectorised::<N, _>(
                    #[inline(always)]
                    || {
                        for x in 0..values.len() {
                            let value: f64 = values[x].into();
                            sums[x] += if value.is_nan() { 0.0 } else { share * value };
                            weights[x] += if value.is_nan() { 0.0 } else { share };
                        }
                    },
                );
            }
            for (x, mean) in row.iter_mut().enumerate() {
                let [sum, weight] = tent(x, field.width)
                    .fold([0.0; 2], |[sum, weight], (x, share)| [sum + share * sums[x], weight + share * weights[x]]);
                *mean = N::of(f64::from(c.scale) * sum / weight);
            }
        });
        coarse
    })
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn a_plane_is_the_same_on_a_coarser_level_and_nan_does_not_spread() {
        let v = Field::from_fn(37, 22, |x, y| x as f64 - 2.0 * y as f64);
        let deviation = Field::from_fn(37, 22, |x, y| if x > 20 && y > 7 { f64::NAN } else { 1.0 });
        let c = Constants { width: 19, height: 11, finest: [37, 22], pixels: 2, apart: 1, scale: 0.25 };
        let [v, deviation] = cpu_reference(&c, &v, &deviation);
        // Away from the border, where pixels are repeated.
        let is_plane = |x: usize, y: usize| (v.get(x, y) - 0.5 * x as f64 + y as f64).abs() < 1e-12;
        assert!((1..18).all(|x| (1..10).all(|y| is_plane(x, y))));
        assert!((0..19).all(|x| (0..11).all(|y| deviation.get(x, y).is_nan() == (x > 10 && y > 4))));
        assert_eq!(deviation.get(10, 4), 0.25);
    }
}
