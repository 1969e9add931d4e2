//! A map without gaps, for people who look and for the fused image: what is not measured lies between what is.
//!
//! It solves `Σ w (u_q - u_p) = 0` over the four neighbours q of each pixel p that is not measured, with w small across
//! edges of the photograph, by a cascade: from single pixels to the whole, each level started by the coarser one.

use crate::base::{Decode, Frame};

/// Relaxation sweeps of a level, each forth and back.
const SWEEPS: usize = 6;
/// The step of the photograph over which w is a half, as a share of its standard deviation.
const EDGE: f64 = 0.1;

/// A map on one level.
struct Level {
    size: [usize; 2],
    values: Vec<f32>,
    /// 1/σ² of each value; 0 where it is not measured.
    weights: Vec<f32>,
    guide: Vec<f32>,
}

/// The map with each NaN filled in, by a photograph of the same pixels. A value counts by 1/σ². If all are NaN, they
/// stay NaN.
pub(crate) fn filled(values: &[f32], deviation: &[f32], guide: Vec<f32>, width: usize) -> Vec<f32> {
    let mean = |of: &dyn Fn(f64) -> f64| guide.iter().map(|v| of((*v).into())).sum::<f64>() / guide.len().max(1) as f64;
    let variance = mean(&|v| v * v) - mean(&|v| v).powi(2);
    let edge = (EDGE * variance.max(0.0).sqrt()).max(1e-6) as f32;
    let weight = |(v, sigma): (&f32, &f32)| if v.is_finite() { sigma.max(1e-3).powi(-2) } else { 0.0 };
    let weights = values.iter().zip(deviation).map(weight).collect();
    Level { size: [width, values.len() / width.max(1)], values: values.to_vec(), weights, guide }.filled(edge)
}

/// The frame with the pixels filled in that are not part of the picture, so that filters see no edge there.
pub(crate) fn filled_frame(frame: Frame) -> Frame {
    let Some(counted) = frame.counted() else { return frame };
    let (mut values, width) = (frame.intensities(Decode::None), frame.width() as usize);
    let channels = values.len() / counted.len().max(1);
    for channel in 0..channels {
        let own = values.iter().skip(channel).step_by(channels).zip(counted);
        let own: Vec<f32> = own.map(|(v, counts)| if *counts == 0 { f32::NAN } else { *v }).collect();
        let whole = filled(&own, &vec![1.0; own.len()], vec![0.0; own.len()], width);
        let to = values.iter_mut().skip(channel).step_by(channels);
        to.zip(whole).for_each(|(to, v)| *to = if v.is_nan() { 0.0 } else { v });
    }
    frame.with_intensities(&values)
}

impl Level {
    fn filled(self, edge: f32) -> Vec<f32> {
        let ([width, height], is_known) = (self.size, |i: usize| self.weights[i] > 0.0);
        if self.values.len() <= 1 || (0..self.values.len()).all(is_known) {
            return self.values;
        }
        let coarser = self.coarser();
        let columns = coarser.size[0];
        let coarse = coarser.filled(edge);
        let start =
            |i: usize| if is_known(i) { self.values[i] } else { coarse[i / width / 2 * columns + i % width / 2] };
        let mut filled: Vec<f32> = (0..self.values.len()).map(start).collect();
        let unknown: Vec<usize> = (0..self.values.len()).filter(|&i| !is_known(i)).collect();
        let mut relax = |&i: &usize| {
            let (x, y) = (i % width, i / width);
            let near = [
                (x > 0, i.wrapping_sub(1)),
                (x + 1 < width, i + 1),
                (y > 0, i.wrapping_sub(width)),
                (y + 1 < height, i + width),
            ];
            let (mut sum, mut all) = (0.0, 0.0);
            for (_, n) in near.into_iter().filter(|(exists, _)| *exists) {
                let w = 1.0 / (1.0 + ((self.guide[n] - self.guide[i]) / edge).powi(2));
                (sum, all) = (sum + w * filled[n], all + w);
            }
            filled[i] = sum / all;
        };
        for _ in 0..SWEEPS {
            unknown.iter().for_each(&mut relax);
            unknown.iter().rev().for_each(&mut relax);
        }
        filled
    }

    /// Cells of two by two pixels. A cell is measured if one of its pixels is.
    fn coarser(&self) -> Self {
        let ([width, height], size) = (self.size, self.size.map(|side| side.div_ceil(2)));
        let mut cells = vec![[0.0f32; 4]; size[0] * size[1]];
        for i in 0..width * height {
            let [weights, values, guide, count] = &mut cells[i / width / 2 * size[0] + i % width / 2];
            if self.weights[i] > 0.0 {
                *weights += self.weights[i];
                *values += self.weights[i] * self.values[i];
            }
            (*guide, *count) = (*guide + self.guide[i], *count + 1.0);
        }
        let weights = cells.iter().map(|cell| cell[0]).collect();
        let values = cells.iter().map(|cell| cell[1] / cell[0]).collect();
        Self { size, values, weights, guide: cells.iter().map(|cell| cell[2] / cell[3]).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Samples};

    #[test]
    fn gaps_are_filled_up_to_the_edges_of_the_photograph() {
        let (width, height) = (40, 24);
        let places = || (0..width * height).map(|i| i % width);
        // Known are two columns at either end; the photograph has an edge at column 10.
        let values: Vec<f32> =
            places().map(|x| [1.0, f32::NAN, 2.0][usize::from(x > 1) + usize::from(x > 37)]).collect();
        let guide = places().map(|x| if x < 10 { 0.2 } else { 0.8 } + 0.001 * (x % 2) as f32).collect();
        let found = filled(&values, &vec![0.1; width * height], guide, width);
        assert_eq!((found[0], found[39]), (1.0, 2.0), "what is measured stays");
        assert!(
            found.iter().zip(places()).all(|(u, x)| (u - if x < 10 { 1.0 } else { 2.0 }).abs() < 0.3),
            "{:?}",
            &found[..40]
        );
        assert!(filled(&[f32::NAN; 6], &[f32::NAN; 6], vec![0.5; 6], 3).iter().all(|u| u.is_nan()));
    }

    #[test]
    fn pixels_that_do_not_count_continue_those_around_them() {
        let hole = |i: usize| (6..17).contains(&(i % 23)) && (4..13).contains(&(i / 23));
        let samples =
            (0..23 * 17).flat_map(|i| if hole(i) { [255; 3] } else { [100 + (i % 23) as u8, 7, 90] }).collect();
        let frame = Frame::new(23, 17, Channels::Rgb, Samples::U8(samples)).unwrap();
        let counted: Vec<u8> = (0..23 * 17).map(|i| u8::from(!hole(i))).collect();
        let whole = filled_frame(frame.clone().without(&counted));
        for (i, [a, b]) in frame.bytes().chunks(3).zip(whole.bytes().chunks(3)).map(|(a, b)| [a, b]).enumerate() {
            let is_near = b[0].abs_diff(100 + (i % 23) as u8) < 4 && b[1..] == [7, 90];
            assert!(if hole(i) { is_near } else { a == b }, "{i}: {a:?} {b:?}");
        }
        assert_eq!(filled_frame(frame.without(&[0; 23 * 17])).bytes()[..3], [0; 3]);
    }
}
