//! Converts samples of a photograph to one channel: Rec. 601 luminance in [units](super::unit), or one of the colors as
//! stored. Measures white, the largest magnitude of both photographs, where blur stacks are packed.

use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels};
use crate::base::{Decode, Frame, Samples};
use crate::engine::vulkan::Variant;

pub use super::interface::ingest::*;

/// The variant that decodes the sRGB curve, that raises white to the largest magnitude, and whose results are in units.
pub(crate) fn variant([decodes, measures, in_units]: [bool; 3]) -> Variant {
    Variant::SRGB.when(decodes) | Variant::MEASURES.when(measures) | Variant::IN_UNITS.when(in_units)
}

impl Pass for Bindings {
    /// Compulsory traffic: every sample read, every pixel written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        u64::from(c.channels * c.bytes + 4) * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let decode = if variant.has(Variant::SRGB) { Decode::Srgb } else { Decode::None };
        let reused = memory.take_layer(self.image, 0);
        let unit = if variant.has(Variant::IN_UNITS) { memory.state(self.state).unit } else { 1.0 };
        let image = in_units(reused, memory.photograph(self.samples), decode, c.weights, unit);
        if variant.has(Variant::MEASURES) {
            let white = &mut memory.state_mut(self.state).white;
            *white = image.data.iter().fold(*white, |most, &value| most.max(value.into().abs()));
        }
        memory.set_layer(self.image, 0, image);
    }
}

/// Sample i as stored; white of integers is 1. The CPU reference of `glsl/include/samples.glsl`.
pub fn stored(frame: &Frame, i: usize) -> f64 {
    match frame.samples() {
        Samples::U8(s) => f64::from(s[i]) / 255.0,
        Samples::U16(s) => f64::from(s[i]) / 65535.0,
        Samples::F32(s) => f64::from(s[i]),
    }
}

/// The weighted sum of a pixel's channels.
pub(super) fn intensity(frame: &Frame, pixel: usize, decode: Decode, weights: [f32; 3]) -> f64 {
    let channels = frame.format().channels.count() as usize;
    let channel = |c: usize| decode.intensity(stored(frame, pixel * channels + c));
    if channels == 1 { channel(0) } else { weights.iter().enumerate().map(|(c, &w)| f64::from(w) * channel(c)).sum() }
}

/// The weighted sums of a frame's channels.
pub fn cpu_reference<N: Number>(frame: &Frame, decode: Decode, weights: [f32; 3]) -> Raster<N> {
    in_units(Raster::default(), frame, decode, weights, 1.0)
}

/// The same in units, in the memory of a raster.
pub(crate) fn in_units<N: Number>(
    reused: Raster<N>,
    frame: &Frame,
    decode: Decode,
    weights: [f32; 3],
    unit: f64,
) -> Raster<N> {
    let scaled = |stored: f64| decode.intensity(stored) / unit;
    let (channels, width) = (frame.format().channels.count() as usize, frame.width() as usize);
    // A table for each channel saves the power of the curve and the products.
    let table = |weight: f64| -> [f64; 256] { std::array::from_fn(|v| weight * scaled(v as f64 / 255.0)) };
    let tables: Vec<_> = if channels == 1 { vec![table(1.0)] } else { weights.map(|w| table(w.into())).to_vec() };
    let mut image = reused.of_size([width, frame.height() as usize]);
    image.fill_rows(|y, row| {
        let first = y * width * channels;
        match (frame.samples(), &tables[..]) {
            (Samples::U8(s), [table]) => each(row, s[first..].iter().map(|&v| table[usize::from(v)])),
            (Samples::U8(s), [red, green, blue]) => {
                let sum = |v: &[u8]| red[usize::from(v[0])] + green[usize::from(v[1])] + blue[usize::from(v[2])];
                each(row, s[first..].chunks_exact(3).map(sum));
            }
            (Samples::U16(s), [_]) => each(row, s[first..].iter().map(|&v| scaled(f64::from(v) / 65535.0))),
            (Samples::F32(s), [_]) => each(row, s[first..].iter().map(|&v| scaled(v.into()))),
            _ => each(row, (y * width..).map(|pixel| intensity(frame, pixel, decode, weights) / unit)),
        }
    });
    image
}

fn each<N: Number>(row: &mut [N], values: impl Iterator<Item = f64>) {
    row.iter_mut().zip(values).for_each(|(to, value)| *to = N::of(value));
}
