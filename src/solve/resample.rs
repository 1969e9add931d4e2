//! Resampling of photographs onto the pixels of another, by cubic B-splines.

use crate::base::color::{LUMINANCE, stored};
use crate::base::{Brightness, Channels, Decode, Frame, Homography, Region, centre, workers};
use crate::engine::filter;
use crate::engine::stages::separable::weigh;
use crate::engine::stages::spline::{self, mirror};

/// The cubic B-spline through the pixels of an image of one to three channels, mirrored about the border pixels.
pub(crate) struct Spline {
    size: [usize; 2],
    channels: usize,
    /// Interleaved, row-major.
    coefficients: Vec<f32>,
}

impl Spline {
    /// Makes the spline of interleaved values, row-major. The prefilter is truncated: the error is 2e-5 of the
    /// difference between neighbouring pixels.
    pub(crate) fn through(values: &[f32], size: [usize; 2], channels: usize) -> Self {
        let filter: Vec<f32> = filter::spline_prefilter().into_iter().map(|w| w as f32).collect();
        let coefficients = along_y(&along_x(values, size, channels, &filter), size, channels, &filter);
        Self { size, channels, coefficients }
    }

    /// Reads the channels at a position, px. Outside the centres of the border pixels it returns false and reads
    /// nothing.
    pub(crate) fn read(&self, [x, y]: [f64; 2], into: &mut [f32]) -> bool {
        let [width, height] = self.size;
        if !(x >= 0.0 && y >= 0.0 && x <= width as f64 - 1.0 && y <= height as f64 - 1.0) {
            return false;
        }
        let first = [x, y].map(|p| p as isize - 1);
        let [wx, wy] = [x, y].map(|p| spline::weights(p - p.floor())[0].map(|w| w as f32));
        let (columns, rows) = (four(first[0], width), four(first[1], height));
        // A constant number of channels keeps the sums in registers.
        match self.channels {
            1 => self.weigh::<1>([columns, rows], [wx, wy], into),
            2 => self.weigh::<2>([columns, rows], [wx, wy], into),
            _ => self.weigh::<3>([columns, rows], [wx, wy], into),
        }
        true
    }

    fn weigh<const CHANNELS: usize>(
        &self,
        [columns, rows]: [[usize; 4]; 2],
        [wx, wy]: [[f32; 4]; 2],
        into: &mut [f32],
    ) {
        let mut sums = [0.0f32; CHANNELS];
        for (y, wy) in rows.into_iter().zip(wy) {
            let row = &self.coefficients[y * self.size[0] * CHANNELS..][..self.size[0] * CHANNELS];
            for (x, wx) in columns.into_iter().zip(wx) {
                let pixel = &row[x * CHANNELS..][..CHANNELS];
                (0..CHANNELS).for_each(|c| sums[c] += wy * wx * pixel[c]);
            }
        }
        into.copy_from_slice(&sums);
    }
}

/// Four consecutive indices starting at `first`, mirrored at the borders.
fn four(first: isize, size: usize) -> [usize; 4] {
    if first >= 0 && first as usize + 3 < size {
        return std::array::from_fn(|i| first as usize + i);
    }
    std::array::from_fn(|i| mirror(first + i as isize, size))
}

fn along_x(values: &[f32], [width, _]: [usize; 2], channels: usize, filter: &[f32]) -> Vec<f32> {
    let (row, radius) = (width * channels, (filter.len() / 2) as isize);
    let mut filtered = vec![0.0; values.len()];
    in_rows(&mut filtered, row, |y, sums| {
        let own = &values[y * row..][..row];
        let pixel = |x: isize| own[mirror(x, width) * channels..][..channels].iter().copied();
        let (before, after) = ((-radius..0).flat_map(pixel), (width as isize..width as isize + radius).flat_map(pixel));
        let mirrored: Vec<f32> = before.chain(own.iter().copied()).chain(after).collect();
        let shifted: Vec<&[f32]> = (0..filter.len()).map(|n| &mirrored[n * channels..]).collect();
        weigh(sums, filter, &shifted);
    });
    filtered
}

fn along_y(values: &[f32], [width, height]: [usize; 2], channels: usize, filter: &[f32]) -> Vec<f32> {
    let (row, radius) = (width * channels, (filter.len() / 2) as isize);
    let mut filtered = vec![0.0; values.len()];
    in_rows(&mut filtered, row, |y, sums| {
        let from = |n: usize| &values[mirror(y as isize + n as isize - radius, height) * row..];
        weigh(sums, filter, &(0..filter.len()).map(from).collect::<Vec<_>>());
    });
    filtered
}

/// Resamples an image at the positions to which T maps the pixels of a reference of the same size; NaN outside.
pub fn onto(values: Vec<f32>, channels: usize, t: &Homography, size: [usize; 2]) -> Vec<f32> {
    // The identity returns the same bits.
    if *t == Homography::IDENTITY {
        return values;
    }
    let image = Spline::through(&values, size, channels);
    let mut moved = values;
    let middle = centre(size[0] as u32, size[1] as u32);
    in_rows(&mut moved, size[0] * channels, |y, row| {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            if !image.read(t.apply([x as f64, y as f64], middle), pixel) {
                pixel.fill(f32::NAN);
            }
        }
    });
    moved
}

/// Resamples a photograph onto the pixels of I1, which T maps to it, in its own format; black outside. Brightness is
/// applied to intensities, which `decode` defines.
pub fn registered(frame: &Frame, transform: &Homography, brightness: &Brightness, decode: Decode) -> Frame {
    let (width, height, channels) = (frame.width() as usize, frame.height() as usize, frame.format().channels);
    let decode = decode.resolved([frame.format().depth]);
    let values = brightened(frame, brightness, decode);
    let mut moved = onto(values, channels.count() as usize, transform, [width, height]);
    let value = |value: f32| match decode {
        _ if value.is_nan() => 0.0,
        Decode::Srgb => stored(value, decode),
        _ => value,
    };
    in_rows(&mut moved, width * channels.count() as usize, |_, row| row.iter_mut().for_each(|v| *v = value(*v)));
    frame.with_intensities(&moved)
}

/// The part of a reference that a smaller picture shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reduction {
    /// The part, px of the reference.
    pub(crate) part: Region,
    /// Width and height of the picture.
    pub(crate) size: [u32; 2],
    /// Pixels of the reference per pixel of the picture, rounded.
    pub(crate) step: usize,
}

/// Resamples a photograph as [`registered`] does, onto the pixels of a smaller picture of I1. Returns stored values,
/// white at 1, interleaved. It resamples the means of cells of `step` px, which takes a `step²`-th of the time.
pub(crate) fn registered_and_reduced(
    frame: &Frame,
    transform: &Homography,
    brightness: &Brightness,
    decode: Decode,
    Reduction { part, size, step }: Reduction,
) -> Vec<f32> {
    let channels = frame.format().channels.count() as usize;
    let decode = decode.resolved([frame.format().depth]);
    // The middle of a cell, px of the photograph.
    let middle = |cell: f64| step as f64 * cell + (step - 1) as f64 / 2.0;
    let (mut means, cells) = frame.mean_intensities(step, decode);
    in_rows(&mut means, cells[0] * channels, |y, row| {
        brightness.apply_along(row, channels, middle(y as f64), |x| middle(x as f64));
    });
    let image = Spline::through(&means, cells, channels);
    let place = |n: usize, first: u32, side: u32, count: u32| {
        f64::from(first) + (n as f64 + 0.5) * f64::from(side) / f64::from(count) - 0.5
    };
    let centre = centre(frame.width(), frame.height());
    let [width, height] = size.map(|side| side as usize);
    let mut picture = vec![0.0; width * height * channels];
    in_rows(&mut picture, width * channels, |y, row| {
        let y = place(y, part.y, part.height, size[1]);
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let at = transform.apply([place(x, part.x, part.width, size[0]), y], centre);
            let cell = at.map(|at| (at - middle(0.0)) / step as f64);
            // Outside of the photograph it stays black.
            image.read(cell, pixel);
            if decode == Decode::Srgb {
                pixel.iter_mut().for_each(|value| *value = stored(*value, decode));
            }
        }
    });
    picture
}

/// The intensities of a photograph with the brightness of another.
pub fn brightened(frame: &Frame, brightness: &Brightness, decode: Decode) -> Vec<f32> {
    let channels = frame.format().channels.count() as usize;
    let mut values = frame.intensities(decode);
    in_rows(&mut values, frame.width() as usize * channels, |y, row| brightness.apply_to_row(row, channels, y));
    values
}

/// Luminance of interleaved values; grey values are returned unchanged.
pub fn luminance(values: Vec<f32>, channels: Channels) -> Vec<f32> {
    /// Pixels of a thread at a time.
    const PIXELS: usize = 1 << 14;
    if channels == Channels::Gray {
        return values;
    }
    let mut luminance = vec![0.0; values.len() / 3];
    workers::for_each(luminance.chunks_mut(PIXELS).zip(values.chunks(3 * PIXELS)), |(luminance, values)| {
        for (sum, pixel) in luminance.iter_mut().zip(values.as_chunks::<3>().0) {
            *sum = pixel.iter().zip(LUMINANCE).map(|(value, weight)| value * weight).sum();
        }
    });
    luminance
}

/// Fills rows of `row` values each, in parallel.
pub(crate) fn in_rows<T: Send>(values: &mut [T], row: usize, fill: impl Fn(usize, &mut [T]) + Sync) {
    workers::for_each(values.chunks_exact_mut(row.max(1)).enumerate(), |(n, values)| fill(n, values));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Photometric, Similarity};

    #[test]
    fn fine_waves_keep_their_contrast_between_pixels() {
        // Half-way between pixels a cubic spline keeps 0.97 of a wave of 4 px; cubic convolution keeps 0.88.
        let [width, height] = [64usize, 20];
        let wave = |x: f64| 0.5 + 0.4 * (std::f64::consts::FRAC_PI_2 * x).sin();
        let values: Vec<f32> = (0..width * height).flat_map(|i| [wave((i % width) as f64) as f32, 0.25]).collect();
        let image = Spline::through(&values, [width, height], 2);
        let mut channels = [0.0; 2];
        for x in [20.0, 20.5, 31.25] {
            assert!(image.read([x, 9.3], &mut channels));
            let off = f64::from(channels[0]) - wave(x);
            assert!(off.abs() < 0.4 * 0.03 && (channels[1] - 0.25).abs() < 1e-5, "{x}: {off}");
        }
        assert!(!image.read([-0.1, 9.0], &mut channels) && !image.read([3.0, f64::NAN], &mut channels));
    }

    #[test]
    fn parabolas_and_planes_are_interpolated_under_a_similarity() {
        let (width, height) = (31, 23);
        let of = |x: f64, y: f64| 0.2 + 0.01 * x - 0.02 * y + 1e-3 * x * x;
        let values: Vec<f32> = (0..width * height).map(|i| of((i % width) as f64, (i / width) as f64) as f32).collect();
        let t = Homography::from(Similarity::new(1.3, -0.6, 2.0, 0.9));
        let found = onto(values.clone(), 1, &t, [width, height]);
        for (x, y) in [(8usize, 7usize), (15, 11), (20, 15)] {
            let [px, py] = t.apply([x as f64, y as f64], centre(31, 23));
            // The error from the mirrored border falls to 0.27⁷ at 7 px.
            assert!((f64::from(found[y * width + x]) - of(px, py)).abs() < 2e-5);
        }
        let away = onto(values, 1, &Similarity::new(100.0, 0.0, 0.0, 1.0).into(), [width, height]);
        assert!(away.iter().all(|v| v.is_nan()));
    }

    #[test]
    fn a_reduced_photograph_is_the_registered_one_reduced() {
        use crate::base::{Samples, Shading};
        let (width, height) = (121u32, 90u32);
        let wave = |x: f64, y: f64| 0.5 + 0.3 * (0.06 * x).sin() * (0.05 * y).cos();
        let byte = |i: u32, c: u32| (255.0 * wave(f64::from(i % width + 9 * c), f64::from(i / width))).round() as u8;
        let samples = (0..width * height).flat_map(|i| (0..3).map(move |c| byte(i, c))).collect();
        let frame = Frame::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap();
        let t = Homography::from(Similarity::new(2.3, -1.6, 1.0, 1.02));
        let mut shading = Shading::NONE;
        shading.coefficients[0] = 0.1;
        let photometric = Photometric { gain: 0.9, offset: 0.02 };
        let brightness = Brightness { photometric, shading, ..Brightness::identity([width, height]) };
        let part = Region { x: 10, y: 6, width: 100, height: 76 };
        for (decode, step) in [(Decode::Srgb, 2usize), (Decode::None, 4)] {
            let size = [part.width / step as u32, part.height / step as u32];
            let found = registered_and_reduced(&frame, &t, &brightness, decode, Reduction { part, size, step });
            let whole = registered(&frame, &t, &brightness, decode).cropped(part).unwrap();
            let whole = whole.intensities(Decode::None);
            for i in 0..size[0] as usize * size[1] as usize {
                let (x, y) = (step * (i % size[0] as usize), step * (i / size[0] as usize));
                let pixels = (y..y + step).flat_map(|y| (x..x + step).map(move |x| 3 * (y * part.width as usize + x)));
                let mean = pixels.map(|at| whole[at]).sum::<f32>() / (step * step) as f32;
                assert!((found[3 * i] - mean).abs() < 0.01, "{step}: pixel {i}: {} for {mean}", found[3 * i]);
            }
        }
        let away = Homography::from(Similarity::new(500.0, 0.0, 0.0, 1.0));
        let reduction = Reduction { part, size: [50, 38], step: 2 };
        let found = registered_and_reduced(&frame, &away, &brightness, Decode::Srgb, reduction);
        assert!(found.iter().all(|value| *value == 0.0), "outside it is black");
    }

    #[test]
    fn brightness_is_applied_to_intensities() {
        let exposed = |byte: u8, gain: f64, offset: f64, decode: Decode| {
            let frame = Frame::new(2, 2, crate::base::Channels::Gray, crate::base::Samples::U8(vec![byte; 4])).unwrap();
            let unchanged = Brightness::identity([2, 2]);
            let brightness = Brightness { photometric: Photometric { gain, offset }, ..unchanged };
            registered(&frame, &Homography::IDENTITY, &brightness, decode).bytes()[0]
        };
        assert_eq!(exposed(50, 2.0, 0.1, Decode::None), 126);
        assert_eq!(exposed(200, 2.0, 0.0, Decode::None), 255);
        // 188 is half the intensity of white.
        assert!(exposed(188, 0.5, 0.0, Decode::Srgb).abs_diff(137) <= 1);
        assert_eq!(exposed(77, 1.0, 0.0, Decode::Srgb), 77);
    }
}
