//! Areal height and hybrid parameters of ISO 25178-2 of a surface with missing pixels.

/// Row-major heights of an image, greater towards the camera. NaN marks missing pixels.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub(super) width: usize,
    /// The heights.
    pub(super) values: Vec<f64>,
}

/// Parameters of the heights about their mean, in the unit of the heights or without one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeightParameters {
    /// Arithmetic mean height.
    pub(super) sa: f64,
    /// Root mean square height.
    pub(super) sq: f64,
    /// Skewness.
    pub(super) ssk: f64,
    /// Kurtosis.
    pub(super) sku: f64,
    /// Maximum peak height.
    pub(super) sp: f64,
    /// Maximum pit height, positive.
    pub(super) sv: f64,
    /// Maximum height.
    pub(super) sz: f64,
}

impl Surface {
    /// Returns the height of the image, px.
    pub(super) fn height(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    /// Returns the number of measured pixels.
    pub(super) fn measured(&self) -> usize {
        self.values.iter().filter(|z| z.is_finite()).count()
    }

    /// Returns the mean of the measured pixels. NaN if there are none.
    pub(super) fn mean(&self) -> f64 {
        mean(self.values.iter().copied())
    }

    /// Returns the height parameters: the integrals of ISO 25178-2 over the area as means over the measured pixels.
    pub(super) fn height_parameters(&self) -> HeightParameters {
        let level = self.mean();
        let moment = |of: &dyn Fn(f64) -> f64| mean(self.values.iter().map(|z| of(z - level)));
        let sq = moment(&|z| z * z).sqrt();
        let finite = || self.values.iter().filter(|z| z.is_finite()).map(|z| z - level);
        let sp = finite().fold(f64::NAN, f64::max);
        let sv = -finite().fold(f64::NAN, f64::min);
        // Skewness and kurtosis of a flat surface would be quotients of rounding errors.
        let by_sq = |of: f64| if sq > 1e-12 * level.abs() { of } else { f64::NAN };
        HeightParameters {
            sa: moment(&f64::abs),
            sq,
            ssk: by_sq(moment(&|z| z.powi(3)) / sq.powi(3)),
            sku: by_sq(moment(&|z| z.powi(4)) / sq.powi(4)),
            sp,
            sv,
            sz: sp + sv,
        }
    }

    /// Returns the root mean square gradient Sdq, in heights per `pixel`.
    ///
    /// Gradients are differences of adjacent measured pixels. Each direction is averaged over its own differences.
    pub(super) fn sdq(&self, pixel: f64) -> f64 {
        let (width, values) = (self.width, &self.values);
        let across = values.chunks_exact(width).flat_map(|row| row.windows(2).map(|pair| pair[1] - pair[0]));
        let down = values.iter().zip(values.iter().skip(width)).map(|(above, below)| below - above);
        (mean(across.map(|d| d * d)) + mean(down.map(|d| d * d))).sqrt() / pixel
    }

    /// Returns the developed interfacial area ratio Sdr, %. `pixel` is the size of a pixel in the unit of the heights.
    ///
    /// The area of a cell of four measured pixels is the mean of its two triangulations.
    pub(super) fn sdr(&self, pixel: f64) -> f64 {
        let rows: Vec<&[f64]> = self.values.chunks_exact(self.width).collect();
        let triangle = |a: f64, b: f64| (1.0 + (a * a + b * b) / (pixel * pixel)).sqrt();
        let cells = rows.windows(2).flat_map(|pair| {
            let (above, below) = (pair[0], pair[1]);
            (1..above.len()).map(move |x| {
                let [top, bottom] = [above[x] - above[x - 1], below[x] - below[x - 1]];
                let [left, right] = [below[x - 1] - above[x - 1], below[x] - above[x]];
                let corners = triangle(top, left) + triangle(top, right) + triangle(bottom, left);
                0.25 * (corners + triangle(bottom, right))
            })
        });
        100.0 * (mean(cells) - 1.0)
    }
}

/// Returns the mean of the finite values. NaN if there are none.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.filter(|v| v.is_finite()).fold((0.0, 0usize), |(sum, n), v| (sum + v, n + 1));
    sum / count as f64
}

#[cfg(test)]
pub(super) mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;

    /// Makes a surface of a function of the place.
    pub(in crate::metric::roughness) fn surface([width, height]: [usize; 2], of: impl Fn(f64, f64) -> f64) -> Surface {
        let values = (0..width * height).map(|i| of((i % width) as f64, (i / width) as f64)).collect();
        Surface { width, values }
    }

    /// Asserts that two numbers differ by at most a share of the second.
    #[track_caller]
    pub(in crate::metric::roughness) fn close(value: f64, expected: f64, share: f64) {
        assert!((value - expected).abs() <= share * expected.abs(), "{value}, expected {expected}");
    }

    #[test]
    fn a_sine_has_its_closed_forms() {
        // Whole periods. The phase puts the crests between pixels, by 1/200 of a period at most.
        let (amplitude, period) = (3.0, 200.0);
        let sine = surface([800, 5], |x, _| 7.0 + amplitude * (TAU * (x + 0.5) / period).sin());
        let found = sine.height_parameters();
        close(found.sa, 2.0 * amplitude / PI, 1e-4);
        close(found.sq, amplitude / 2f64.sqrt(), 1e-12);
        close(found.sku, 1.5, 1e-12);
        assert!(found.ssk.abs() < 1e-12, "{found:?}");
        close(found.sz, 2.0 * amplitude, 2e-4);
        close(found.sp, found.sv, 1e-12);
        // Differences of pixels shorten the gradient by sinc(π/period).
        close(sine.sdq(0.5), TAU * amplitude / period / 2f64.sqrt() / 0.5, 1e-3);
        // ∫ sqrt(1 + g² cos²) = 1 + g²/4 - 3 g⁴/64 over a period.
        let g = TAU * amplitude / period / 0.5;
        close(sine.sdr(0.5), 100.0 * (g * g / 4.0 - 3.0 * g.powi(4) / 64.0), 2e-3);
    }

    #[test]
    fn a_tilted_plane_has_its_gradient_and_area() {
        let plane = surface([30, 20], |x, y| 0.3 * x - 0.4 * y);
        close(plane.sdq(1.0), 0.5, 1e-12);
        close(plane.sdr(1.0), 100.0 * (1.25f64.sqrt() - 1.0), 1e-12);
        close(plane.sdq(0.1), 5.0, 1e-12);
    }

    #[test]
    fn missing_pixels_are_left_out_and_peaks_are_towards_the_camera() {
        let mut bumpy = surface([40, 30], |x, _| if x < 20.0 { -1.0 } else { 1.0 });
        bumpy.values[100] = 5.0;
        for i in [3, 99, 101, 640, 1199] {
            bumpy.values[i] = f64::NAN;
        }
        let found = bumpy.height_parameters();
        let measured: Vec<f64> = bumpy.values.iter().copied().filter(|z| z.is_finite()).collect();
        let dense = Surface { width: measured.len(), values: measured };
        assert_eq!((bumpy.measured(), found), (1195, dense.height_parameters()));
        assert!(found.ssk > 0.0 && found.sp > found.sv, "{found:?}");
        assert!(bumpy.sdq(1.0).is_finite() && bumpy.sdr(1.0).is_finite());
        let flat = surface([9, 9], |_, _| 4.0).height_parameters();
        assert_eq!((flat.sa, flat.sz), (0.0, 0.0));
        assert!(flat.ssk.is_nan() && flat.sku.is_nan());
    }
}
