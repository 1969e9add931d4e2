//! Excluded pixels of a sweep's frames, and the standard deviation of u.
//!
//! A pixel is excluded where it is clipped, masked, or outside a frame.

use crate::base::{Frame, Homography, Settings, workers};
use crate::engine::plan::Level;
use crate::engine::stages::separable::smoothed;
use crate::engine::stages::{Field, mask};

/// The margin around masked pixels that is excluded too, px: the band pass of the frames blurs by 2 px.
///
/// Clipped pixels have no margin, which would exclude more good pixels than bad ones. With a fifth of five frames
/// white, the error of u is 0.0119 of a step without a margin, 0.0171 with 3 px, and 0.0133 if no clipped pixel is
/// excluded. Corners are off by 0.07, 0.16 and 0.14 px.
const MASK_MARGIN: usize = 3;
/// The margin that each coarser level adds, px of that level: it is blurred by σ 1 px before it is halved.
const HALVED_MASK_MARGIN: usize = 1;

/// Side of the square cells in which excluded pixels are looked for first, px.
const CELL: usize = 32;

/// The excluded pixels of one image.
struct ExclusionMask {
    width: usize,
    height: usize,
    excluded: Vec<bool>,
    /// Whether a cell has an excluded pixel, by [`CELL`]s; empty before [`levels`](Self::levels).
    cells: Vec<bool>,
}

impl ExclusionMask {
    fn new(width: usize, height: usize, excluded: Vec<bool>) -> Self {
        Self { width, height, excluded, cells: Vec::new() }
    }

    /// Notes which cells have an excluded pixel.
    fn with_cells(self) -> Self {
        let columns = self.width.div_ceil(CELL);
        let mut cells = vec![false; columns * self.height.div_ceil(CELL)];
        for (rows, cells) in self.excluded.chunks(CELL * self.width).zip(cells.chunks_exact_mut(columns)) {
            for row in rows.chunks_exact(self.width) {
                row.chunks(CELL).zip(&mut *cells).for_each(|(pixels, cell)| *cell |= pixels.contains(&true));
            }
        }
        Self { cells, ..self }
    }

    /// Excludes also the pixels within `margin` px along either axis.
    fn grown(self, margin: usize) -> Self {
        if margin == 0 {
            return self;
        }
        let mut along = self.excluded.clone();
        for (row, source) in along.chunks_exact_mut(self.width).zip(self.excluded.chunks_exact(self.width)) {
            for x in (0..self.width).filter(|&x| source[x]) {
                row[x.saturating_sub(margin)..(x + margin + 1).min(self.width)].fill(true);
            }
        }
        let mut excluded = along.clone();
        for (y, row) in along.chunks_exact(self.width).enumerate().filter(|(_, row)| row.contains(&true)) {
            for near in y.saturating_sub(margin)..(y + margin + 1).min(self.height) {
                let to = &mut excluded[near * self.width..][..self.width];
                to.iter_mut().zip(row).for_each(|(to, from)| *to |= from);
            }
        }
        Self { excluded, ..self }
    }

    /// The next coarser level, whose pixel i is at pixel 2i.
    fn halved(&self) -> Self {
        let [width, height] = [self.width, self.height].map(|side| side.div_ceil(2));
        let at = |x: usize, y: usize| self.excluded[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let any = |x, y| at(2 * x, 2 * y) || at(2 * x + 1, 2 * y) || at(2 * x, 2 * y + 1) || at(2 * x + 1, 2 * y + 1);
        let excluded = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| any(x, y)).collect();
        Self::new(width, height, excluded)
    }

    /// `count` levels, the finest first, with margins on the finest and on the others.
    fn levels(self, count: usize, [margin, halved_margin]: [usize; 2]) -> Vec<Self> {
        let mut levels = vec![self.grown(margin)];
        while levels.len() < count {
            levels.push(levels[levels.len() - 1].halved().grown(halved_margin));
        }
        levels.into_iter().map(Self::with_cells).collect()
    }

    /// Whether the pixel where T takes a pixel of the reference is excluded.
    fn contains(&self, t: &Homography, level: &Level, pixel: [usize; 2]) -> bool {
        let [x, y] = mapped(t, level, pixel.map(|at| at as f64));
        self.excluded[nearest(y, self.height) * self.width + nearest(x, self.width)]
    }

    /// Whether [`contains`](Self::contains) may hold for a pixel of a row from column `first` to column `last`.
    fn may_contain(&self, t: &Homography, level: &Level, [first, last]: [usize; 2], y: usize) -> bool {
        // Only affine maps take points between two others to points between the mapped ones, evenly.
        if !t.is_affine() {
            return true;
        }
        let ends = [first, last].map(|x| mapped(t, level, [x as f64, y as f64]));
        // A pixel to either side covers rounding.
        let span = |axis: usize, side: usize| {
            let [low, high] = [ends[0][axis].min(ends[1][axis]) - 1.0, ends[0][axis].max(ends[1][axis]) + 1.0];
            nearest(low, side) / CELL..=nearest(high, side) / CELL
        };
        let columns = self.width.div_ceil(CELL);
        span(1, self.height).any(|row| span(0, self.width).any(|column| self.cells[row * columns + column]))
    }
}

/// The pixel of a side of this length that is nearest to a coordinate: `at.round()` within the side. The cast to an
/// integer is an instruction of the processor, and `round` a call.
fn nearest(at: f64, side: usize) -> usize {
    let below = (at as usize).min(side - 1);
    (below + usize::from(at - below as f64 >= 0.5)).min(side - 1)
}

/// By level, the finest first; `None` if no pixel is excluded.
type Levels = Option<Vec<ExclusionMask>>;

/// The excluded pixels of all frames. What is not part of the reference's picture is excluded in every frame.
pub(super) struct ExcludedPixels {
    clipped: Vec<Levels>,
    /// Not part of the picture.
    masked: Vec<Levels>,
    reference: usize,
}

impl ExcludedPixels {
    /// Finds them on a number of levels.
    pub(super) fn new(frames: &[Frame], reference: usize, settings: &Settings, levels: usize) -> Self {
        let [width, height] = [frames[0].width(), frames[0].height()].map(|side| side as usize);
        let clipped = |n: usize| {
            let (frame, limits) = (&frames[n], settings.clipped(frames[n].format().depth));
            let levels = || {
                let counts: Field = mask::cpu_reference(frame, limits, None);
                let excluded = counts.data.iter().map(|&counts| counts == 0.0).collect();
                ExclusionMask::new(width, height, excluded).levels(levels, [0; 2])
            };
            frame.has_clipped_pixels(limits).then(levels)
        };
        let masked = |n: usize| {
            let excluded = frames[n].counted()?.iter().map(|&counts| counts == 0).collect();
            let margins = [MASK_MARGIN, HALVED_MASK_MARGIN];
            Some(ExclusionMask::new(width, height, excluded).levels(levels, margins))
        };
        Self { clipped: workers::map(frames.len(), clipped), masked: workers::map(frames.len(), masked), reference }
    }

    /// Drops the finest level.
    pub(super) fn halved(mut self) -> Self {
        self.clipped.iter_mut().chain(&mut self.masked).flatten().for_each(|levels| drop(levels.remove(0)));
        self
    }

    /// One bit per frame for each pixel of the reference on a level, set where the frame is excluded; empty if nothing
    /// is.
    pub(super) fn words(&self, level: &Level, transforms: &[Homography]) -> Vec<u32> {
        if self.clipped.iter().chain(&self.masked).all(Option::is_none) {
            return Vec::new();
        }
        let [width, height] = level.size.map(|side| side as usize);
        let words = self.clipped.len().div_ceil(32);
        let mut all = vec![0; words * width * height];
        let rows = all.chunks_exact_mut(words * width).enumerate();
        workers::for_each(rows, |(y, row)| {
            if let Some(levels) = &self.masked[self.reference] {
                let masked = levels[level.index].excluded[y * width..][..width].iter();
                let masked = row.chunks_exact_mut(words).zip(masked).filter(|(_, masked)| **masked);
                masked.for_each(|(bits, _)| bits.fill(u32::MAX));
            }
            let frames =
                [&self.clipped, &self.masked].into_iter().flat_map(|levels| levels.iter().zip(transforms).enumerate());
            for (n, (levels, t)) in frames.filter_map(|(n, (levels, t))| Some((n, (levels.as_ref()?, t)))) {
                let mask = &levels[level.index];
                for first in (0..width).step_by(CELL) {
                    let end = (first + CELL).min(width);
                    if !mask.may_contain(t, level, [first, end - 1], y) {
                        continue;
                    }
                    for x in (first..end).filter(|x| mask.contains(t, level, [*x, y])) {
                        row[x * words + n / 32] |= 1 << (n % 32);
                    }
                }
            }
        });
        all
    }
}

/// Counts the pixels that are valid in two frames or more, so that a pair can contribute; `words` as from
/// [`ExcludedPixels::words`].
pub(super) fn count_in_two_frames(words: &[u32], frames: usize) -> usize {
    words.chunks_exact(frames.div_ceil(32)).filter(|bits| is_in_two_frames(bits, frames)).count()
}

/// Whether the pixel of these words is valid in two frames or more.
pub(super) fn is_in_two_frames(bits: &[u32], frames: usize) -> bool {
    (0..frames).filter(|n| bits[n / 32] >> (n % 32) & 1 == 0).count() > 1
}

/// Left, top, right and bottom of a rectangle, pixels of a level.
pub(super) type Rectangle = [f64; 4];

/// The largest rectangle of the reference's pixels, along the axes, that a frame shows; exact for frames that turn by
/// less than a degree.
pub(super) fn visible(t: &Homography, level: &Level) -> Rectangle {
    let last = level.size.map(|side| f64::from(side) - 1.0);
    let inverse = t.inverse();
    let corner = |x: f64, y: f64| mapped(&inverse, level, [x, y]);
    let [a, b, c, d] = [corner(0.0, 0.0), corner(last[0], 0.0), corner(0.0, last[1]), corner(last[0], last[1])];
    let inside = [a[0].max(c[0]), a[1].max(b[1]), b[0].min(d[0]), c[1].min(d[1])];
    intersection([inside, [0.0, 0.0, last[0], last[1]]])
}

pub(super) fn intersection([a, b]: [Rectangle; 2]) -> Rectangle {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]
}

/// Where T takes a place, both in pixels of a level.
pub(super) fn mapped(t: &Homography, level: &Level, [x, y]: [f64; 2]) -> [f64; 2] {
    let d = t.displacement([level.factor * (x - level.centre[0]), level.factor * (y - level.centre[1])]);
    [x + d[0] / level.factor, y + d[1] / level.factor]
}

/// σ of the window over which a step averages D and b, px.
const STEP_WINDOW: f64 = 2.0;
/// σ of the window over which the deviation is averaged, px.
const DEVIATION_WINDOW: f64 = 4.0;
/// σ over which neighbours share errors of b, px.
const SHARED_ERROR: f64 = 1.0;
/// D counts beyond this multiple of the D that noise makes. The D of a flat region varies by a fifth from window to
/// window, and so do both estimates of noise. The smaller one counts.
const NOISE_FACTOR: f64 = 2.0;

/// The linear system of the last iteration.
pub(super) struct FinalSystem {
    d: Field,
    /// D as noise of variance 1 makes it.
    d_of_noise: Field,
    /// D as noise as large as the residuals makes it.
    d_of_residuals: Field,
    /// b after the step.
    b: Field,
}

impl FinalSystem {
    /// From the layers of the system before the step, and u before and after it.
    pub(super) fn after_step(layers: Vec<Field>, before: &Field, after: &Field) -> Option<Self> {
        let [d, mut b, d_of_noise, d_of_residuals] = <[Field; 4]>::try_from(layers).ok()?;
        let steps = after.data.iter().zip(&before.data).map(|(after, before)| after - before);
        b.data.iter_mut().zip(&d.data).zip(steps).for_each(|((b, d), step)| *b -= d * step);
        Some(Self { d, d_of_noise, d_of_residuals, b })
    }

    /// `sqrt(4 <(G₁ b)²> 4π/(N <D>²) + 4 <(u - G₂ u)²>)`, means over σ 4 px, N = 4π [`STEP_WINDOW`]², D less what noise
    /// makes of it; NaN where nothing is left.
    ///
    /// b is added over pairs before it is squared, so that errors that pairs share count. The second term is what the
    /// window rounds off. Noise is at most as large as the residuals, which also hold what the model does not explain.
    /// It is also at most as large as the frame at the end of the sweep in which the pixel is farther out of focus:
    /// blur and the band pass leave least texture there. The smaller counts. `ends`: both frames, and the pixels that
    /// they show. u is relative to the middle setting.
    pub(super) fn deviation(&self, focus: &Field, ends: &[(Field, Rectangle); 2]) -> Field {
        let map = |f: &(dyn Fn(usize) -> f64 + Sync)| Field { data: (0..focus.data.len()).map(f).collect(), ..*focus };
        let near =
            workers::map(2, |n| if n == 0 { smoothed(&self.b, SHARED_ERROR) } else { smoothed(focus, STEP_WINDOW) });
        let [errors, rounded] = [0, 1].map(|n| &near[n]);
        let shows = |n: &usize, i: usize| {
            let ([left, top, right, bottom], x, y) = (ends[*n].1, (i % focus.width) as f64, (i / focus.width) as f64);
            x >= left && x <= right && y >= top && y <= bottom
        };
        let noise = |i: usize| {
            let farther = usize::from(focus.data[i] < 0.0);
            let end = [farther, 1 - farther].into_iter().find(|n| shows(n, i));
            end.map_or(f64::INFINITY, |n| ends[n].0.data[i].powi(2))
        };
        let means = workers::map(6, |n| {
            let field = match n {
                0 => map(&|i| errors.data[i].powi(2)),
                1 => self.d.clone(),
                2 => self.d_of_noise.clone(),
                3 => map(&noise),
                4 => self.d_of_residuals.clone(),
                _ => map(&|i| (focus.data[i] - rounded.data[i]).powi(2)),
            };
            smoothed(&field, DEVIATION_WINDOW)
        });
        map(&|i| {
            let [errors, d, of_noise, noise, of_residuals, bend] = [0, 1, 2, 3, 4, 5].map(|n| means[n].data[i]);
            // If one of them is NaN, `min` gives the other.
            let information = d - NOISE_FACTOR * of_residuals.min(of_noise * noise);
            if information > f64::MIN_POSITIVE {
                (4.0 * errors / (STEP_WINDOW * STEP_WINDOW * information.powi(2)) + 4.0 * bend).sqrt()
            } else {
                f64::NAN
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;

    #[test]
    fn a_pixel_counts_if_two_frames_are_valid_there() {
        // 34 frames: all are valid at the first pixel; none at the second; two at the third, in either word; one at the
        // last.
        let words = [0, 0, u32::MAX, u32::MAX, u32::MAX >> 1, !1, u32::MAX, !1];
        assert_eq!(count_in_two_frames(&words, 34), 2);
    }

    #[test]
    fn the_nearest_pixel_is_the_rounded_coordinate() {
        let cases = [-7.5, -0.5, -0.0, 0.49999999999999994, 0.5, 1.5, 2.5, 8.499, 8.5, 9.5, 1e300];
        for at in cases.into_iter().chain([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]) {
            assert_eq!(nearest(at, 10), at.round().clamp(0.0, 9.0) as usize, "{at}");
        }
    }

    #[test]
    fn every_excluded_pixel_has_its_bit_under_any_transform() {
        let (width, height, levels) = (150usize, 110usize, 2);
        // Few excluded pixels, at a corner, in the middle and on a line, so that most cells have none.
        let excluded: Vec<bool> = (0..width * height)
            .map(|i| i == 0 || (70..73).contains(&(i % width)) && i / width == 60 || i / width == 109)
            .collect();
        let masked: Vec<bool> = (0..width * height).map(|i| i % width == 20).collect();
        let mask = |excluded: &[bool]| ExclusionMask::new(width, height, excluded.to_vec()).levels(levels, [0, 1]);
        let perspective = Homography::from_matrix([[1.0, 0.0, 3.0], [0.0, 1.0, 0.0], [1e-4, -2e-4, 1.0]]).unwrap();
        let transforms = [
            Homography::IDENTITY,
            Similarity { scale: 1.1, rotation: 0.2, tx: 31.4, ty: -17.5 }.into(),
            Similarity { scale: 0.9, rotation: -3.0, tx: 0.25, ty: 400.0 }.into(),
            perspective,
        ];
        let frames: Vec<Levels> = transforms.iter().map(|_| Some(mask(&excluded))).chain([None]).collect();
        let none = (0..4).map(|_| None);
        let masked = none.chain([Some(mask(&masked))]).collect();
        let pixels = ExcludedPixels { clipped: frames, masked, reference: 4 };
        let transforms: Vec<Homography> = transforms.into_iter().chain([Homography::IDENTITY]).collect();
        let mut seen = [0; 5];
        for level in [0, 1].map(|index| Level::new(index, width as u32, height as u32, 10.0)) {
            let found = pixels.words(&level, &transforms);
            fn of<'a>(levels: &'a Levels, level: &Level) -> Option<&'a ExclusionMask> {
                levels.as_ref().map(|levels| &levels[level.index])
            }
            let columns = level.size[0] as usize;
            for (i, bits) in found.iter().enumerate() {
                let pixel = [i % columns, i / columns];
                if of(&pixels.masked[4], &level).is_some_and(|mask| mask.excluded[i]) {
                    assert_eq!(*bits, u32::MAX);
                    continue;
                }
                for (n, (levels, t)) in pixels.clipped.iter().zip(&transforms).enumerate() {
                    let [x, y] = mapped(t, &level, pixel.map(|at| at as f64));
                    let is_excluded = of(levels, &level).is_some_and(|mask| {
                        let [x, y] = [(x, mask.width), (y, mask.height)]
                            .map(|(at, side)| at.round().clamp(0.0, side as f64 - 1.0) as usize);
                        mask.excluded[y * mask.width + x]
                    });
                    assert_eq!(bits >> n & 1 == 1, is_excluded, "frame {n} at {pixel:?} of level {}", level.index);
                    seen[n] += usize::from(is_excluded);
                }
            }
        }
        assert!(seen[..4].iter().all(|count| *count > 50) && seen[4] == 0, "{seen:?}");
    }

    #[test]
    fn the_visible_rectangle_is_inside_the_frame() {
        let level = Level::new(1, 101, 81, 10.0);
        let t = Homography::from(Similarity { scale: 1.0, rotation: 0.0, tx: 6.0, ty: -4.0 });
        // Pixel x of the reference is at x + 3, y - 2 of the level.
        assert_eq!(visible(&t, &level).map(|side| side.round()), [0.0, 2.0, 47.0, 40.0]);
        let turned = Homography::from(Similarity { scale: 1.0, rotation: 0.1, tx: 0.0, ty: 0.0 });
        let [left, top, right, bottom] = visible(&turned, &level);
        for (x, y) in [(left, top), (right, top), (left, bottom), (right, bottom)] {
            let place = mapped(&turned, &level, [x, y]);
            assert!((0..2).all(|n| place[n] > -1e-9 && place[n] < f64::from(level.size[n]) - 1.0 + 1e-9), "{place:?}");
        }
    }
}
