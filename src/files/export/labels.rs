//! Pictures of labels: the sharpest photograph of a pair, or the frame of a sweep, at each pixel.

use std::io::Write;

use png::ColorType;

use super::description::{self, Description};
use super::extra::Extra;
use super::png_file::{self, Pixels};
use super::{Nearer, Palette};
use crate::engine::Solution;

const NAME: &str = "labels.png";

/// Greatest number of frames of a sweep that `labels.png` can label. 0 means that the focus is not known.
pub const MOST_LABELS: usize = 255;

/// RGBA of the labels of a pair. Colour-blind viewers can tell orange and blue apart (Okabe and Ito 2008).
const COLORS: [[u8; 4]; 4] = [[0, 0, 0, 0], [230, 159, 0, 255], [0, 114, 178, 255], [210, 210, 210, 255]];

/// `labels.png` of a pair, indexed colour of 8 bits:
///
/// | value | meaning |
/// | --- | --- |
/// | 0 | V is not valid |
/// | 1 | I1 is sharper: V > σ |
/// | 2 | I2 is sharper: V < -σ |
/// | 3 | undecided, \|V\| ≤ σ |
///
/// with σ the standard deviation of V.
pub fn labels(solution: &Solution) -> Extra<'_> {
    Extra::new(NAME, |_, writer| {
        let values = solution.relative_blur.iter().zip(&solution.uncertainty);
        let bytes: Vec<u8> = values.map(|(&v, &sigma)| label(v, sigma)).collect();
        write(writer, (solution.width, solution.height), &bytes, &COLORS, &description::LABELS)
    })
}

/// `labels.png` of a sweep: the frame with its setting nearest to the pixel's focus, counted from 1; 0 where the focus
/// is not known. The colours run from the nearest to the farthest frame.
pub fn sweep_labels<'a>(palette: Palette) -> Extra<'a> {
    Extra::new(NAME, move |results, writer| {
        let (positions, nearer) = (results.positions(), results.report.nearer());
        let count = positions.len();
        if count > MOST_LABELS {
            return Err(format!("there are {count} frames, and 8 bits can label {MOST_LABELS}"));
        }
        let color = |n: usize| {
            let t = n as f64 / (count - 1).max(1) as f64;
            let [r, g, b] = palette.color(if nearer == Nearer::First { 1.0 - t } else { t });
            [r, g, b, 255]
        };
        let colors: Vec<[u8; 4]> = COLORS[..1].iter().copied().chain((0..count).map(color)).collect();
        let bytes: Vec<u8> = results.values().iter().map(|&u| nearest(u, &positions)).collect();
        write(writer, results.size(), &bytes, &colors, &description::SWEEP_LABELS)
    })
}

/// The number, from 1, of the position that is nearest to a setting; 0 for NaN.
fn nearest(u: f32, positions: &[f64]) -> u8 {
    let off = |n: &usize| (positions[*n] - f64::from(u)).abs();
    let next = (0..positions.len()).filter(|n| off(n).is_finite()).min_by(|a, b| off(a).total_cmp(&off(b)));
    next.map_or(0, |n| n as u8 + 1)
}

fn write(
    writer: &mut dyn Write,
    size: (u32, u32),
    labels: &[u8],
    colors: &[[u8; 4]],
    description: &Description,
) -> Result<(), String> {
    let mut encoder = png_file::encoder(writer, size, description)?;
    encoder.set_palette(colors.iter().flat_map(|c| &c[..3]).copied().collect::<Vec<u8>>());
    encoder.set_trns(colors.iter().map(|c| c[3]).collect::<Vec<u8>>());
    png_file::finish(encoder, ColorType::Indexed, &Pixels::Bytes(labels))
}

fn label(v: f32, sigma: f32) -> u8 {
    match v {
        v if v.is_nan() => 0,
        v if v > sigma => 1,
        v if v < -sigma => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_needs_more_than_a_standard_deviation() {
        let found = [(f32::NAN, f32::NAN), (2.0, 1.0), (-2.0, 1.0), (1.0, 1.0), (-0.5, 1.0), (100.0, 1000.0)];
        assert_eq!(found.map(|(v, sigma)| label(v, sigma)), [0, 1, 2, 3, 3, 3]);
    }

    #[test]
    fn a_pixel_of_a_sweep_has_the_label_of_the_nearest_frame() {
        let positions = [4.0, 3.0, 1.0];
        assert_eq!([9.0, 3.4, 2.1, 1.9, f32::NAN, f32::INFINITY].map(|u| nearest(u, &positions)), [1, 2, 2, 3, 0, 0]);
    }
}
