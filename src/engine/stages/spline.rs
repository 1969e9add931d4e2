//! Fields of numbers with the border rule of the shaders, and cubic B-splines over them.
//!
//! The CPU reference of `glsl/include/border.glsl` and `glsl/include/spline.glsl`.

use super::number::{Number, Real};
use super::rows::{self, Rows};
use super::segments::{SEGMENT, Segment, place, range, vectorised};

/// `height` rows of `width` numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Raster<N> {
    /// Numbers per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub data: Vec<N>,
}

/// A raster in double precision.
pub type Field = Raster<f64>;

impl<N: Number> Raster<N> {
    /// A raster with `value(x, y)` at each place. Rows are computed in parallel.
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let mut raster = Self::zeros(width, height);
        raster.fill_rows(|y, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = N::of(value(x, y))));
        raster
    }

    /// Rasters with the numbers of `values(x, y)` at each place, one each. Rows are computed in parallel.
    pub(crate) fn several<const COUNT: usize>(
        [width, height]: [usize; 2],
        values: impl Fn(usize, usize) -> [f64; COUNT] + Sync,
    ) -> [Self; COUNT] {
        let mut rasters = [(); COUNT].map(|()| Self::zeros(width, height));
        rows::map(rasters.each_mut().map(Rows::from), |y, mut rows| {
            for x in 0..width {
                rows.iter_mut().zip(values(x, y)).for_each(|(row, value)| row[x] = N::of(value));
            }
        });
        rasters
    }

    /// Calls `fill(y, row)` for each row, in parallel if there are many pixels.
    pub(crate) fn fill_rows(&mut self, fill: impl Fn(usize, &mut [N]) + Sync) {
        rows::map([self.into()], |y, [row]| fill(y, row));
    }

    /// Fills rasters of one size with the numbers of the segments of pixels from (x, y) to the right. `numbers` and what
    /// it calls must be `#[inline(always)]`.
    pub(super) fn fill_segments<const COUNT: usize>(
        mut rasters: [Self; COUNT],
        numbers: impl Fn([usize; 2]) -> [Segment<N>; COUNT] + Sync,
    ) -> [Self; COUNT] {
        rows::map(rasters.each_mut().map(Rows::from), |y, mut rows| {
            for x in (0..rows[0].len()).step_by(SEGMENT) {
                let numbers = vectorised::<N, _>(
                    #[inline(always)]
                    || numbers([x, y]),
                );
                for (row, numbers) in rows.iter_mut().zip(&numbers) {
                    let count = SEGMENT.min(row.len() - x);
                    row[x..][..count].copy_from_slice(&numbers[..count]);
                }
            }
        });
        rasters
    }

    /// A raster of zeros.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![N::default(); width * height] }
    }

    /// The memory of a raster for one of another size. Its numbers are undefined: no time is lost to set them.
    pub(crate) fn of_size(mut self, [width, height]: [usize; 2]) -> Self {
        let count = width * height;
        if self.data.capacity() < count {
            // The system's memory is zero: no page is touched before a thread fills it.
            self.data = vec![N::default(); count];
        }
        self.data.resize(count, N::default());
        Self { width, height, ..self }
    }

    /// The number at a place inside.
    pub fn get(&self, x: usize, y: usize) -> f64 {
        self.data[y * self.width + x].into()
    }

    /// The number at a place, mirrored about the border pixels.
    pub fn mirrored(&self, x: isize, y: isize) -> f64 {
        self.get(mirror(x, self.width), mirror(y, self.height))
    }

    /// The number at the nearest place inside.
    #[inline]
    pub fn clamped(&self, x: isize, y: isize) -> f64 {
        self.get(x.clamp(0, self.width as isize - 1) as usize, y.clamp(0, self.height as isize - 1) as usize)
    }

    /// Sets the number at a place inside.
    pub fn set(&mut self, x: usize, y: usize, value: f64) {
        self.data[y * self.width + x] = N::of(value);
    }

    /// A row.
    pub(crate) fn row(&self, y: usize) -> &[N] {
        &self.data[y * self.width..][..self.width]
    }
}

impl<'a, N: Number> From<&'a mut Raster<N>> for Rows<'a, N> {
    fn from(raster: &'a mut Raster<N>) -> Self {
        Self { width: raster.width, numbers: &mut raster.data }
    }
}

impl Field {
    /// From the numbers of an image on the device.
    pub fn from_f32(width: usize, height: usize, data: &[f32]) -> Self {
        Self { width, height, data: data.iter().map(|&v| f64::from(v)).collect() }
    }

    /// The corner of a wider image on the device with `row` numbers per row.
    pub(crate) fn corner(data: &[f32], row: usize, [width, height]: [usize; 2]) -> Self {
        let mut corner = Self { width, height, data: Vec::with_capacity(width * height) };
        for row in data.chunks_exact(row).take(height) {
            corner.data.extend(row[..width].iter().map(|&v| f64::from(v)));
        }
        corner
    }

    /// As numbers of an image on the device.
    pub fn to_f32(&self) -> Vec<f32> {
        self.data.iter().map(|&v| v as f32).collect()
    }
}

/// Reflects about 0 and `size - 1`, repeatedly.
pub fn mirror(i: isize, size: usize) -> usize {
    fold(i, 2 * (size - 1))
}

/// Reflects about 0 and half a period, repeatedly.
pub fn fold(i: isize, period: usize) -> usize {
    let j = i.unsigned_abs() % period.max(1);
    j.min(period.max(1) - j)
}

/// Value, gradient and Laplacian of a spline at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jet<R = f64> {
    /// Value.
    pub value: R,
    /// Derivative to the right.
    pub dx: R,
    /// Derivative downwards.
    pub dy: R,
    /// Second derivatives, added.
    pub laplacian: R,
}

/// Weights of four coefficients at a fraction `t` after the second, with their first and second derivatives.
#[inline(always)]
pub(crate) fn weights<R: Real>(t: R) -> [[R; 4]; 3] {
    let [one, two, three, half, sixth, most] = R::all([1.0, 2.0, 3.0, 0.5, 1.0 / 6.0, 2.0 / 3.0]);
    let (u, steep) = (one - t, R::of(1.5));
    [
        [sixth * u * u * u, most - t * t + half * t * t * t, most - u * u + half * u * u * u, sixth * t * t * t],
        [-half * u * u, steep * t * t - two * t, two * u - steep * u * u, half * t * t],
        [u, three * t - two, three * u - two, t],
    ]
}

impl<R: Real> Jet<R> {
    /// The spline at a small shift, to first order.
    ///
    /// Not to second order: at frequency ω the second derivative of a cubic spline on the pixels, `-6 (1 - cos ω)/(2 +
    /// cos ω)`, outweighs the square of its first. Noise would then fall with the shift, all over the image, and T
    /// would drift from where I2 was last warped: by 0.2 px on the dimple pair, whose texture is weak.
    #[inline(always)]
    pub fn moved(self, [x, y]: [R; 2]) -> Self {
        Self { value: self.value + self.dx * x + self.dy * y, ..self }
    }

    /// A Gaussian's node, and its slope by the variance: half the Laplacian.
    #[inline(always)]
    pub(super) fn node(self) -> (Self, R) {
        (self, R::of(0.5) * self.laplacian)
    }
}

/// The spline at a pixel from the nine coefficients about it, instead of sixteen.
#[inline(always)]
fn on_pixel<R: Real>(taps: [[R; 3]; 3]) -> Jet<R> {
    let [four, half, sixth] = R::all([4.0, 0.5, 1.0 / 6.0]);
    let smooth = |[before, here, behind]: [R; 3]| sixth * (before + four * here + behind);
    let slope = |[before, _, behind]: [R; 3]| half * (behind - before);
    let bend = |[before, here, behind]: [R; 3]| before - here - here + behind;
    let [above, here, below] = taps;
    let along = [smooth(above), smooth(here), smooth(below)];
    Jet {
        value: smooth(along),
        dx: smooth([slope(above), slope(here), slope(below)]),
        dy: slope(along),
        laplacian: smooth([bend(above), bend(here), bend(below)]) + bend(along),
    }
}

/// The places before, at and behind i, mirrored.
#[inline(always)]
fn beside(i: usize, size: usize) -> [usize; 3] {
    match i {
        _ if i > 0 && i + 1 < size => [i - 1, i, i + 1],
        _ => [mirror(i as isize - 1, size), i, mirror(i as isize + 1, size)],
    }
}

/// The spline at pixel (x, y). What a caller does not use is not computed.
#[inline(always)]
pub fn near<N: Number>(coefficients: &Raster<N>, x: usize, y: usize) -> Jet {
    let (columns, rows) = (beside(x, coefficients.width), beside(y, coefficients.height));
    let mut taps = [[0.0; 3]; 3];
    for (taps, row) in taps.iter_mut().zip(rows) {
        let row = coefficients.row(row);
        *taps = [row[columns[0]].into(), row[columns[1]].into(), row[columns[2]].into()];
    }
    on_pixel(taps)
}

/// Calls `visit` with the spline at each pixel of the segment from (x, y) to the right, mirrored beyond the border.
#[inline(always)]
pub(super) fn near_segment<N: Number>(
    coefficients: &Raster<N>,
    [x, y]: [usize; 2],
    mut visit: impl FnMut(usize, Jet<N>),
) {
    const COUNT: usize = SEGMENT + 2;
    let mut mirrored = [[N::default(); COUNT]; 3];
    let [above, here, below] = beside(y, coefficients.height).map(|y| coefficients.row(y));
    let inner = [above, here, below].map(|row| row.get(x.wrapping_sub(1)..).and_then(<[N]>::first_chunk));
    // Arrays, whose length is known: without checks of indices, loops are vectorised.
    let rows: [&[N; COUNT]; 3] = if let [Some(above), Some(here), Some(below)] = inner {
        [above, here, below]
    } else {
        let (before, inside) = (usize::from(x == 0), coefficients.width.min(x + COUNT - 1) - x.max(1) + 1);
        for (mirrored, row) in mirrored.iter_mut().zip([above, here, below]) {
            mirrored[before..][..inside].copy_from_slice(&row[x.max(1) - 1..][..inside]);
            for n in (0..before).chain(before + inside..COUNT) {
                mirrored[n] = row[mirror((x + n) as isize - 1, coefficients.width)];
            }
        }
        mirrored.each_ref()
    };
    for n in 0..SEGMENT {
        let mut taps = [[N::default(); 3]; 3];
        for j in 0..3 {
            for i in 0..3 {
                taps[j][i] = rows[j][n + i];
            }
        }
        visit(n, on_pixel(taps));
    }
}

/// The spline from sixteen coefficients, at fractions after the second column and row.
#[inline(always)]
fn between_pixels<R: Real>(taps: [[R; 4]; 4], [x, y]: [R; 2]) -> Jet<R> {
    let (wx, wy) = (weights(x), weights(y));
    let mut jet = Jet { value: R::default(), dx: R::default(), dy: R::default(), laplacian: R::default() };
    for j in 0..4 {
        let mut line = [R::default(); 3];
        for i in 0..4 {
            for n in 0..3 {
                line[n] += wx[n][i] * taps[j][i];
            }
        }
        jet.value += wy[0][j] * line[0];
        jet.dx += wy[0][j] * line[1];
        jet.dy += wy[1][j] * line[0];
        jet.laplacian += wy[0][j] * line[2] + wy[2][j] * line[0];
    }
    jet
}

/// The spline of these coefficients at (x, y), pixels.
#[inline]
pub fn read<N: Number>(coefficients: &Raster<N>, x: f64, y: f64) -> Jet {
    let (width, height) = (coefficients.width, coefficients.height);
    // Clamped, so that the index stays within an integer.
    let (x, y) = (x.clamp(-1.0, width as f64), y.clamp(-1.0, height as f64));
    let (column, row) = (x.floor(), y.floor());
    let corner = [column as isize - 1, row as isize - 1];
    let mut taps = [[0.0; 4]; 4];
    for (j, taps) in taps.iter_mut().enumerate() {
        let line = taps_of_row::<N, 4>(coefficients, corner, j);
        for i in 0..4 {
            taps[i] = line[i].into();
        }
    }
    between_pixels(taps, [x - column, y - row])
}

/// `COUNT` numbers of row j after a corner, mirrored.
#[inline(always)]
fn taps_of_row<N: Number, const COUNT: usize>(raster: &Raster<N>, [x, y]: [isize; 2], j: usize) -> [N; COUNT] {
    let (y, mut taps) = (y + j as isize, [N::default(); COUNT]);
    let row = raster.row(if y >= 0 && (y as usize) < raster.height { y as usize } else { mirror(y, raster.height) });
    if x >= 0 && x as usize + COUNT <= row.len() {
        taps.copy_from_slice(&row[x as usize..][..COUNT]);
        return taps;
    }
    for (i, tap) in taps.iter_mut().enumerate() {
        *tap = row[mirror(x + i as isize, raster.width)];
    }
    taps
}

/// `MOST` numbers of each of `COUNT` rows from a corner on, if all are inside.
#[inline(always)]
fn inner_rows<N: Number, const COUNT: usize, const MOST: usize>(
    raster: &Raster<N>,
    [x, y]: [isize; 2],
) -> Option<[&[N; MOST]; COUNT]> {
    let [x, y] = [usize::try_from(x).ok()?, usize::try_from(y).ok()?];
    let row = |j: usize| raster.data.get((y + j) * raster.width..(y + j + 1) * raster.width)?.get(x..)?.first_chunk();
    let mut rows = [row(0)?; COUNT];
    for j in 1..COUNT {
        rows[j] = row(j)?;
    }
    Some(rows)
}

/// Calls `visit` for each pixel of the segment from (x, y) to the right, displaced by d, with `COUNT` x `COUNT` numbers
/// about its place, mirrored, and the fractions of its place. The first number is `before` pixels before the place.
/// Places are moved to between `bounds` of the last column or row.
#[inline(always)]
pub(super) fn displaced_taps<N: Number, const COUNT: usize>(
    raster: &Raster<N>,
    [x, y]: [usize; 2],
    d: [&Segment<N>; 2],
    before: usize,
    bounds: impl Fn(f64) -> [f64; 2],
    mut visit: impl FnMut(usize, [[N; COUNT]; COUNT], [N; 2]),
) {
    /// The numbers of a row about a segment.
    const MOST: usize = SEGMENT + 3;
    const { assert!(COUNT <= 4) };
    let size = [raster.width, raster.height];
    let [mut whole, mut fractions] = [[[N::default(); SEGMENT]; 2]; 2];
    for axis in 0..2 {
        let [least, most]: [N; 2] = N::all(bounds(size[axis] as f64 - 1.0));
        for n in 0..SEGMENT {
            let first = if axis == 0 { place(x, n) } else { N::of(y as f64) };
            let d = d[axis][n].max(least - first).min(most - first);
            whole[axis][n] = d.floor();
            fractions[axis][n] = d - d.floor();
        }
    }
    let ([left, right], [top, bottom]) = (range(&whole[0]), range(&whole[1]));
    let first = [x as f64 + left, y as f64 + top].map(|first| first as isize - before as isize);
    // Usually all pixels are displaced by the same whole pixels.
    let is_even = left == right && top == bottom;
    if let Some(rows) = is_even.then(|| inner_rows::<N, COUNT, MOST>(raster, first)).flatten() {
        for n in 0..SEGMENT {
            let mut taps = [[N::default(); COUNT]; COUNT];
            for j in 0..COUNT {
                for i in 0..COUNT {
                    taps[j][i] = rows[j][n + i];
                }
            }
            visit(n, taps, [fractions[0][n], fractions[1][n]]);
        }
        return;
    }
    let mut gathered = [[[N::default(); SEGMENT]; COUNT]; COUNT];
    for n in 0..SEGMENT {
        let [column, row]: [f64; 2] = [whole[0][n].into(), whole[1][n].into()];
        let corner = [(x + n) as isize + column as isize, y as isize + row as isize].map(|at| at - before as isize);
        for j in 0..COUNT {
            let line = taps_of_row::<N, COUNT>(raster, corner, j);
            for i in 0..COUNT {
                gathered[j][i][n] = line[i];
            }
        }
    }
    for n in 0..SEGMENT {
        let mut taps = [[N::default(); COUNT]; COUNT];
        for j in 0..COUNT {
            for i in 0..COUNT {
                taps[j][i] = gathered[j][i][n];
            }
        }
        visit(n, taps, [fractions[0][n], fractions[1][n]]);
    }
}

/// Calls `visit` with the spline at each pixel of the segment from (x, y) to the right, displaced by d. Beyond the
/// border it is mirrored, and constant beyond the `bounds` of the last column or row.
#[inline(always)]
pub(super) fn read_segment<N: Number>(
    coefficients: &Raster<N>,
    at: [usize; 2],
    d: [&Segment<N>; 2],
    bounds: impl Fn(f64) -> [f64; 2],
    mut visit: impl FnMut(usize, Jet<N>),
) {
    displaced_taps::<N, 4>(
        coefficients,
        at,
        d,
        1,
        bounds,
        #[inline(always)]
        |n, taps, fractions| visit(n, between_pixels(taps, fractions)),
    );
}

/// The values of the spline where `place` takes each pixel; NaN where that is.
pub(crate) fn resampled(coefficients: &Field, place: impl Fn([usize; 2]) -> [f64; 2] + Sync) -> Field {
    let width = coefficients.width;
    let [values] = Field::fill_segments(
        [Field::zeros(width, coefficients.height)],
        #[inline(always)]
        |[x, y]| {
            let mut d = [[0.0; SEGMENT]; 2];
            for n in 0..SEGMENT.min(width - x) {
                let [px, py] = place([x + n, y]);
                (d[0][n], d[1][n]) = (px - (x + n) as f64, py - y as f64);
            }
            let mut values = [0.0; SEGMENT];
            read_segment(
                coefficients,
                [x, y],
                [&d[0], &d[1]],
                |last| [-1.0, last + 1.0],
                |n, jet| {
                    values[n] = if (d[0][n] + d[1][n]).is_nan() { f64::NAN } else { jet.value };
                },
            );
            [values]
        },
    );
    values
}

#[cfg(test)]
mod tests {
    use super::super::harness::smooth_field;
    use super::*;

    /// Calls `check` with spline coefficients of sides about those of segments, and each of their pixels.
    fn for_pixels(check: impl Fn(&Field, usize, usize)) {
        for (width, height) in [(1, 1), (2, 5), (33, 2), (35, 7), (66, 6), (131, 9)] {
            let coefficients = smooth_field(width, height, 1);
            (0..height).for_each(|y| (0..width).for_each(|x| check(&coefficients, x, y)));
        }
    }

    #[test]
    fn a_segment_on_pixels_is_each_pixel_alone() {
        for_pixels(|coefficients, x, y| {
            near_segment(coefficients, [x, y], |n, jet| {
                if x + n < coefficients.width {
                    assert_eq!(jet, near(coefficients, x + n, y), "({x}, {y}) {n}");
                }
            });
        });
    }

    #[test]
    fn a_displaced_segment_is_each_pixel_alone() {
        let [zero, shifted, far] = [[0.0; SEGMENT], [-1.7; SEGMENT], [40.25; SEGMENT]];
        let [slanted, steep] = [0.013, -1.4].map(|step| std::array::from_fn(|n| 0.4 + step * n as f64));
        for [dx, dy] in [[zero, zero], [shifted, slanted], [slanted, shifted], [steep, zero], [zero, far], [far, steep]]
        {
            for_pixels(|coefficients, x, y| {
                let bounds = |last: f64| [-1.0, last + 1.0];
                read_segment(coefficients, [x, y], [&dx, &dy], bounds, |n, actual| {
                    let expected = read(coefficients, (x + n) as f64 + dx[n], y as f64 + dy[n]);
                    let errors = [
                        actual.value - expected.value,
                        actual.dx - expected.dx,
                        actual.dy - expected.dy,
                        actual.laplacian - expected.laplacian,
                    ];
                    // The fractions of a place are rounded otherwise.
                    assert!(errors.iter().all(|error| error.abs() < 1e-11), "({x}, {y}) {n}: {errors:?}");
                });
            });
        }
    }

    #[test]
    fn near_a_pixel_the_first_order_is_exact_enough() {
        let coefficients = smooth_field(24, 17, 1);
        for (x, y) in [(0, 0), (5, 7), (23, 16), (23, 3)] {
            let on = near(&coefficients, x, y);
            let there = read(&coefficients, x as f64, y as f64);
            for (actual, expected) in
                [(on.value, there.value), (on.dx, there.dx), (on.dy, there.dy), (on.laplacian, there.laplacian)]
            {
                assert!((actual - expected).abs() < 1e-12, "({x}, {y}): {actual} {expected}");
            }
            // Second derivatives of up to 0.5 per squared pixel leave 0.5 · 0.02²/2.
            let actual = near(&coefficients, x, y).moved([0.02, -0.01]).value;
            let expected = read(&coefficients, x as f64 + 0.02, y as f64 - 0.01).value;
            assert!((actual - expected).abs() < 1e-4, "({x}, {y}): {actual} {expected}");
        }
    }

    #[test]
    fn mirror_reflects_about_the_border_pixels() {
        let expected = [1, 0, 1, 2, 1, 0, 1, 2, 1, 0];
        let actual: Vec<usize> = (-5..5).map(|i| mirror(i, 3)).collect();
        assert_eq!(actual, expected);
        assert_eq!(mirror(-7, 1), 0);
    }
}
