//! Whether the lens focuses red, green and blue at one setting, by the contrast of each channel. Section 11 of
//! `docs/method.md`.

use super::contrast::peak;
use crate::base::statistics::{deviation, median};
use crate::base::{Decode, Frame, Homography, Region, centre, workers};
use crate::engine::channels::{ColorShift, FEWEST};
use crate::engine::stages::separable::smoothed;
use crate::engine::stages::{Field, ingest};

/// The side of a window, px, and the most windows along an axis.
const SIDE: u32 = 40;
const MOST: u32 = 12;
/// σ of the Gaussians whose difference is compared, px: coarser than the pattern of a sensor's colours and than the
/// halved chroma of JPEG.
const BAND: [f64; 2] = [1.2, 2.4];
/// How much more power the sharpest frame of a window must have than the blurriest: less is noise.
const CLEAR: f64 = 3.0;
/// A frame counts if it has more than this share of the power of the sharpest one. Frames with less show mostly noise, of
/// which the channels have different amounts.
const COUNTS: f64 = 0.2;
/// The standard error of a median over that of a mean, of Gaussian values.
const MEDIAN_ERROR: f64 = 1.2533;

/// By how much u differs between the channels of frames with these transforms and settings; `None` of grey frames and of few
/// windows that show it. `least`: the standard deviation of u, below which a shift does not count.
pub(super) fn shift(
    frames: &[Frame],
    transforms: &[Homography],
    settings: &[f64],
    decode: Decode,
    least: f64,
) -> Option<ColorShift> {
    if frames[0].format().channels.count() < 3 {
        return None;
    }
    let size = [frames[0].width(), frames[0].height()];
    let middle = centre(size[0], size[1]);
    let counts @ [columns, rows] = size.map(|length| (length / SIDE).min(MOST));
    let shifts = workers::map((columns * rows) as usize, |n| {
        let window = [n as u32 % columns, n as u32 / columns];
        let place = [0, 1].map(|c| f64::from((2 * window[c] + 1) * size[c] / (2 * counts[c])));
        let powers: Option<Vec<[f64; 3]>> = frames
            .iter()
            .zip(transforms)
            .map(|(frame, transform)| {
                let [x, y] = transform.apply(place, middle).map(|v| (v - 0.5 * f64::from(SIDE)).round());
                let region = Region { x: x.max(0.0) as u32, y: y.max(0.0) as u32, width: SIDE, height: SIDE };
                powers(&frame.cropped(region).ok().filter(|_| x >= 0.0 && y >= 0.0)?, decode)
            })
            .collect();
        let powers = powers?;
        let [red, green, blue] = [0, 1, 2].map(|c| {
            let powers: Vec<f64> = powers.iter().map(|channels| channels[c]).collect();
            focus(&powers, settings)
        });
        let green = green?;
        Some([red? - green, blue? - green])
    });
    let shifts: Vec<[f64; 2]> = shifts.into_iter().flatten().collect();
    if shifts.len() < FEWEST {
        return None;
    }
    let of = |n: usize| {
        let found = median(shifts.iter().map(|shift| shift[n])).unwrap_or(0.0);
        let scatter = deviation(&shifts.iter().map(|shift| shift[n] - found).collect::<Vec<_>>());
        [found, MEDIAN_ERROR * scatter / (shifts.len() as f64).sqrt()]
    };
    let [red, blue] = [of(0), of(1)];
    Some(ColorShift::judged([red[0], blue[0]], [red[1], blue[1]], least))
}

/// The power of detail of each channel.
fn powers(window: &Frame, decode: Decode) -> Option<[f64; 3]> {
    let power = |c: usize| {
        let weights = std::array::from_fn(|n| if n == c { 1.0 } else { 0.0 });
        let channel: Field = ingest::cpu_reference(window, decode, weights);
        let [fine, coarse] = BAND.map(|sigma| smoothed(&channel, sigma));
        fine.data.iter().zip(&coarse.data).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
    };
    let powers = [0, 1, 2].map(power);
    powers.iter().all(|power| *power > 0.0).then_some(powers)
}

/// The setting of the most contrast, which must lie between two frames that count.
fn focus(powers: &[f64], settings: &[f64]) -> Option<f64> {
    let (most, least) = powers.iter().fold((0.0f64, f64::INFINITY), |(most, least), p| (most.max(*p), least.min(*p)));
    let counted = powers.iter().zip(settings).filter(|(power, _)| **power > COUNTS * most);
    let (near, at): (Vec<f64>, Vec<f64>) = counted.unzip();
    let is_inside = powers.first()? < &(0.5 * most) && powers.last()? < &(0.5 * most);
    (most > CLEAR * least && near.len() >= 3 && is_inside).then(|| peak(&near, &at).u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;
    use crate::base::{Channels, Samples};

    /// Frames of a texture at one depth, in focus at the setting 3 + shift of each channel.
    fn frames(shifts: [f64; 3], noise: f64) -> Vec<Frame> {
        let mut random = Random::new(3, 0);
        let (width, height) = (200, 160);
        let texture = Field { width, height, data: (0..width * height).map(|_| random.normal()).collect() };
        let frame = |k: usize| {
            let channels = shifts.map(|shift| smoothed(&texture, 0.8 + 0.5 * (k as f64 - 3.0 - shift).abs()));
            let at = |n: usize| (0.5 + 0.05 * channels[n % 3].data[n / 3] + noise * random.normal()) as f32;
            let samples = (0..3 * width * height).map(at).collect();
            Frame::new(width as u32, height as u32, Channels::Rgb, Samples::F32(samples)).unwrap()
        };
        (0..7).map(frame).collect()
    }

    #[test]
    fn channels_that_are_in_focus_at_other_settings_differ_by_it() {
        let (transforms, settings) = ([Homography::IDENTITY; 7], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let found = |shifts| shift(&frames(shifts, 0.002), &transforms, &settings, Decode::None, 0.05).unwrap();
        let apart = found([0.4, 0.0, -0.3]);
        assert!((apart.red - 0.4).abs() < 0.05 && (apart.blue + 0.3).abs() < 0.05, "{apart:?}");
        assert!((apart.included - 0.2).abs() < 0.05, "{apart:?}");
        let none = found([0.0; 3]);
        assert!(none.red.abs() < 0.05 && none.blue.abs() < 0.05 && none.included == 0.0, "{none:?}");
    }
}
