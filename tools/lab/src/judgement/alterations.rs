//! Changes of generated photographs: most of them break the model.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use parfocal::{
    Error, Frame, Region,
    frame::{Channels, Samples},
    internals::{Random, linear_to_srgb},
};

use crate::errors::BORDER;
use crate::pairs::intensities as values;

/// Distance from the border of an altered part from which its pixels are judged, px. Nearer ones see both sides.
pub(crate) const DEEP: u32 = BORDER as u32;

fn size(frame: &Frame) -> [usize; 2] {
    [frame.width() as usize, frame.height() as usize]
}

/// The frame with the value that `at` computes from all values, x and y.
fn altered(frame: &Frame, at: impl Fn(&[f32], usize, usize) -> f32) -> Frame {
    let (values, [width, _]) = (values(frame), size(frame));
    gray(frame, (0..values.len()).map(|i| at(&values, i % width, i / width)).collect())
}

/// A grey frame of the size of another.
fn gray(frame: &Frame, values: Vec<f32>) -> Frame {
    Frame::gray(frame.width(), frame.height(), values).expect("a value for each pixel")
}

pub(crate) fn mirrored(frame: &Frame) -> Frame {
    let [width, _] = size(frame);
    altered(frame, |values, x, y| values[y * width + width - 1 - x])
}

/// The frame rotated by 180 degrees.
pub(crate) fn rotated(frame: &Frame) -> Frame {
    let [width, _] = size(frame);
    altered(frame, |values, x, y| values[values.len() - 1 - (y * width + x)])
}

/// A frame of one intensity.
pub(crate) fn blank(frame: &Frame, intensity: f32) -> Frame {
    altered(frame, |_, _, _| intensity)
}

/// The frame with Gaussian noise of a standard deviation, white = 1.
pub(crate) fn noisy(frame: &Frame, noise: f64, seed: u64) -> Frame {
    const STREAM: u64 = 100;
    let mut random = Random::new(seed, STREAM);
    gray(frame, values(frame).into_iter().map(|v| v + (noise * random.normal()) as f32).collect())
}

/// The frame with a part of another.
pub(crate) fn composed(frame: &Frame, other: &Frame, part: Region) -> Frame {
    let (other, [width, _]) = (values(other), size(frame));
    let contains = |from: u32, length: u32, at: usize| (from as usize..(from + length) as usize).contains(&at);
    altered(frame, |values, x, y| {
        let inside = contains(part.x, part.width, x) && contains(part.y, part.height, y);
        if inside { other[y * width + x] } else { values[y * width + x] }
    })
}

/// The sum of the deviations of two frames from ½, weighted.
pub(crate) fn mixed(frame: &Frame, other: &Frame, weights: [f32; 2]) -> Frame {
    let (other, [width, _]) = (values(other), size(frame));
    altered(frame, |values, x, y| {
        let i = y * width + x;
        0.5 + weights[0] * (values[i] - 0.5) + weights[1] * (other[i] - 0.5)
    })
}

/// Multiplies the intensities by a function of x and y, both from 0 to 1, and adds an offset.
pub(crate) fn exposed(frame: &Frame, gain: impl Fn(f64, f64) -> f64, offset: f32) -> Frame {
    let [width, height] = size(frame);
    let share = |at: usize, length: usize| at as f64 / (length - 1) as f64;
    altered(frame, |values, x, y| values[y * width + x] * gain(share(x, width), share(y, height)) as f32 + offset)
}

/// The frame with a value computed from the pixels at most `reach` px away along x and y. The border is repeated.
fn filtered(frame: &Frame, reach: [usize; 2], of: impl Fn(&mut [f32]) -> f32) -> Frame {
    let [width, height] = size(frame);
    let around = |at: usize, reach: usize, length: usize| {
        (0..=2 * reach).map(move |n| (at + n).saturating_sub(reach).min(length - 1))
    };
    altered(frame, |values, x, y| {
        let rows = around(y, reach[1], height);
        let near = rows.flat_map(|y| around(x, reach[0], width).map(move |x| values[y * width + x]));
        of(&mut near.collect::<Vec<f32>>())
    })
}

/// The median of 3 x 3 px, as cameras denoise.
pub(crate) fn denoised(frame: &Frame) -> Frame {
    filtered(frame, [1, 1], |near| {
        near.sort_by(f32::total_cmp);
        near[near.len() / 2]
    })
}

/// Adds the difference from the binomial mean of 3 x 3 px, times an amount: the unsharp mask of cameras.
pub(crate) fn sharpened(frame: &Frame, amount: f32) -> Frame {
    const WEIGHTS: [f32; 9] = [1.0, 2.0, 1.0, 2.0, 4.0, 2.0, 1.0, 2.0, 1.0];
    filtered(frame, [1, 1], |near| {
        let mean = near.iter().zip(WEIGHTS).map(|(value, weight)| value * weight).sum::<f32>() / 16.0;
        near[4] + amount * (near[4] - mean)
    })
}

/// The frame of a camera that moved along a row during the exposure, by `2 reach + 1` px.
pub(crate) fn shaken(frame: &Frame, reach: usize) -> Frame {
    filtered(frame, [reach, 0], |near| near.iter().sum::<f32>() / near.len() as f32)
}

/// The intensity that a share of the pixels does not exceed.
pub(crate) fn quantile(frame: &Frame, share: f64) -> f32 {
    let mut values = values(frame);
    values.sort_by(f32::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

/// The frame as 16-bit samples, clipped to 0 to 1.
pub(crate) fn in_16_bits(frame: &Frame) -> Result<Frame, Error> {
    let samples = values(frame).into_iter().map(|v| (v * 65535.0).round().clamp(0.0, 65535.0) as u16).collect();
    encoded(frame, Samples::U16(samples))
}

/// The frame as 8-bit samples by the sRGB curve, clipped to 0 to 1.
pub(crate) fn in_8_bits(frame: &Frame) -> Result<Frame, Error> {
    let samples =
        values(frame).into_iter().map(|v| (linear_to_srgb(v.clamp(0.0, 1.0)) * 255.0).round() as u8).collect();
    encoded(frame, Samples::U8(samples))
}

fn encoded(frame: &Frame, samples: Samples) -> Result<Frame, Error> {
    Frame::new(frame.width(), frame.height(), Channels::Gray, samples).map_err(Error::Mismatch)
}

/// The frame after compression as JPEG with a quality of 1 to 100, in 8 bits.
pub(crate) fn compressed(frame: &Frame, quality: u8) -> Result<Frame, Error> {
    let (frame, mut bytes) = (in_8_bits(frame)?, Vec::new());
    let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    let written = encoder.write_image(frame.bytes(), frame.width(), frame.height(), ExtendedColorType::L8);
    let read = written.and_then(|()| image::load_from_memory(&bytes));
    encoded(&frame, Samples::U8(read.map_err(|e| Error::Mismatch(e.to_string()))?.into_luma8().into_raw()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::{internals::brightened, settings::Decode, transform::Brightness};

    fn frame(values: &[f32]) -> Frame {
        Frame::gray(4, 4, values.to_vec()).unwrap()
    }

    fn ramp() -> Frame {
        frame(&(0..16u8).map(|i| f32::from(i) / 16.0).collect::<Vec<f32>>())
    }

    #[test]
    fn positions_change_as_the_names_say() {
        let (m, r) = (values(&mirrored(&ramp())), values(&rotated(&ramp())));
        assert_eq!((m[0], m[7], r[0], r[15]), (3.0 / 16.0, 4.0 / 16.0, 15.0 / 16.0, 0.0));
        let part = Region { x: 2, y: 1, width: 2, height: 2 };
        let both = values(&composed(&ramp(), &blank(&ramp(), 2.0), part));
        let replaced: Vec<usize> = (0..16).filter(|i| both[*i] == 2.0).collect();
        assert_eq!(replaced, [6, 7, 10, 11]);
    }

    #[test]
    fn a_filter_keeps_a_constant_and_a_ramp_inside() {
        for filter in [denoised, |f: &Frame| sharpened(f, 1.0), |f: &Frame| shaken(f, 1)] {
            assert!(values(&filter(&blank(&ramp(), 0.25))).iter().all(|v| (v - 0.25).abs() < 1e-6));
            let (before, after) = (values(&ramp()), values(&filter(&ramp())));
            assert!([5, 6, 9, 10].iter().all(|i| (before[*i] - after[*i]).abs() < 1e-6), "{after:?}");
        }
        let mut point = [0.0; 16];
        point[5] = 1.0;
        let at = |f: Frame| values(&f)[5];
        let found = [denoised(&frame(&point)), sharpened(&frame(&point), 1.0), shaken(&frame(&point), 1)].map(at);
        assert!(found.iter().zip([0.0, 1.75, 1.0 / 3.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn stored_values_are_clipped_rounded_and_compressed() {
        let bright = exposed(&ramp(), |_, _| 2.0, 0.0);
        assert_eq!(values(&in_16_bits(&bright).unwrap())[15], 1.0);
        let stored = in_8_bits(&ramp()).unwrap();
        let back = brightened(&stored, &Brightness::identity([4, 4]), Decode::Srgb);
        assert!(back.iter().zip(values(&ramp())).all(|(a, b)| (a - b).abs() < 0.004), "{back:?}");
        let [coarse, fine] = [10, 100].map(|quality| compressed(&ramp(), quality).unwrap());
        let error = |f: &Frame| values(f).iter().zip(values(&stored)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error(&fine) < 0.02 && error(&coarse) > error(&fine), "{} {}", error(&fine), error(&coarse));
        assert_eq!(quantile(&ramp(), 0.5), 7.0 / 16.0);
    }
}
