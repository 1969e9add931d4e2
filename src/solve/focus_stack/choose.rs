//! Of which frame each pixel of the all-in-focus image is: the sharpest around it, as far as the depth that was found agrees.
//!
//! A mean of the frames about the focus would be as sharp only where the focus is known to a tenth of a step: on the heat sink it had 0.95 of
//! the sharpest frame's variance of the Laplacian in a third of the tiles of 32 px, one frame has it in more than 99 %.

use super::focused::Focused;
use super::laplacian::squared_laplacian;
use crate::base::{Homography, centre};
use crate::solve::resample::{in_rows, luminance};

/// Pixels of a cell along either side, of which one frame is chosen.
const CELL: usize = 2;
/// σ of the window over which sharpness is compared, cells.
const WINDOW: f32 = 1.5;
/// A deviation that the focus is at least taken for, steps: between two frames the sharper counts.
const LEAST_DEVIATION: f32 = 0.5;
/// The deviation that a focus is at most taken for: where nothing tells, frames beside the one that is filled in are as good.
const MOST_DEVIATION: f32 = 3.0;
/// A squared Laplacian that says nothing: that of rounding to 256 values; and so many times what the frame's smoothest fiftieth has, which
/// is noise. With once the noise, each of a flat region's cells is of the noisiest frame there, and the variance of its noise a third too large.
const GRAIN: f32 = 1.5e-5;
const NOISE: f32 = 4.0;
/// A cell is of a frame only if that shows so many pixels around it, those that frames share where they meet and what a spline reads; at the
/// border of the reference half a px less than the reference does.
const MARGIN: f64 = 3.0;

/// The frame of each cell.
pub(super) struct Chosen {
    frames: Vec<u16>,
    columns: usize,
    rows: usize,
}

impl Chosen {
    /// What frame n has of a pixel: how much of the cells around it are its own, linearly between their centres.
    pub(super) fn share(&self, [x, y]: [usize; 2], n: usize) -> f32 {
        // A quarter of a cell from its centre, towards the one beside.
        let beside = |x: usize, count: usize| {
            let own = x / CELL;
            [own, if x.is_multiple_of(CELL) { own.saturating_sub(1) } else { (own + 1).min(count - 1) }]
        };
        let ([x, next], [y, below]) = (beside(x, self.columns), beside(y, self.rows));
        let owns = |x: usize, y: usize| f32::from(u8::from(self.frames[y * self.columns + x] as usize == n));
        (9.0 * owns(x, y) + 3.0 * (owns(next, y) + owns(x, below)) + owns(next, below)) / 16.0
    }

    /// The frame of a pixel, that which has most of it.
    pub(super) fn frame(&self, [x, y]: [usize; 2]) -> u16 {
        self.frames[y / CELL * self.columns + x / CELL]
    }

    /// Whether any cell is of frame n.
    pub(super) fn has(&self, n: usize) -> bool {
        self.frames.iter().any(|frame| *frame as usize == n)
    }
}

/// The frame of the greatest `ln(e + g) - (p - u)²/2σ²` at each cell, e the mean squared Laplacian around, g what says nothing.
pub(super) fn choose(sweep: &Focused<'_>) -> Chosen {
    let [columns, rows] = cells(sweep.size());
    // A byte a pixel and frame.
    let energies: Vec<Energies> = (0..sweep.frames.len()).map(|n| Energies::of(sweep, n)).collect();
    let grain = GRAIN + NOISE * energies[sweep.reference].least();
    let mut frames = vec![0; columns * rows];
    in_rows(&mut frames, columns, |y, row| {
        for (x, frame) in row.iter_mut().enumerate() {
            *frame = best(sweep, &energies, grain, [x, y]);
        }
    });
    Chosen { frames, columns, rows }
}

/// The frame of a cell; the reference where none shows it.
fn best(sweep: &Focused<'_>, energies: &[Energies], grain: f32, [x, y]: [usize; 2]) -> u16 {
    let i = CELL * (y * sweep.size()[0] + x);
    let (u, told) = (sweep.found.focus[i], sweep.found.deviation[i]);
    // A comparison that NaN fails.
    let deviation = if told < MOST_DEVIATION { told.max(LEAST_DEVIATION) } else { MOST_DEVIATION };
    let mut best = (f32::NEG_INFINITY, sweep.reference as u16);
    for (n, energies) in energies.iter().enumerate() {
        let Some(energy) = energies.at([x, y]) else { continue };
        let away = if u.is_nan() { 0.0 } else { (sweep.positions[n] as f32 - u) / deviation };
        let score = (energy + grain).ln() - 0.5 * away * away;
        if score > best.0 {
            best = (score, n as u16);
        }
    }
    best.1
}

fn cells([width, height]: [usize; 2]) -> [usize; 2] {
    [width.div_ceil(CELL), height.div_ceil(CELL)]
}

/// The mean squared Laplacian around each cell of a frame, on its own pixels: brought onto the reference's it would be less sharp, and dearer.
struct Energies {
    values: Vec<f32>,
    size: [usize; 2],
    transform: Homography,
    /// Of a squared Laplacian, from the frame's pixels to the reference's.
    scale: f32,
}

impl Energies {
    fn of(sweep: &Focused<'_>, n: usize) -> Self {
        let (size, transform) = (sweep.size(), sweep.found.registration.transforms[n]);
        let values = luminance(sweep.values(n), sweep.channels());
        let values = smoothed(&in_cells(&squared_laplacian(&values, size), size), cells(size));
        Self { values, size, transform, scale: transform.scale().powi(4) as f32 }
    }

    /// What all but a fiftieth of the cells exceed.
    fn least(&self) -> f32 {
        let mut all = self.values.clone();
        *all.select_nth_unstable_by(self.values.len() / 50, f32::total_cmp).1
    }

    /// Around the place of a cell of the reference; `None` if that is not within the frame by the margin.
    fn at(&self, cell: [usize; 2]) -> Option<f32> {
        let middle = centre(self.size[0] as u32, self.size[1] as u32);
        let to_pixel = |cell: f64| (CELL as f64) * cell + 0.5 * (CELL as f64 - 1.0);
        let own = cell.map(|x| to_pixel(x as f64));
        let place = self.transform.apply(own, middle);
        let from_border = |place: [f64; 2], i: usize| place[i].min(self.size[i] as f64 - 1.0 - place[i]);
        let inside = |i: usize| from_border(place, i) >= (from_border(own, i) - 0.5).min(MARGIN);
        if !(inside(0) && inside(1)) {
            return None;
        }
        let [columns, rows] = cells(self.size);
        let along = |i: usize, count: usize| {
            let at = ((place[i] - to_pixel(0.0)) / CELL as f64).clamp(0.0, count as f64 - 1.0);
            (at as usize, (at as usize + 1).min(count - 1), at.fract() as f32)
        };
        let ((x, next, fx), (y, below, fy)) = (along(0, columns), along(1, rows));
        let line = |y: usize| {
            let row = &self.values[y * columns..][..columns];
            row[x] + fx * (row[next] - row[x])
        };
        let (upper, lower) = (line(y), line(below));
        Some(self.scale * (upper + fy * (lower - upper)))
    }
}

/// The mean of each cell; one that reaches over the border has its last pixels twice.
fn in_cells(values: &[f32], [width, height]: [usize; 2]) -> Vec<f32> {
    let [columns, rows] = cells([width, height]);
    let mut means = vec![0.0; columns * rows];
    in_rows(&mut means, columns, |row, means| {
        let of_row = |y: usize| &values[(CELL * row + y).min(height - 1) * width..][..width];
        for line in (0..CELL).map(of_row) {
            for (column, mean) in means.iter_mut().enumerate() {
                let pixels = (0..CELL).map(|n| line[(CELL * column + n).min(width - 1)]);
                *mean += pixels.sum::<f32>() / (CELL * CELL) as f32;
            }
        }
    });
    means
}

/// The mean over the window.
fn smoothed(values: &[f32], [columns, rows]: [usize; 2]) -> Vec<f32> {
    const RADIUS: isize = 4;
    let weights: Vec<f32> = (-RADIUS..=RADIUS).map(|n| (-0.5 * (n as f32 / WINDOW).powi(2)).exp()).collect();
    let whole: f32 = weights.iter().sum();
    let inside = |at: usize, n: isize, count: usize| (at as isize + n).clamp(0, count as isize - 1) as usize;
    let taps = || (-RADIUS..=RADIUS).zip(&weights);
    let mut across = vec![0.0; values.len()];
    in_rows(&mut across, columns, |y, row| {
        for (n, weight) in taps() {
            let from = &values[inside(y, n, rows) * columns..][..columns];
            row.iter_mut().zip(from).for_each(|(sum, value)| *sum += weight / whole * value);
        }
    });
    let mut smoothed = vec![0.0; values.len()];
    in_rows(&mut smoothed, columns, |y, row| {
        let from = &across[y * columns..][..columns];
        for (x, sum) in row.iter_mut().enumerate() {
            *sum = taps().map(|(n, weight)| weight / whole * from[inside(x, n, columns)]).sum();
        }
    });
    smoothed
}
