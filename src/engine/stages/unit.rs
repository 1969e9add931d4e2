//! Chooses the unit of intensities, in which a solve computes, by samples of both photographs.
//!
//! The threshold η of the data term, the weight α of the smoothness and the bound of dark light are intensities that
//! suit photographs whose brightest parts are near 1. The same scene with less light, or 12 bits of a camera in samples
//! of 16, must give the same V. So all intensities are divided by the unit: the least power of two that at most a
//! thousandth of the pixels exceeds, as faulty ones do. A bright object on a dark ground usually covers more. White is 1,
//! and brighter floats are usually lamps or highlights: the unit is more than 1 only if a tenth of the pixels is.
//!
//! A power of two changes no digit of an intensity. A photograph that uses its range has the unit 1: it is as if there
//! were none.

use super::pass::{Memory, Pass};
use super::state::DoubleState;
use super::{Number, ingest};
use crate::base::{Decode, Format, Frame};
use crate::engine::shaders::unit::{ALONG_X, ALONG_Y, BEYOND_WHITE, BRIGHTER, DIMMEST, OCTAVES, PLACES, ROUNDING};
use crate::engine::vulkan::Variant;

pub use super::interface::unit::*;

impl Constants {
    /// The constants for photographs of a size and these formats.
    pub(crate) fn new([width, height]: [u32; 2], formats: [Format; 2], weights: [f32; 3]) -> Self {
        let (channels, bytes) = (formats.map(|f| f.channels.count()), formats.map(|f| f.depth.bytes()));
        Self { width, height, channels, bytes, weights }
    }
}

/// The variant that decodes the sRGB curve.
pub(crate) fn variant(decode: Decode) -> Variant {
    Variant::SRGB.when(decode == Decode::Srgb)
}

impl Pass for Bindings {
    /// Compulsory traffic: the samples of the places.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        u64::from(PLACES) * [0, 1].map(|n| u64::from(c.channels[n] * c.bytes[n])).iter().sum::<u64>()
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let decode = if variant.has(Variant::SRGB) { Decode::Srgb } else { Decode::None };
        let frames = [memory.photograph(self.first), memory.photograph(self.second)];
        let unit = cpu_reference(frames, decode, c.weights);
        let DoubleState { registration, unit: of_state, .. } = memory.state_mut(self.state);
        *of_state = unit;
        registration.offset /= unit;
    }
}

/// The unit of two photographs.
pub fn cpu_reference(frames: [&Frame; 2], decode: Decode, weights: [f32; 3]) -> f64 {
    let mut counts = [0_u32; OCTAVES as usize];
    for frame in frames {
        for n in 0..PLACES {
            let scaled = |along: u32, side: u32| ((u64::from(n.wrapping_mul(along)) * u64::from(side)) >> 32) as usize;
            let pixel = scaled(ALONG_Y, frame.height()) * frame.width() as usize + scaled(ALONG_X, frame.width());
            counts[octave(ingest::intensity(frame, pixel, decode, weights).abs())] += 1;
        }
    }
    let mut brighter = 0;
    let exceeds = |&n: &usize| {
        brighter += counts[n];
        let share = if n > DIMMEST as usize { BEYOND_WHITE } else { BRIGHTER };
        f64::from(brighter) > share * 2.0 * f64::from(PLACES)
    };
    let chosen = (1..counts.len()).rev().find(exceeds).unwrap_or(0);
    2_f64.powi(chosen as i32 - DIMMEST as i32)
}

/// The octave of a magnitude: the least power of two that it does not exceed, over the least unit.
fn octave(magnitude: f64) -> usize {
    let bits = (magnitude as f32).to_bits().saturating_sub(ROUNDING);
    ((bits >> 23) + DIMMEST).saturating_sub(126).min(OCTAVES - 1) as usize
}

#[cfg(test)]
mod tests {
    use super::super::harness::random;

    use super::*;
    use crate::base::color::LUMINANCE;

    /// The unit of a grey photograph, by the CPU reference.
    fn unit_of(width: u32, samples: Vec<f32>) -> f64 {
        let frame = Frame::gray(width, samples.len() as u32 / width, samples).unwrap();
        cpu_reference([&frame; 2], Decode::None, LUMINANCE)
    }

    #[test]
    fn it_is_the_octave_of_all_but_the_brightest_pixels() {
        let values = |brightest: f64| random(160 * 90, 3).into_iter().map(move |v| (brightest * v) as f32);
        for (brightest, unit) in
            [(1.0, 1.0), (0.7, 1.0), (0.3, 0.5), (3.0, 4.0), (65535.0, 65536.0), (1e-3, 1.0 / 512.0)]
        {
            assert_eq!(unit_of(160, values(brightest).collect()), unit, "{brightest}");
            // Of a photograph that uses its range, a twentieth may be lamps, of others half a thousandth.
            let every = if brightest >= 0.7 { 20 } else { 2000 };
            let lamps = values(brightest).enumerate().map(|(n, v)| if n % every == 0 { 1e5 } else { v });
            assert_eq!(unit_of(160, lamps.collect()), unit, "{brightest} with lamps");
        }
        assert_eq!(unit_of(64, vec![1.0; 4096]), 1.0, "white, but for rounding");
        assert_eq!(unit_of(64, vec![0.0; 4096]), 2_f64.powi(-20), "black");
        assert_eq!(unit_of(64, vec![-0.6; 4096]), 1.0, "magnitudes");
    }

    /// The places fill the frame, so that a corner counts by its area.
    #[test]
    fn a_bright_corner_sets_the_unit_if_it_is_large_enough() {
        let side = 256;
        let bright = |share: f64| {
            let edge = (share.sqrt() * f64::from(side)) as u32;
            (0..side * side).map(|n| if n % side < edge && n / side < edge { 0.9 } else { 0.01 }).collect::<Vec<f32>>()
        };
        assert_eq!(unit_of(side, bright(0.002)), 1.0);
        assert_eq!(unit_of(side, bright(0.0005)), 1.0 / 64.0);
    }
}
