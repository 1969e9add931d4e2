//! What is too large for one solve: parts of one size that overlap, and the photographs at half their size.

use super::filter::Filter;
use super::plan::halving_filter;
use super::stages::{convolve, ingest};
use crate::base::color::LUMINANCE;
use crate::base::{Decode, Error, Frame, Homography, Region, Shading, Similarity, centre, workers};

/// Where parts lie along one axis: where each begins, and where what is taken of it does.
struct Axis {
    side: u32,
    origins: Vec<u32>,
    /// One more than there are parts.
    borders: Vec<u32>,
}

impl Axis {
    /// Parts of one side, at most `most`, that begin at even places, since pixel i of the half-size image sits on pixel 2i, and reach `halo`
    /// beyond what is taken of them.
    fn covering(whole: u32, most: u32, halo: u32) -> Self {
        if whole <= most {
            return Self { side: whole, origins: vec![0], borders: vec![0, whole] };
        }
        // The last one ends where the whole does, and begins at an even place.
        let side = most - (whole - most) % 2;
        let count = (whole - 2 * halo).div_ceil(side - 2 * halo).max(2);
        let origin = |n: u32| (u64::from(n) * u64::from(whole - side) / u64::from(count - 1)) as u32 & !1;
        let origins: Vec<u32> = (0..count).map(origin).collect();
        let between = origins.windows(2).map(|two| (two[0] + side + two[1]) / 2);
        Self { side, borders: [0].into_iter().chain(between).chain([whole]).collect(), origins }
    }
}

/// A part, and what is taken of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) solved: Region,
    pub(super) taken: Region,
}

impl Part {
    /// Takes over what is taken of a part's field, so many numbers a pixel, into that of the whole, whose rows have so many pixels.
    pub(super) fn bring<T: Copy>(&self, from: &[T], whole: &mut [T], width: usize, numbers: usize) {
        let Self { solved, taken } = self;
        for y in taken.y..taken.y + taken.height {
            let first = (y - solved.y) as usize * solved.width as usize + (taken.x - solved.x) as usize;
            let to = y as usize * width + taken.x as usize;
            let count = numbers * taken.width as usize;
            whole[numbers * to..][..count].copy_from_slice(&from[numbers * first..][..count]);
        }
    }
}

/// Parts that cover a photograph.
pub(super) struct Grid {
    axes: [Axis; 2],
}

impl Grid {
    /// Parts of at most `most` px a side, which reach `halo` px beyond what is taken of them.
    pub(super) fn covering(size: [u32; 2], most: u32, halo: u32) -> Self {
        Self { axes: size.map(|side| Axis::covering(side, most, halo)) }
    }

    /// Width and height of each.
    pub(super) fn side(&self) -> [u32; 2] {
        self.axes.each_ref().map(|axis| axis.side)
    }

    /// Parts in all.
    pub(super) fn count(&self) -> usize {
        self.axes.iter().map(|axis| axis.origins.len()).product()
    }

    /// Row by row.
    pub(super) fn parts(&self) -> impl Iterator<Item = Part> {
        let [columns, rows] = self.axes.each_ref().map(|axis| axis.origins.len());
        (0..rows).flat_map(move |row| (0..columns).map(move |column| self.part([column, row])))
    }

    fn part(&self, place: [usize; 2]) -> Part {
        let [x, y] = [0, 1].map(|n| self.axes[n].origins[place[n]]);
        let [left, top] = [0, 1].map(|n| self.axes[n].borders[place[n]]);
        let [right, bottom] = [0, 1].map(|n| self.axes[n].borders[place[n] + 1]);
        Part {
            solved: Region { x, y, width: self.axes[0].side, height: self.axes[1].side },
            taken: Region { x: left, y: top, width: right - left, height: bottom - top },
        }
    }
}

/// Where a part is cut out of a photograph of this size, namely where T puts its middle, and T between the two.
pub(super) fn cut(t: &Homography, part: Region, size: [u32; 2]) -> (Region, Homography) {
    let (whole, middle) = (centre(size[0], size[1]), part.centre());
    let d = t.displacement([middle[0] - whole[0], middle[1] - whole[1]]);
    let origin =
        |at: u32, d: f64, side: u32, all: u32| (f64::from(at) + d).round().clamp(0.0, f64::from(all - side)) as u32;
    let place =
        Region { x: origin(part.x, d[0], part.width, size[0]), y: origin(part.y, d[1], part.height, size[1]), ..part };
    let [tx, ty] = [f64::from(part.x) - f64::from(place.x), f64::from(part.y) - f64::from(place.y)];
    let moved = Homography::from(Similarity { scale: 1.0, rotation: 0.0, tx, ty }).after(&t.about(whole, middle));
    (place, moved)
}

/// T of photographs of this size by that of photographs of half of it.
pub(super) fn doubled(t: &Homography, size: [u32; 2]) -> Homography {
    let half = centre(size[0].div_ceil(2), size[1].div_ceil(2));
    t.scaled(2.0).about(half.map(|c| 2.0 * c), centre(size[0], size[1]))
}

/// T of photographs of half this size by that of photographs of it.
pub(super) fn halved_map(t: &Homography, size: [u32; 2]) -> Homography {
    let half = centre(size[0].div_ceil(2), size[1].div_ceil(2));
    t.about(centre(size[0], size[1]), half.map(|c| 2.0 * c)).scaled(0.5)
}

/// Gain and shading of a photograph as a region of it has them.
pub(super) fn shading_within(gain: f64, shading: &Shading, region: Region, size: [u32; 2]) -> (f64, Shading) {
    let (own, first, whole) = (centre(region.width, region.height), [region.x, region.y], centre(size[0], size[1]));
    restated(gain, shading, |at, n| (f64::from(first[n]) + own[n] * (1.0 + at) - whole[n]) / whole[n])
}

/// Gain and shading of photographs of this size by those of photographs of half of it.
pub(super) fn shading_doubled(gain: f64, shading: &Shading, size: [u32; 2]) -> (f64, Shading) {
    let (half, whole) = (centre(size[0].div_ceil(2), size[1].div_ceil(2)), centre(size[0], size[1]));
    restated(gain, shading, |at, n| (0.5 * whole[n] * (1.0 + at) - half[n]) / half[n])
}

/// Gain and shading as another photograph has them, whose place, -1 to 1 along axis n, lies `at` that of the first.
fn restated(gain: f64, shading: &Shading, at: impl Fn(f64, usize) -> f64) -> (f64, Shading) {
    let (mean, shading) = Shading::fit(|[x, y]| shading.at([at(x, 0), at(y, 1)]));
    (gain * mean, shading)
}

/// Rows of the half-size image that are made at a time: 40 MB of a photograph that is 10,000 px wide.
const ROWS: u32 = 256;

/// Luminance at half the size, as a level of the pyramid would be.
pub(super) fn halved(frame: &Frame, decode: Decode) -> Result<Frame, Error> {
    let filter: Filter = halving_filter();
    let reach = (filter.len() / 2) as u32 + 1;
    let (width, height) = (frame.width(), frame.height());
    let half = [width.div_ceil(2), height.div_ceil(2)];
    let strip = |n: usize| {
        let rows = n as u32 * ROWS..((n as u32 + 1) * ROWS).min(half[1]);
        // Even, so that every other row of the strip is one of the whole.
        let first = (2 * rows.start).saturating_sub(reach) & !1;
        let end = (2 * rows.end + reach).min(height);
        let strip = Region { x: 0, y: first, width, height: end - first };
        let luminance = ingest::cpu_reference(&frame.cropped(strip).map_err(Error::Region)?, decode, LUMINANCE);
        let small = convolve::cpu_reference(&convolve::cpu_reference(&luminance, &filter, 2, false), &filter, 2, true);
        let skipped = (rows.start - first / 2) as usize * small.width;
        Ok(small.data[skipped..][..rows.len() * small.width].iter().map(|&v| v as f32).collect::<Vec<f32>>())
    };
    let strips: Result<Vec<Vec<f32>>, Error> =
        workers::map(half[1].div_ceil(ROWS) as usize, strip).into_iter().collect();
    Frame::gray(half[0], half[1], strips?.concat()).map_err(Error::Mismatch)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_all_and_reach_beyond_what_is_taken() {
        for whole in [200, 801, 1000, 4001] {
            let halo = 44;
            let axis = Axis::covering(whole, 400, halo);
            let halo = if whole > 400 { halo } else { 0 };
            assert!(axis.side <= 400 && axis.origins.iter().all(|origin| origin % 2 == 0));
            assert_eq!(axis.origins.last().map(|last| last + axis.side), Some(whole));
            assert_eq!((axis.borders[0], axis.borders[axis.origins.len()]), (0, whole));
            for (n, origin) in axis.origins.iter().enumerate() {
                let [left, right] = [axis.borders[n], axis.borders[n + 1]];
                assert!(n == 0 || left >= origin + halo - 1, "{whole}: part {n}");
                assert!(right == whole || right + halo <= origin + axis.side + 1, "{whole}: part {n}");
                assert!(left < right);
            }
        }
    }

    #[test]
    fn what_is_common_says_the_same_of_a_part() {
        let (size, part) = ([640, 481], Region { x: 120, y: 60, width: 300, height: 201 });
        let t = Homography::from(Similarity { scale: 1.02, rotation: 0.01, tx: 5.0, ty: -7.0 });
        let mut shading = Shading::NONE;
        shading.coefficients = std::array::from_fn(|n| 0.03 * (1.3 * n as f64).cos());
        let whole = centre(size[0], size[1]);
        let bright = |(gain, shading): (f64, Shading), at: [f64; 2], c: [f64; 2]| {
            gain * shading.at([(at[0] - c[0]) / c[0], (at[1] - c[1]) / c[1]])
        };
        let (place, moved) = cut(&t, part, size);
        let (own, half) = (centre(part.width, part.height), centre(320, 241));
        for [x, y] in [[0.0, 0.0], [299.0, 13.0], [150.0, 200.0]] {
            let at = t.apply([x + 120.0, y + 60.0], whole);
            let there = moved.apply([x, y], own);
            let expected = [at[0] - f64::from(place.x), at[1] - f64::from(place.y)];
            assert!((0..2).all(|n| (there[n] - expected[n]).abs() < 1e-9), "{there:?} {expected:?}");
            let within = bright(shading_within(1.1, &shading, place, size), there, own);
            assert!((within - bright((1.1, shading), at, whole)).abs() < 1e-9);
            let small = t.apply([x, y], half);
            let large = doubled(&t, size).apply([2.0 * x, 2.0 * y], whole);
            assert!((0..2).all(|n| (large[n] - 2.0 * small[n]).abs() < 1e-9), "{large:?} {small:?}");
            let back = halved_map(&doubled(&t, size), size).apply([x, y], half);
            assert!((0..2).all(|n| (back[n] - small[n]).abs() < 1e-9), "{back:?} {small:?}");
            let twice = bright(shading_doubled(1.1, &shading, size), large, whole);
            assert!((twice - bright((1.1, shading), small, half)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_photograph_is_halved_in_strips_as_in_one() {
        let (width, height) = (37, 2 * ROWS + 71);
        let values = (0..width * height).map(|i| ((i * 7919) % 251) as f32 / 251.0).collect();
        let frame = Frame::gray(width, height, values).unwrap();
        let filter: Filter = halving_filter();
        let luminance = ingest::cpu_reference(&frame, Decode::None, LUMINANCE);
        let whole = convolve::cpu_reference(&convolve::cpu_reference(&luminance, &filter, 2, false), &filter, 2, true);
        let found = halved(&frame, Decode::None).unwrap();
        assert_eq!([found.width(), found.height()], [19, ROWS + 36]);
        let found = found.intensities(Decode::None);
        assert!(found.iter().zip(&whole.data).all(|(found, whole)| (f64::from(*found) - whole).abs() < 1e-6));
    }
}
