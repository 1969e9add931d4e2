//! `labels.png`: which photograph is the sharper, or the sharpest, at each pixel.

use std::io::Write;

use png::ColorType;

use super::meaning::Meaning;
use super::picture::{self, Stored};
use super::{Extra, Nearer, Palette};
use crate::base::Error;
use crate::engine::Solution;
use crate::solve::sweep::Sweep;

const NAME: &str = "labels.png";

const MEANING: Meaning = Meaning::new(
    "label",
    "Sharper photograph: 0 not valid; 1 the first; 2 the second; 3 undecided, the relative blur V is within one standard \
     deviation of 0: both alike, or nothing to tell by",
);

const SWEEP_MEANING: Meaning =
    Meaning::new("label", "The frame of the sweep that is focused next to each pixel, counted from 1; 0 not known");

/// The most frames that `labels.png` tells apart: a byte, but for 0.
pub const MOST_LABELS: usize = 255;

/// Of each label, RGB and opacity: orange and blue are told apart by every eye (Okabe and Ito 2008).
const COLORS: [[u8; 4]; 4] = [[0, 0, 0, 0], [230, 159, 0, 255], [0, 114, 178, 255], [210, 210, 210, 255]];

/// `labels.png`, indexed colour of 8 bits, whose values are
///
/// | value | meaning |
/// | --- | --- |
/// | 0 | V is not valid |
/// | 1 | I1 is the sharper: V > σ |
/// | 2 | I2 is the sharper: V < -σ |
/// | 3 | undecided, \|V\| ≤ σ: both are as sharp, or the images say nothing |
///
/// with σ the standard deviation of V.
pub fn labels(solution: &Solution) -> Extra<'_> {
    Extra::new(NAME, |writer| {
        let values = solution.relative_blur.iter().zip(&solution.uncertainty);
        let bytes: Vec<u8> = values.map(|(&v, &sigma)| label(v, sigma)).collect();
        write(writer, (solution.width, solution.height), &bytes, &COLORS, &MEANING)
    })
}

/// `labels.png` of a sweep: 0 where the focus is not known, else the frame that is focused next to it, counted from 1; in
/// colours from the nearest to the farthest.
///
/// # Errors
/// [`Error::Mismatch`]: more than 255 frames.
pub fn sweep_labels(sweep: &Sweep, nearer: Nearer, palette: Palette) -> Result<Extra<'_>, Error> {
    let frames = sweep.positions.len();
    if frames > MOST_LABELS {
        return Err(Error::Mismatch(format!("labels.png tells {MOST_LABELS} frames apart, and there are {frames}")));
    }
    let nearness = |n: usize| {
        let t = n as f64 / (frames - 1).max(1) as f64;
        if nearer == Nearer::First { 1.0 - t } else { t }
    };
    let of_frames = (0..frames).map(|n| {
        let [r, g, b] = palette.color(nearness(n));
        [r, g, b, 255]
    });
    let colors: Vec<[u8; 4]> = COLORS[..1].iter().copied().chain(of_frames).collect();
    Ok(Extra::new(NAME, move |writer| {
        let bytes: Vec<u8> = sweep.focus.iter().map(|&u| nearest(u, &sweep.positions)).collect();
        write(writer, (sweep.width, sweep.height), &bytes, &colors, &SWEEP_MEANING)
    }))
}

/// The number, from 1, of the position next to a setting; 0 for NaN.
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
    meaning: &Meaning,
) -> Result<(), String> {
    let mut encoder = picture::encoder(writer, size, meaning)?;
    encoder.set_palette(colors.iter().flat_map(|c| &c[..3]).copied().collect::<Vec<u8>>());
    encoder.set_trns(colors.iter().map(|c| c[3]).collect::<Vec<u8>>());
    picture::finish(encoder, ColorType::Indexed, &Stored::Bytes(labels))
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
    fn a_label_needs_more_than_a_deviation() {
        let found = [(f32::NAN, f32::NAN), (2.0, 1.0), (-2.0, 1.0), (1.0, 1.0), (-0.5, 1.0), (100.0, 1000.0)];
        assert_eq!(found.map(|(v, sigma)| label(v, sigma)), [0, 1, 2, 3, 3, 3]);
    }

    #[test]
    fn of_a_sweep_it_is_the_nearest_frame() {
        let positions = [4.0, 3.0, 1.0];
        assert_eq!([9.0, 3.4, 2.1, 1.9, f32::NAN, f32::INFINITY].map(|u| nearest(u, &positions)), [1, 2, 2, 3, 0, 0]);
    }
}
