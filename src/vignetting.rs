//! A difference in vignetting: a smooth gain field between the two photographs, found before they are solved.

use crate::resample::{Grid, Interpolation, in_rows, onto};
use crate::smooth_field::{Known, SmoothField};
use crate::stages::ingest::LUMINANCE;
use crate::{Decode, Engine, Error, Frame, Method, Settings, Similarity, Solver, centre};

/// The photographs are made smaller, by averaging, while their shorter side stays at least so long, px.
const LEAST_SIDE: u32 = 256;
/// Cells that are compared, px of the smaller photographs: wider than any blur there.
const CELL: usize = 8;
/// Mean intensity below which a cell says nothing of a quotient.
const DARK: f64 = 0.02;
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
    transform: Similarity,
}

impl GainField {
    /// Registers and compares the photographs at a fraction of their size.
    ///
    /// # Errors
    /// As [`Solver::solve`]; [`Error::Mismatch`] where they have too little in common, or are too dark, to compare.
    pub fn between(engine: &Engine, frames: [&Frame; 2], settings: &Settings) -> Result<Self, Error> {
        crate::solver::same_size(frames)?;
        let size = [frames[0].width(), frames[0].height()];
        let factor = (size[0].min(size[1]) / LEAST_SIDE).max(1);
        let small = frames.map(|frame| averaged(frame, settings.decode, factor as usize));
        let [a, b] = small.each_ref();
        let transform = registered(engine, [a, b], settings, factor, size)?;
        let known = cells([a, b], &transform.0, factor);
        let problem = || {
            Error::Mismatch(format!(
                "the photographs agree in {} places only, too few for a gain field: solve without --vignetting",
                known.len()
            ))
        };
        let field = SmoothField::fit(size, &known).filter(|_| known.len() >= LEAST_CELLS).ok_or_else(problem)?;
        Ok(Self { size, field, transform: transform.1 })
    }

    /// The gain at a pixel of I1, 1 in the middle.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        self.field.above_centre(place).exp()
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
        let [_, white] = settings.clipped(i2.format().depth);
        let stored = i2.intensities(Decode::None);
        let mut values = i2.intensities(settings.decode);
        let row = i2.width() as usize * channels;
        in_rows(&mut values, row, |y, values| {
            for (i, value) in values.iter_mut().enumerate() {
                let before = stored[y * row + i];
                let gain = self.at(back.apply([(i / channels) as f64, y as f64], middle)) as f32;
                let evened = match settings.decode {
                    Decode::None => *value * gain,
                    Decode::Srgb => crate::export::stored(*value * gain, settings.decode),
                };
                // Just below the level at which it would count as clipped.
                *value = if before >= white { before } else { evened.min(white - 1e-3) };
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

/// T of the smaller photographs, and for full-size pixels.
fn registered(
    engine: &Engine,
    [a, b]: [&Frame; 2],
    settings: &Settings,
    factor: u32,
    size: [u32; 2],
) -> Result<(Similarity, Similarity), Error> {
    let f = f64::from(factor);
    // The centre of the averaged photograph in full-size pixels: sides need not be multiples of the factor.
    let averaged_centre = centre(factor * a.width(), factor * a.height());
    let full_centre = centre(size[0], size[1]);
    let scaled = |t: Similarity, by: f64| Similarity { tx: t.tx * by, ty: t.ty * by, ..t };
    let small = Settings {
        method: if settings.method == Method::Sift { Method::Unified } else { settings.method },
        levels: None,
        max_relative_blur: (settings.max_relative_blur / (f * f)).max(1.0),
        decode: Decode::None,
        black_level: None,
        white_level: None,
        start: scaled(settings.start.about(full_centre, averaged_centre), 1.0 / f),
        ..settings.clone()
    };
    let found = Solver::for_pair(engine, a, b, &small)?.register(a, b)?.transform;
    Ok((found, scaled(found, f).about(averaged_centre, full_centre)))
}

/// Logarithms of what I1 is over J, by cells, at places in full-size pixels.
fn cells([a, b]: [&Frame; 2], transform: &Similarity, factor: u32) -> Vec<Known> {
    let (width, height) = (a.width() as usize, a.height() as usize);
    let [a, b] = [a, b].map(|frame| frame.intensities(Decode::None));
    let grid = Grid { width, height, channels: 1, values: &b };
    let j = onto(&grid, transform, [width, height], Interpolation::Linear);
    let mut known = Vec::new();
    for (y, x) in (0..height / CELL).flat_map(|y| (0..width / CELL).map(move |x| (y * CELL, x * CELL))) {
        let mean = |values: &[f32]| {
            let rows = values.chunks_exact(width).skip(y).take(CELL);
            rows.flat_map(|row| &row[x..x + CELL]).map(|&v| f64::from(v)).sum::<f64>() / (CELL * CELL) as f64
        };
        let (first, second) = (mean(&a), mean(&j));
        if first > DARK && second > DARK {
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
