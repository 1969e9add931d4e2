//! The all-in-focus image: each pixel from the frames focused nearest to where it is sharp.

use crate::around::resample::{Interleaved, brightened, in_rows, onto};
use crate::base::{Brightness, Channels, Decode, Frame, Homography};

/// Where the frames of a sweep lie.
pub(super) struct Placed<'a> {
    pub(super) transforms: &'a [Homography],
    pub(super) brightness: &'a [Brightness],
    pub(super) positions: &'a [f64],
}

/// Settings, in mean steps, at which a frame has lost half of its say: the frame before and after mix where a pixel is sharp
/// between them, others hardly take part.
const REACH: f64 = 0.3;

/// Interleaved values with the reference's white at 1; where no focus is known the reference itself.
pub(super) fn fuse(
    frames: &[Frame],
    placed: &Placed<'_>,
    reference: usize,
    focus: &[f32],
    decode: Decode,
) -> (Vec<f32>, Channels) {
    let channels = frames[reference].format().channels;
    let count = channels.count() as usize;
    let size = [frames[0].width() as usize, frames[0].height() as usize];
    let step = (placed.positions[placed.positions.len() - 1] - placed.positions[0]).abs()
        / (placed.positions.len() - 1) as f64;
    let mut sums = vec![[0.0f32; 4]; size[0] * size[1]];
    for (n, frame) in frames.iter().enumerate() {
        let values = brightened(frame, &placed.brightness[n], decode);
        let image = Interleaved { width: size[0], height: size[1], channels: count, values: &values };
        let moved = onto(&image, &placed.transforms[n], size);
        in_rows(&mut sums, size[0], |y, row| {
            for (x, sum) in row.iter_mut().enumerate() {
                let i = y * size[0] + x;
                let u = f64::from(focus[i]);
                let away = (placed.positions[n] - u) / (REACH * step);
                let weight = if u.is_nan() { f64::from(u8::from(n == reference)) } else { 1.0 / (1.0 + away.powi(4)) };
                let pixel = &moved[i * count..][..count];
                if pixel[0].is_nan() {
                    continue;
                }
                for (sum, &value) in sum.iter_mut().zip(pixel) {
                    *sum += (weight * f64::from(value)) as f32;
                }
                sum[3] += weight as f32;
            }
        });
    }
    let fused = sums.iter().flat_map(|sum| (0..count).map(move |c| if sum[3] > 0.0 { sum[c] / sum[3] } else { 0.0 }));
    (fused.collect(), channels)
}
