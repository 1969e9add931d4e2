//! A sweep whose photographs are too large for one solve: T and c are found at half their size, where all of each frame is seen, and the
//! finest level, on which they stay, is solved part by part.

use super::common::{Common, restated};
use super::hidden::Hidden;
use super::joint::Joint;
use crate::base::color::LUMINANCE;
use crate::base::{Error, Frame, Homography, Mask, Region, Settings, Similarity, centre, workers};
use crate::engine::Engine;
use crate::engine::filter;
use crate::engine::plan::{Plan, halving_filter};
use crate::engine::stages::{Field, convolve, ingest, prolong};

/// Px that a part reaches beyond what is taken of it, at least: windows of σ 4 px and as many sweeps as an iteration has are felt less far.
const HALO: u32 = 32;
/// The same as a share of its side: frames that breathe, or turn, by a few per cent are cut where the part's middle lies in them.
const HALO_SHARE: f64 = 0.03;
/// The least side of a part, px: of smaller ones most is halo.
const LEAST: u32 = 192;

/// Sides of the parts along one axis, where each begins, and where what is taken of it does.
struct Axis {
    side: u32,
    origins: Vec<u32>,
    /// One more than there are parts.
    borders: Vec<u32>,
}

impl Axis {
    /// Parts of one side, at most `most`, that begin at even places, since pixel i of the half-size image sits on pixel 2i.
    fn covering(whole: u32, most: u32) -> Self {
        if whole <= most {
            return Self { side: whole, origins: vec![0], borders: vec![0, whole] };
        }
        let halo = HALO + (HALO_SHARE * f64::from(most)) as u32;
        // The last one ends where the whole does, and begins at an even place.
        let side = most - (whole - most) % 2;
        let count = (whole - 2 * halo).div_ceil(side - 2 * halo).max(2);
        let origin = |n: u32| (u64::from(n) * u64::from(whole - side) / u64::from(count - 1)) as u32 & !1;
        let origins: Vec<u32> = (0..count).map(origin).collect();
        let between = origins.windows(2).map(|two| (two[0] + side + two[1]) / 2);
        Self { side, borders: [0].into_iter().chain(between).chain([whole]).collect(), origins }
    }
}

/// The finest level of a size and a number of frames, prepared to be solved by parts.
pub(super) struct Parts {
    joint: Joint,
    size: [u32; 2],
    axes: [Axis; 2],
}

impl Parts {
    /// Prepares for photographs as planned, in parts that take so many bytes at most.
    ///
    /// # Errors
    /// As [`Joint::new`].
    pub(super) fn new(engine: &Engine, plan: &Plan, frames: usize, bytes: u64) -> Result<Self, Error> {
        let [width, height] = plan.size;
        let pixels = f64::from(width) * f64::from(height);
        let share = bytes as f64 / plan.sweep_bytes(frames as u32) as f64;
        let most = ((share * pixels).sqrt() as u32).max(LEAST);
        let axes = plan.size.map(|side| Axis::covering(side, most));
        let settings = Settings { levels: Some(1), ..plan.settings.clone() };
        let part = Plan::new(axes[0].side, axes[1].side, plan.formats, &settings)?;
        Ok(Self { joint: Joint::new(engine, part, frames)?, size: plan.size, axes })
    }

    /// Parts in all.
    pub(super) fn count(&self) -> usize {
        self.axes.iter().map(|axis| axis.origins.len()).product()
    }

    /// u less the middle setting, and its standard deviation, from u at half the size.
    pub(super) fn solve(
        &mut self,
        frames: &[Frame],
        mask: Option<&Mask>,
        coarse: &Field,
        common: &Common,
        say: &mut dyn FnMut(),
    ) -> Result<[Field; 2], Error> {
        let [width, height] = self.size.map(|side| side as usize);
        let mut whole = [0, 1].map(|_| Field::zeros(width, height));
        for row in 0..self.axes[1].origins.len() {
            for column in 0..self.axes[0].origins.len() {
                let [part, taken] = self.part([column, row]);
                let solved = self.solve_part(part, frames, mask, coarse, common)?;
                for (whole, solved) in whole.iter_mut().zip(solved) {
                    for y in taken.y..taken.y + taken.height {
                        let from = (y - part.y) as usize * part.width as usize + (taken.x - part.x) as usize;
                        let to = y as usize * width + taken.x as usize;
                        let count = taken.width as usize;
                        whole.data[to..to + count].copy_from_slice(&solved.data[from..from + count]);
                    }
                }
                say();
            }
        }
        Ok(whole)
    }

    /// A part, and what is taken of it.
    fn part(&self, place: [usize; 2]) -> [Region; 2] {
        let [x, y] = [0, 1].map(|n| self.axes[n].origins[place[n]]);
        let [left, top] = [0, 1].map(|n| self.axes[n].borders[place[n]]);
        let [right, bottom] = [0, 1].map(|n| self.axes[n].borders[place[n] + 1]);
        let part = Region { x, y, width: self.axes[0].side, height: self.axes[1].side };
        [part, Region { x: left, y: top, width: right - left, height: bottom - top }]
    }

    fn solve_part(
        &mut self,
        part: Region,
        frames: &[Frame],
        mask: Option<&Mask>,
        coarse: &Field,
        common: &Common,
    ) -> Result<[Field; 2], Error> {
        let (mut common, places) = within(common, part, self.size);
        let cut = frames.iter().zip(places).map(|(frame, place)| frame.cropped(place).map_err(Error::Region));
        let cut = cut.collect::<Result<Vec<Frame>, Error>>()?;
        let mask = mask.map(|mask| mask.cropped(part));
        let hidden = Hidden::of(&cut, mask.as_ref(), self.joint.settings(), 1);
        self.joint.bring_up(cut.iter())?;
        let start = prolonged(coarse, part, common.limit(self.joint.finest()));
        self.joint.finish_from(&start, &mut common, &hidden)
    }
}

/// u of a part from that at half the size.
fn prolonged(coarse: &Field, part: Region, limit: f64) -> Field {
    let [x, y] = [part.x / 2, part.y / 2];
    let [width, height] =
        [(coarse.width as u32 - x).min(part.width / 2 + 1), (coarse.height as u32 - y).min(part.height / 2 + 1)];
    let data = Region { x, y, width, height }.of(&coarse.data, coarse.width, 1);
    let constants = prolong::Constants { width: part.width, height: part.height, limit: limit as f32, gain: 1.0 };
    prolong::twin(&constants, &Field { width: width as usize, height: height as usize, data })
}

/// What is common to all pixels of a part, and where it is cut out of each frame: where its middle lies there.
fn within(common: &Common, part: Region, size: [u32; 2]) -> (Common, Vec<Region>) {
    let (whole, middle) = (centre(size[0], size[1]), part.centre());
    let place = |t: &Homography| {
        let d = t.displacement([middle[0] - whole[0], middle[1] - whole[1]]);
        let origin =
            |at: u32, d: f64, side: u32, all: u32| (f64::from(at) + d).round().clamp(0.0, f64::from(all - side)) as u32;
        let x = origin(part.x, d[0], part.width, size[0]);
        Region { x, y: origin(part.y, d[1], part.height, size[1]), ..part }
    };
    let places: Vec<Region> = common.transforms.iter().map(place).collect();
    let moved = |(t, place): (&Homography, &Region)| {
        let [tx, ty] = [f64::from(part.x) - f64::from(place.x), f64::from(part.y) - f64::from(place.y)];
        Homography::from(Similarity { scale: 1.0, rotation: 0.0, tx, ty }).after(&t.about(whole, middle))
    };
    let transforms = common.transforms.iter().zip(&places).map(moved).collect();
    let brightness = common.brightness.iter().zip(&places).map(|(brightness, place)| {
        let (own, first) = (centre(place.width, place.height), [place.x, place.y]);
        let on_whole = |at: f64, n: usize| (f64::from(first[n]) + own[n] * (1.0 + at) - whole[n]) / whole[n];
        restated(brightness, |[x, y]| [on_whole(x, 0), on_whole(y, 1)])
    });
    let brightness = brightness.collect();
    (Common { transforms, brightness, ..common.clone() }, places)
}

/// What is common to all pixels of photographs of twice the size.
pub(super) fn doubled(common: &Common, size: [u32; 2]) -> Common {
    let half = centre(size[0].div_ceil(2), size[1].div_ceil(2));
    let whole = centre(size[0], size[1]);
    let transforms = common.transforms.iter().map(|t| t.scaled(2.0).about(half.map(|c| 2.0 * c), whole)).collect();
    let on_half = |at: f64, n: usize| (0.5 * whole[n] * (1.0 + at) - half[n]) / half[n];
    let brightness = common.brightness.iter().map(|b| restated(b, |[x, y]| [on_half(x, 0), on_half(y, 1)])).collect();
    Common { rate: 4.0 * common.rate, transforms, brightness, ..common.clone() }
}

/// Luminance of photographs at half their size, as a level of their pyramid would be.
pub(super) fn halved(frames: &[Frame], settings: &Settings) -> Result<Vec<Frame>, Error> {
    let filter: filter::Filter = halving_filter();
    let half = |n: usize| {
        let luminance = ingest::twin(&frames[n], settings.decode, LUMINANCE);
        let half = convolve::twin(&convolve::twin(&luminance, &filter, 2, false), &filter, 2, true);
        Frame::gray(half.width as u32, half.height as u32, half.to_f32()).map_err(Error::Mismatch)
    };
    workers::collect(frames.len(), half).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_all_and_reach_beyond_what_is_taken() {
        for whole in [200, 801, 1000, 4001] {
            let axis = Axis::covering(whole, 400);
            let halo = if whole > 400 { HALO + 12 } else { 0 };
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
        let mut shading = crate::base::Shading::NONE;
        shading.coefficients = std::array::from_fn(|n| 0.03 * (1.3 * n as f64).cos());
        let common = Common {
            settings: vec![0.0],
            middle: 0.0,
            reference: 0,
            rate: 2.0,
            transforms: vec![t],
            aligned: vec![None],
            brightness: vec![(1.1, shading)],
            telling: 1.0,
        };
        let whole = centre(size[0], size[1]);
        let bright = |(gain, shading): (f64, crate::base::Shading), at: [f64; 2], c: [f64; 2]| {
            gain * shading.at([(at[0] - c[0]) / c[0], (at[1] - c[1]) / c[1]])
        };
        let (cut, places) = within(&common, part, size);
        let (own, place) = (centre(part.width, part.height), places[0]);
        let half = centre(320, 241);
        let back = Common { rate: 0.5, ..common.clone() };
        for [x, y] in [[0.0, 0.0], [299.0, 13.0], [150.0, 200.0]] {
            let at = t.apply([x + 120.0, y + 60.0], whole);
            let there = cut.transforms[0].apply([x, y], own);
            let expected = [at[0] - f64::from(place.x), at[1] - f64::from(place.y)];
            assert!((0..2).all(|n| (there[n] - expected[n]).abs() < 1e-9), "{there:?} {expected:?}");
            assert!((bright(cut.brightness[0], there, own) - bright(common.brightness[0], at, whole)).abs() < 1e-9);
            let twice = doubled(&back, size);
            let small = back.transforms[0].apply([x, y], half);
            let large = twice.transforms[0].apply([2.0 * x, 2.0 * y], whole);
            assert!((0..2).all(|n| (large[n] - 2.0 * small[n]).abs() < 1e-9), "{large:?} {small:?}");
            assert!((bright(twice.brightness[0], large, whole) - bright(back.brightness[0], small, half)).abs() < 1e-9);
            assert_eq!(twice.rate, 2.0);
        }
    }
}
