//! A difference in vignetting: a smooth gain field between the two photographs, found before they are solved.

use crate::around::resample::{Interleaved, Interpolation, in_rows, onto};
use crate::around::smooth_field::{Known, SmoothField, covers};
use crate::base::color::{self, LUMINANCE};
use crate::base::{Decode, Error, Frame, Homography, Mask, Method, Settings, centre};
use crate::engine::same_size;
use crate::engine::{Engine, Solver};

/// The photographs are made smaller, by averaging, while their shorter side stays at least so long, px.
const LEAST_SIDE: u32 = 256;
/// Cells that are compared, px of the smaller photographs: wider than any blur there.
const CELL: usize = 8;
/// Mean intensity, of white, below which a cell says nothing of a quotient.
const DARK: f64 = 0.02;
/// Most that the gain may differ from that in the middle: more is no vignetting, and a polynomial gone astray.
const MOST_GAIN: f64 = 4.0;
/// How far values are kept from where they would be clipped: a step of 8 bits.
const MARGIN: f32 = 4e-3;
/// Fewest cells that determine the field.
const LEAST_CELLS: usize = 50;

/// What I2 is to be multiplied by to shine as I1 does, but for a constant: a smooth field on the pixels of I1, 1 in the
/// middle.
///
/// Not the paper's, whose gain is one number: a lens vignettes differently at two focus settings, and what is darker
/// towards the corners is taken for motion or blur there.
#[derive(Clone, Debug)]
pub struct GainField {
    size: [u32; 2],
    /// Logarithm of the gain.
    field: SmoothField,
    transform: Homography,
    warnings: Vec<String>,
}

impl GainField {
    /// Registers and compares the photographs at a fraction of their size, without what is clipped or a mask of I1 leaves
    /// out.
    ///
    /// # Errors
    /// As [`Solver::solve`]; [`Error::Mismatch`] where they have too little in common, or are too dark, to compare.
    pub fn between(
        engine: &Engine,
        frames: [&Frame; 2],
        settings: &Settings,
        mask: Option<&Mask>,
    ) -> Result<Self, Error> {
        same_size(frames)?;
        let size = [frames[0].width(), frames[0].height()];
        let factor = (size[0].min(size[1]) / LEAST_SIDE).max(1);
        let small = frames.map(|frame| averaged(frame, settings.decode, factor as usize));
        let [a, b] = small.each_ref();
        let masks = [mask, None];
        let counting: [Frame; 2] = std::array::from_fn(|i| {
            let clipped = settings.clipped(frames[i].format().depth);
            averaged(&Mask::counting(frames[i], clipped, masks[i]), Decode::None, factor as usize)
        });
        let (small_transform, transform, warnings) =
            registered(engine, [a, b], settings, factor, size, Mask::of_picture(&counting[0]))?;
        let known = cells([a, b], [&counting[0], &counting[1]], &small_transform, factor);
        let problem = || {
            Error::Mismatch(format!(
                "the photographs can be compared in {} places only, too few or not all over the frame for a gain field: \
                 solve without --vignetting",
                known.len()
            ))
        };
        let enough = known.len() >= LEAST_CELLS && covers(size, &known);
        let field = SmoothField::fit(size, &known).filter(|_| enough).ok_or_else(problem)?;
        Ok(Self { size, field, transform, warnings })
    }

    /// The gain at a pixel of I1, 1 in the middle.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        self.field.above_centre(place).exp().clamp(1.0 / MOST_GAIN, MOST_GAIN)
    }

    /// What speaks against the registration that it was found by; a sentence each.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Least and greatest gain over I1.
    pub fn range(&self) -> [f64; 2] {
        let [width, height] = self.size.map(f64::from);
        let steps = || (0..=32).map(|i| f64::from(i) / 32.0);
        let all = steps().flat_map(|y| steps().map(move |x| [x * (width - 1.0), y * (height - 1.0)]));
        all.map(|place| self.at(place)).fold([f64::INFINITY, 0.0], |[low, high], g| [low.min(g), high.max(g)])
    }

    /// I2 without the difference, in its own format; clipped samples stay as they are.
    pub fn even_out(&self, i2: &Frame, settings: &Settings) -> Frame {
        let (back, middle) = (self.transform.inverse(), centre(self.size[0], self.size[1]));
        let channels = i2.format().channels.count() as usize;
        let [black, white] = settings.clipped(i2.format().depth);
        let stored = i2.intensities(Decode::None);
        let mut values = i2.intensities(settings.decode);
        let row = i2.width() as usize * channels;
        in_rows(&mut values, row, |y, values| {
            for (i, value) in values.iter_mut().enumerate() {
                let before = stored[y * row + i];
                let gain = self.at(back.apply([(i / channels) as f64, y as f64], middle)) as f32;
                let evened = match settings.decode {
                    Decode::None => *value * gain,
                    Decode::Srgb => color::stored(*value * gain, settings.decode),
                };
                // Just off the levels at which it would count as clipped.
                let is_clipped = before >= white || before <= black;
                *value = if is_clipped { before } else { evened.clamp(black + MARGIN, white - MARGIN) };
            }
        });
        i2.with_intensities(&values)
    }
}

/// Luminance, averaged over squares of so many pixels.
fn averaged(frame: &Frame, decode: Decode, factor: usize) -> Frame {
    let channels = frame.format().channels.count() as usize;
    let (width, height) = (frame.width() as usize / factor, frame.height() as usize / factor);
    let values = frame.intensities(decode);
    let luminance = |x: usize, y: usize| -> f32 {
        let pixel = &values[(y * frame.width() as usize + x) * channels..][..channels];
        if channels == 1 { pixel[0] } else { pixel.iter().zip(LUMINANCE).map(|(v, w)| v * w).sum() }
    };
    let mean = |i: usize| {
        let (x, y) = (i % width * factor, i / width * factor);
        let square = (0..factor * factor).map(|k| luminance(x + k % factor, y + k / factor));
        square.sum::<f32>() / (factor * factor) as f32
    };
    let mut means = vec![0.0; width * height];
    in_rows(&mut means, width, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, value)| *value = mean(y * width + x));
    });
    // Means of frames, which hold numbers of at most 1e6.
    Frame::gray(width as u32, height as u32, means).unwrap_or_else(|_| frame.clone())
}

/// T of the smaller photographs, and for full-size pixels; what speaks against it.
fn registered(
    engine: &Engine,
    [a, b]: [&Frame; 2],
    settings: &Settings,
    factor: u32,
    size: [u32; 2],
    mask: Mask,
) -> Result<(Homography, Homography, Vec<String>), Error> {
    let f = f64::from(factor);
    // The centre of the averaged photograph in full-size pixels: sides need not be multiples of the factor.
    let averaged_centre = centre(factor * a.width(), factor * a.height());
    let full_centre = centre(size[0], size[1]);
    let small = Settings {
        method: if settings.method == Method::Sift { Method::Unified } else { settings.method },
        levels: None,
        max_relative_blur: (settings.max_relative_blur / (f * f)).max(1.0),
        decode: Decode::None,
        black_level: None,
        white_level: None,
        start: settings.start.about(full_centre, averaged_centre).scaled(1.0 / f),
        ..settings.clone()
    };
    let mut solver = Solver::for_pair(engine, a, b, &small)?;
    solver.set_mask(Some(mask))?;
    let found = solver.register(a, b)?;
    Ok((found.transform, found.transform.scaled(f).about(averaged_centre, full_centre), found.warnings))
}

/// Logarithms of what I1 is over J, by cells all of whose pixels count, at places in full-size pixels.
fn cells([a, b]: [&Frame; 2], counting: [&Frame; 2], transform: &Homography, factor: u32) -> Vec<Known> {
    let (width, height) = (a.width() as usize, a.height() as usize);
    let moved = |frame: &Frame| {
        let values = frame.intensities(Decode::None);
        let image = Interleaved { width, height, channels: 1, values: &values };
        onto(&image, transform, [width, height], Interpolation::Linear)
    };
    let (j, second_counts) = (moved(b), moved(counting[1]));
    let [a, first_counts] = [a, counting[0]].map(|frame| frame.intensities(Decode::None));
    let brightest = a.iter().copied().fold(0.0f32, f32::max);
    let dark = DARK * f64::from(brightest);
    let mut known = Vec::new();
    for (y, x) in (0..height / CELL).flat_map(|y| (0..width / CELL).map(move |x| (y * CELL, x * CELL))) {
        let mean = |values: &[f32]| {
            let rows = values.chunks_exact(width).skip(y).take(CELL);
            rows.flat_map(|row| &row[x..x + CELL]).map(|&v| f64::from(v)).sum::<f64>() / (CELL * CELL) as f64
        };
        let (first, second) = (mean(&a), mean(&j));
        let all_count = mean(&first_counts).min(mean(&second_counts)) > 0.999;
        if first > dark && second > dark && all_count {
            let middle = |at: usize| f64::from(factor) * (at as f64 + CELL as f64 / 2.0) - 0.5;
            known.push(Known {
                place: [middle(x), middle(y)],
                value: (first / second).ln(),
                weight: first.min(second),
            });
        }
    }
    known
}
