//! Photographs in 8 bits, for display.

use image::{Rgb, RgbImage};

use crate::base::{Channels, Frame, Samples};

/// Converts a photograph to 8-bit RGB.
pub(crate) fn photograph(frame: &Frame) -> RgbImage {
    let bytes: Vec<u8> = match frame.samples() {
        Samples::U8(s) => s.clone(),
        Samples::U16(s) => s.iter().map(|&v| (v >> 8) as u8).collect(),
        Samples::F32(s) => s.iter().map(|&v| byte(v)).collect(),
    };
    let count = frame.format().channels.count() as usize;
    let mut pixels = bytes.chunks_exact(count);
    RgbImage::from_fn(frame.width(), frame.height(), |_, _| match (frame.format().channels, pixels.next()) {
        (Channels::Rgb, Some(&[r, g, b])) => Rgb([r, g, b]),
        (_, Some(&[v, ..])) => Rgb([v; 3]),
        _ => Rgb([0; 3]),
    })
}

/// Converts a value to 8 bits, white at 1.
pub(crate) fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_any_depth_become_eight_bits() {
        let gray = Frame::gray(2, 1, vec![-1.0, 0.5]).unwrap();
        assert_eq!(photograph(&gray).into_raw(), [0, 0, 0, 128, 128, 128]);
        let deep = Frame::new(1, 1, Channels::Rgb, Samples::U16(vec![0, 0x8000, 0xffff])).unwrap();
        assert_eq!(photograph(&deep).into_raw(), [0, 128, 255]);
    }
}
