//! Which pixels of a sweep's frames do not count: those that are clipped, those that a mask leaves out and
//! what lies close around these.

use crate::base::{Frame, Homography, Mask, Settings, workers};
use crate::engine::plan::Level;
use crate::engine::stages::mask;

/// How far what a mask leaves out reaches, px: the low and the high pass of the frames blur by 2 px. What is clipped does not: what is lost
/// around it tells more than what is wrong (a fifth of five frames white: error of u 0.0119 of a step, with a reach of 3 px 0.0171, not told of
/// 0.0133; corners off by 0.07, 0.16, 0.14 px).
const REACH: usize = 3;
/// The same in px of a coarser level, which is blurred by σ 1 px before every other pixel is taken.
const REACH_OF_HALVING: usize = 1;

/// Where nothing counts of an image.
struct Bits {
    width: usize,
    height: usize,
    set: Vec<bool>,
}

impl Bits {
    /// With all that lies within a square of so many px to either side.
    fn grown(self, reach: usize) -> Self {
        if reach == 0 {
            return self;
        }
        let mut along = self.set.clone();
        for (row, of) in along.chunks_exact_mut(self.width).zip(self.set.chunks_exact(self.width)) {
            for x in (0..self.width).filter(|&x| of[x]) {
                row[x.saturating_sub(reach)..(x + reach + 1).min(self.width)].fill(true);
            }
        }
        let mut set = along.clone();
        for (y, row) in along.chunks_exact(self.width).enumerate().filter(|(_, row)| row.contains(&true)) {
            for near in y.saturating_sub(reach)..(y + reach + 1).min(self.height) {
                let to = &mut set[near * self.width..][..self.width];
                to.iter_mut().zip(row).for_each(|(to, from)| *to |= from);
            }
        }
        Self { set, ..self }
    }

    /// Of the coarser level: pixel i sits on pixel 2i.
    fn halved(&self) -> Self {
        let [width, height] = [self.width, self.height].map(|side| side.div_ceil(2));
        let at = |x: usize, y: usize| self.set[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let any = |x, y| at(2 * x, 2 * y) || at(2 * x + 1, 2 * y) || at(2 * x, 2 * y + 1) || at(2 * x + 1, 2 * y + 1);
        let set = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| any(x, y)).collect();
        Self { width, height, set }
    }

    /// Of so many levels, the finest first, from pixels that do not count and reach so far on the finest level and on those after it.
    fn levels(self, count: usize, [reach, of_halving]: [usize; 2]) -> Vec<Self> {
        let mut levels = vec![self.grown(reach)];
        while levels.len() < count {
            levels.push(levels[levels.len() - 1].halved().grown(of_halving));
        }
        levels
    }
}

/// Of a frame by level, finest first; `None` where all of its pixels count.
type Levels = Option<Vec<Bits>>;

/// Of all frames, and of the reference's pixels whatever the frame.
pub(super) struct Hidden {
    frames: Vec<Levels>,
    everywhere: Levels,
}

impl Hidden {
    /// On so many levels; the mask is on the pixels of the reference.
    pub(super) fn of(frames: &[Frame], mask: Option<&Mask>, settings: &Settings, levels: usize) -> Self {
        let of_frame = |n: usize| {
            let (frame, clipped) = (&frames[n], settings.clipped(frames[n].format().depth));
            let bits = || {
                let counts = mask::cpu_reference(frame, clipped, None);
                let set = counts.data.iter().map(|&counts| counts == 0.0).collect();
                Bits { width: counts.width, height: counts.height, set }.levels(levels, [0; 2])
            };
            frame.clips(clipped).then(bits)
        };
        let everywhere = mask.map(|mask| {
            let [width, height] = mask.size().map(|side| side as usize);
            Bits { width, height, set: mask.bytes().iter().map(|&counts| counts == 0).collect() }
                .levels(levels, [REACH, REACH_OF_HALVING])
        });
        Self { frames: workers::collect(frames.len(), of_frame), everywhere }
    }

    /// What is left without the finest level.
    pub(super) fn halved(mut self) -> Self {
        self.frames.iter_mut().chain([&mut self.everywhere]).flatten().for_each(|levels| drop(levels.remove(0)));
        self
    }

    /// A bit a frame for each pixel of a level, as many words a pixel as it takes; none where all count.
    pub(super) fn words(&self, level: &Level, transforms: &[Homography]) -> Vec<u32> {
        if self.everywhere.is_none() && self.frames.iter().all(Option::is_none) {
            return Vec::new();
        }
        let [width, height] = level.size.map(|side| side as usize);
        let words = self.frames.len().div_ceil(32);
        let mut all = vec![0; words * width * height];
        let rows = all.chunks_exact_mut(words * width).enumerate();
        workers::each(rows, |(y, row)| {
            for (x, bits) in row.chunks_exact_mut(words).enumerate() {
                if self.everywhere.as_ref().is_some_and(|levels| levels[level.index].set[y * width + x]) {
                    bits.fill(u32::MAX);
                    continue;
                }
                let frames = self.frames.iter().zip(transforms).enumerate();
                for (n, (levels, t)) in frames.filter_map(|(n, (levels, t))| Some((n, (levels.as_ref()?, t)))) {
                    if hides(&levels[level.index], t, level, [x, y]) {
                        bits[n / 32] |= 1 << (n % 32);
                    }
                }
            }
        });
        all
    }
}

/// How many pixels count in two frames or more, so that some pair may tell of them; of words as [`Hidden::words`] makes them.
pub(super) fn counting(words: &[u32], frames: usize) -> usize {
    let shown = |bits: &[u32]| (0..frames).filter(|n| bits[n / 32] >> (n % 32) & 1 == 0).count();
    words.chunks_exact(frames.div_ceil(32)).filter(|bits| shown(bits) > 1).count()
}

/// Whether a frame has nothing that counts at a pixel of the reference.
fn hides(bits: &Bits, t: &Homography, level: &Level, place: [usize; 2]) -> bool {
    let [x, y] = [0, 1].map(|n| place[n] as f64);
    let d = t.displacement([level.factor * (x - level.centre[0]), level.factor * (y - level.centre[1])]);
    let nearest = |at: f64, side: usize| at.round().clamp(0.0, side as f64 - 1.0) as usize;
    let [x, y] = [nearest(x + d[0] / level.factor, bits.width), nearest(y + d[1] / level.factor, bits.height)];
    bits.set[y * bits.width + x]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_counts_where_two_frames_show_it() {
        // 34 frames: all show the first; none the second; two the third, on either side of the words' border; one the last.
        let words = [0, 0, u32::MAX, u32::MAX, u32::MAX >> 1, !1, u32::MAX, !1];
        assert_eq!(counting(&words, 34), 2);
    }
}
