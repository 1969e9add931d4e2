//! `labels.png`: which photograph is the sharper at each pixel.

use png::ColorType;

use super::Extra;
use super::meaning::Meaning;
use super::picture::{self, Stored};
use crate::engine::Solution;

const NAME: &str = "labels.png";

const MEANING: Meaning = Meaning::new(
    "label",
    "Sharper photograph: 0 not valid; 1 the first; 2 the second; 3 undecided, the relative blur V is within one standard \
     deviation of 0: both alike, or nothing to tell by",
);

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
        let mut encoder = picture::encoder(writer, (solution.width, solution.height), &MEANING)?;
        encoder.set_palette(COLORS.iter().flat_map(|c| &c[..3]).copied().collect::<Vec<u8>>());
        encoder.set_trns(COLORS.map(|c| c[3]).to_vec());
        picture::finish(encoder, ColorType::Indexed, &Stored::Bytes(&bytes))
    })
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
}
