//! The positions on I1 that the pixels of an image see, and parallel work on rows.

use crate::base::{Similarity, centre, workers};

/// The map from an image to the frame of I1: pixel q sees `T⁻¹ q`, and its blur rotates with the sensor.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    back: Similarity,
    centre: [f64; 2],
    /// M = A⁻¹ as `[p, q]`: M u = (p u_x - q u_y, q u_x + p u_y), with A the linear part of T.
    linear: [f64; 2],
    /// s, the scale of the image relative to I1.
    pub(super) scale: f64,
}

/// A row of an image. Pixel i sees the position `start + i step` of I1, with a blur of `variances[i]` px² on the
/// sensor.
pub(super) struct Row<'a> {
    pub(super) view: &'a View,
    pub(super) start: [f64; 2],
    pub(super) step: [f64; 2],
    pub(super) variances: &'a [f64],
}

impl View {
    /// Makes the view of an image in which `T x` corresponds to x of I1. The identity gives I1 itself.
    pub(super) fn new(transform: &Similarity, [width, height]: [u32; 2]) -> Self {
        let back = transform.inverse();
        let [a, b, ..] = back.displacement();
        Self { back, centre: centre(width, height), linear: [1.0 + a, b], scale: transform.scale }
    }

    /// The position on I1 that pixel q sees: `T⁻¹ q`.
    pub(super) fn place(&self, q: [f64; 2]) -> [f64; 2] {
        self.back.apply(q, self.centre)
    }

    /// Converts a displacement on the sensor to one in I1: M u.
    pub(super) fn turn(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [p, q] = self.linear;
        [p * x - q * y, q * x + p * y]
    }

    /// Converts a length on the sensor to one in I1.
    pub(super) fn length(&self, length: f64) -> f64 {
        length * self.linear[0].hypot(self.linear[1])
    }

    /// Converts an angular frequency in I1 to one on the sensor: Mᵀ k.
    pub(super) fn frequency(&self, [kx, ky]: [f64; 2]) -> [f64; 2] {
        let [p, q] = self.linear;
        [p * kx + q * ky, p * ky - q * kx]
    }

    /// Row `y` of the image.
    pub(super) fn row<'a>(&'a self, y: usize, variances: &'a [f64]) -> Row<'a> {
        Row { view: self, start: self.place([0.0, y as f64]), step: self.turn([1.0, 0.0]), variances }
    }
}

impl Row<'_> {
    /// The position in I1 that pixel `i` sees.
    pub(super) fn place(&self, i: usize) -> [f64; 2] {
        let i = i as f64;
        [self.start[0] + i * self.step[0], self.start[1] + i * self.step[1]]
    }
}

/// Makes a field. All processors fill its rows in parallel.
pub(super) fn fill_rows([width, height]: [u32; 2], fill: impl Fn(usize, &mut [f64]) + Sync) -> Vec<f64> {
    let (width, height) = (width as usize, height as usize);
    let mut values = vec![0.0; width * height];
    workers::for_each(values.chunks_mut(width.max(1)).enumerate(), |(i, row)| fill(i, row));
    values
}

/// The integer at or below `p`, and the remainder in [0, 1). It is called thousands of times per pixel. `floor` may be
/// a function call, but a truncation and a comparison are not.
pub(super) fn split(p: f64) -> (i64, f64) {
    let i = p as i64;
    let i = i - i64::from(p < i as f64);
    (i, p - i as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_places_and_frequencies_agree_with_the_similarity() {
        let (t, size) = (Similarity::new(1.3, -0.9, 12.0, 1.07), [41, 31]);
        let view = View::new(&t, size);
        let x = [7.5, 20.25];
        let [px, py] = view.place(t.apply(x, centre(41, 31)));
        assert!((px - x[0]).hypot(py - x[1]) < 1e-12);
        let variances = [0.0; 41];
        let place = view.row(5, &variances).place(30);
        let direct = view.place([30.0, 5.0]);
        assert!((place[0] - direct[0]).hypot(place[1] - direct[1]) < 1e-12);
        let (u, k) = ([0.3, -2.0], [1.1, 0.4]);
        let ([ux, uy], [wx, wy]) = (view.turn(u), view.frequency(k));
        assert!((k[0] * ux + k[1] * uy - (wx * u[0] + wy * u[1])).abs() < 1e-12);
    }

    #[test]
    fn split_rounds_down() {
        assert_eq!([split(2.25), split(-2.25), split(-3.0), split(0.0)], [(2, 0.25), (-3, 0.75), (-3, 0.0), (0, 0.0)]);
    }

    #[test]
    fn every_row_is_filled_once() {
        for size in [[3, 1], [5, 7], [2, 64]] {
            let values = fill_rows(size, |y, row| row.iter_mut().for_each(|v| *v += 1.0 + y as f64));
            let rows: Vec<f64> = values.chunks(size[0] as usize).map(|row| row[0]).collect();
            assert_eq!(rows, (1..=size[1]).map(f64::from).collect::<Vec<_>>());
        }
    }
}
