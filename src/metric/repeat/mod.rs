//! Repeated measurements: noise of height maps of one unmoved part, and gauge studies of single values.

mod chance;
mod gauge;

use super::heights::Heights;
use super::roughness::{Area, Form, without_form};
use crate::base::{Error, Estimate, workers};

pub use chance::Interval;
pub use gauge::{AnovaRow, COMPONENTS, Component, GaugeStudy, LEAST_READINGS, POOLING, Repeatability, Study, TypeOne};

/// The least number of pixels that all maps measure.
const LEAST_PIXELS: usize = 256;
/// The most maps: pairs grow by their square.
pub const MOST_MAPS: usize = 200;
/// Tiles along each side of the measured pixels, between which standard errors find the scatter.
const TILES: usize = 8;
/// The least number of tiles with pixels for a standard error.
const LEAST_TILES: usize = 8;
/// The bins of a histogram of differences, within ±4 standard deviations.
pub const BINS: usize = 32;
/// The end of the histogram, standard deviations.
pub const HISTOGRAM_END: f64 = 4.0;
/// The factor of the repeatability limit: two measurements differ by less in 95 of 100 cases (ISO 5725-6).
const LIMIT: f64 = 2.8;

/// The difference of two maps.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct PairNoise {
    /// Index of the first map.
    pub first: usize,
    /// Index of the second map.
    pub second: usize,
    /// Measurement noise: Sq of the difference over √2.
    pub noise: Estimate,
    /// The mean of the second map less that of the first.
    pub shift: f64,
    /// The root mean square of the differences over their stated standard deviations.
    pub seen_over_stated: Estimate,
}

/// The noise of repeated height maps of one unmoved part. A standard error is NaN if too few tiles have pixels.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct RepeatedMaps {
    /// Number of pixels of the area.
    pub area_px: usize,
    /// Number of them that all maps measure, over which all values are.
    pub measured_px: usize,
    /// Measurement noise of a map (ISO 25178-700): the root mean square over pixels of the standard deviation between
    /// maps. With two maps it is Sq of their difference over √2.
    pub noise: Estimate,
    /// The median, the least and the greatest noise of a pair of maps.
    pub pair_noise: [f64; 3],
    /// What two measurements of a pixel differ by in 95 of 100 cases at most, apart from a shift of the mean height:
    /// 2.8 times the noise.
    pub repeatability_limit: Estimate,
    /// The standard deviation of the mean height between maps.
    pub shift_deviation: Interval,
    /// The root mean square of the stated standard deviations.
    pub stated: f64,
    /// The root mean square of the differences over their stated standard deviations: 1 if these are right.
    pub seen_over_stated: Estimate,
    /// The share of the differences within 1 and 2 of their stated standard deviations: 0.683 and 0.954 if these are
    /// right and the differences Gaussian.
    pub within: [Estimate; 2],
    /// The pairs of maps.
    pub pairs: Vec<PairNoise>,
    /// The shares of the differences in [`BINS`] bins of their stated standard deviations from -[`HISTOGRAM_END`] to
    /// [`HISTOGRAM_END`].
    pub histogram: Vec<f64>,
}

/// The number of sums of a tile.
const SUMS: usize = 4;

/// The sums of a tile: its pixels, and those of the variance between maps, of the squared ratio to the stated standard
/// deviation, and of the shares within 1 and 2.
#[derive(Clone, Copy, Default)]
struct Tile {
    count: f64,
    sums: [f64; SUMS],
}

/// Compares repeated height maps of one unmoved part.
///
/// The mean of each map is subtracted. With [`Form::Plane`] or [`Form::Quadric`] the form of its difference from the
/// first map is subtracted too, so that neither a shift nor a drift counts as noise.
///
/// Standard errors are by the scatter between 64 tiles of the rectangle around the pixels that all maps measure: they
/// allow for noise that is alike at adjacent pixels, up to those of the next tile. Where noise differs from place to
/// place they are too wide. With fewer than 8 tiles that have pixels they are NaN.
///
/// # Errors
/// [`Error::Mismatch`] for fewer than two or more than [`MOST_MAPS`] maps, for maps of different sizes, and for
/// [`Form::Cylinder`]; [`Error::Region`] if the area leaves the maps, or too few pixels are measured by all.
pub fn repeated_maps(maps: &[Heights], area: &Area<'_>, form: Form) -> Result<RepeatedMaps, Error> {
    let size = common_size(maps, form)?;
    area.region.check((size[0], size[1]))?;
    let cut = |field: &[f32]| -> Vec<f64> {
        area.region.crop(field, size[0] as usize, 1).into_iter().map(f64::from).collect()
    };
    let (inside, area_px) = area.inside(size)?;
    let mut heights: Vec<Vec<f64>> = maps.iter().map(|map| cut(&map.values)).collect();
    let is_common: Vec<bool> =
        inside.iter().enumerate().map(|(i, inside)| *inside && heights.iter().all(|map| map[i].is_finite())).collect();
    let measured_px = is_common.iter().filter(|common| **common).count();
    if measured_px < LEAST_PIXELS {
        let own = |map: &Vec<f64>| inside.iter().zip(map).filter(|(inside, z)| **inside && z.is_finite()).count();
        let (least, which) = (1..).zip(&heights).map(|(n, map)| (own(map), n)).min().unwrap_or_default();
        return Err(Error::Region(format!(
            "only {measured_px} of the area's {area_px} pixels are measured in all results, and {least} in result \
             {which}: give a larger area, or leave out a result"
        )));
    }
    let width = area.region.width as usize;
    let reference = heights[0].clone();
    let mut shifts = Vec::new();
    for map in &mut heights {
        for (i, z) in map.iter_mut().enumerate() {
            *z = if is_common[i] { *z - reference[i] } else { f64::NAN };
        }
        shifts.push(mean(map));
        *map = without_form(width, std::mem::take(map), form)?;
        let level = mean(map);
        map.iter_mut().for_each(|z| *z -= level);
    }
    let variances: Vec<Vec<f64>> =
        maps.iter().map(|map| cut(&map.deviation).into_iter().map(|sigma| sigma * sigma).collect()).collect();
    let common: Vec<usize> = (0..is_common.len()).filter(|i| is_common[*i]).collect();
    let tiles = tiles_of(&common, width);
    let compared = Compared { heights: &heights, variances: &variances, pixels: &common, tiles: &tiles };
    let stated_variance = variances.iter().map(|map| common.iter().map(|i| map[*i]).sum::<f64>()).sum::<f64>()
        / (maps.len() * measured_px) as f64;
    let (tiles, histogram) = compared.sums();
    let estimates: [Estimate; SUMS] = std::array::from_fn(|n| ratio_of_sums(&tiles, n));
    let indices: Vec<[usize; 2]> = (1..maps.len()).flat_map(|j| (0..j).map(move |i| [i, j])).collect();
    let pairs = workers::map(indices.len(), |n| compared.pair(indices[n], &shifts));
    let mut sorted: Vec<f64> = pairs.iter().map(|pair| pair.noise.value).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]) / 2.0;
    let noise = root(estimates[0]);
    let shift_deviation = Repeatability::of(&shifts).map(|found| found.standard_deviation);
    let nowhere = Interval { value: f64::NAN, low: f64::NAN, high: f64::NAN };
    Ok(RepeatedMaps {
        area_px,
        measured_px,
        noise,
        pair_noise: [middle, sorted[0], sorted[sorted.len() - 1]],
        repeatability_limit: Estimate { value: LIMIT * noise.value, standard_error: LIMIT * noise.standard_error },
        shift_deviation: shift_deviation.unwrap_or(nowhere),
        stated: stated_variance.sqrt(),
        seen_over_stated: root(estimates[1]),
        within: [estimates[2], estimates[3]],
        pairs,
        histogram,
    })
}

/// Returns the size of all maps, if they can be compared.
fn common_size(maps: &[Heights], form: Form) -> Result<[u32; 2], Error> {
    let refused = |problem: String| Err(Error::Mismatch(problem));
    let Some(first) = maps.first().filter(|_| (2..=MOST_MAPS).contains(&maps.len())) else {
        return refused(format!("{} results cannot be compared: give 2 to {MOST_MAPS}", maps.len()));
    };
    if form == Form::Cylinder {
        return refused("the difference of two results has no cylinder: give none, plane or quadric".to_string());
    }
    let size = [first.width, first.height];
    if maps.iter().any(|map| [map.width, map.height] != size) {
        return refused("the results have different sizes: solve the same part".to_string());
    }
    Ok(size)
}

/// Levelled maps, the variances that they state, and the pixels that all measure.
struct Compared<'a> {
    heights: &'a [Vec<f64>],
    variances: &'a [Vec<f64>],
    pixels: &'a [usize],
    /// The tile of each of these pixels.
    tiles: &'a [usize],
}

/// Returns the tile of each pixel, in the rectangle around all.
fn tiles_of(pixels: &[usize], width: usize) -> Vec<usize> {
    let along = |of: &dyn Fn(usize) -> usize| {
        let all = || pixels.iter().map(|i| of(*i));
        let (first, last) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
        all().map(|at| (at - first) * TILES / (last - first + 1)).collect::<Vec<_>>()
    };
    let (columns, rows) = (along(&|i| i % width), along(&|i| i / width));
    columns.iter().zip(rows).map(|(column, row)| row * TILES + column).collect()
}

impl Compared<'_> {
    /// Returns the sums of each tile, and the shares of the differences in the bins of the histogram.
    fn sums(&self) -> (Vec<Tile>, Vec<f64>) {
        let (mut tiles, mut bins) = (vec![Tile::default(); TILES * TILES], vec![0.0; BINS]);
        let (maps, mut differences) = (self.heights.len(), 0.0);
        for (&i, &tile) in self.pixels.iter().zip(self.tiles) {
            let tile = &mut tiles[tile];
            tile.count += 1.0;
            let each = 2.0 / (maps * (maps - 1)) as f64;
            for (a, b) in (1..maps).flat_map(|b| (0..b).map(move |a| (a, b))) {
                let off = self.heights[b][i] - self.heights[a][i];
                let sigmas = in_deviations(off, self.variances[a][i] + self.variances[b][i]);
                let within = |most: f64| if sigmas.abs() <= most { 1.0 } else { 0.0 };
                let terms = [off * off / 2.0, sigmas * sigmas, within(1.0), within(2.0)];
                tile.sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += each * term);
                let bin = (sigmas + HISTOGRAM_END) / (2.0 * HISTOGRAM_END) * BINS as f64;
                if (0.0..BINS as f64).contains(&bin) {
                    bins[bin as usize] += 1.0;
                }
                differences += 1.0;
            }
        }
        bins.iter_mut().for_each(|bin| *bin /= differences);
        (tiles, bins)
    }

    fn pair(&self, [first, second]: [usize; 2], shifts: &[f64]) -> PairNoise {
        let mut tiles = vec![Tile::default(); TILES * TILES];
        for (&i, &tile) in self.pixels.iter().zip(self.tiles) {
            let off = self.heights[second][i] - self.heights[first][i];
            tiles[tile].count += 1.0;
            tiles[tile].sums[0] += off * off / 2.0;
            tiles[tile].sums[1] += in_deviations(off, self.variances[first][i] + self.variances[second][i]).powi(2);
        }
        let [noise, seen_over_stated] = [0, 1].map(|n| root(ratio_of_sums(&tiles, n)));
        PairNoise { first, second, noise, shift: shifts[second] - shifts[first], seen_over_stated }
    }
}

/// Returns a difference in standard deviations: 0 for none, infinite for a difference that should not be.
fn in_deviations(off: f64, variance: f64) -> f64 {
    if off == 0.0 { 0.0 } else { off / variance.sqrt() }
}

/// Returns the mean of the finite values.
fn mean(values: &[f64]) -> f64 {
    let (sum, count) = values.iter().filter(|z| z.is_finite()).fold((0.0, 0.0), |(sum, n), z| (sum + z, n + 1.0));
    sum / count
}

/// Returns a sum over all pixels per pixel. Its standard error is by the scatter between tiles: the ratio estimator
/// (Cochran 1977, *Sampling Techniques*, 6.3), with the products of adjacent tiles if they add to it, since noise may
/// be alike across the edge of a tile. It is NaN for too few tiles.
fn ratio_of_sums(tiles: &[Tile], n: usize) -> Estimate {
    let filled: Vec<&Tile> = tiles.iter().filter(|tile| tile.count > 0.0).collect();
    let count = filled.iter().map(|tile| tile.count).sum::<f64>();
    let value = filled.iter().map(|tile| tile.sums[n]).sum::<f64>() / count;
    let off = |tile: usize| tiles[tile].sums[n] - value * tiles[tile].count;
    let scatter = (0..tiles.len()).map(|tile| off(tile).powi(2)).sum::<f64>();
    let beside = |tile: &usize| tile % TILES + 1 < TILES;
    let right = (0..tiles.len()).filter(beside).map(|tile| off(tile) * off(tile + 1)).sum::<f64>();
    let below = (TILES..tiles.len()).map(|tile| off(tile - TILES) * off(tile)).sum::<f64>();
    let scatter = scatter + 2.0 * (right + below).max(0.0);
    let many = filled.len() as f64;
    let standard_error = (scatter * many / (many - 1.0)).sqrt() / count;
    Estimate { value, standard_error: if filled.len() < LEAST_TILES { f64::NAN } else { standard_error } }
}

fn root(of: Estimate) -> Estimate {
    let value = of.value.sqrt();
    Estimate { value, standard_error: if value > 0.0 { of.standard_error / (2.0 * value) } else { of.standard_error } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::statistics::tests::smooth_noise;
    use crate::base::{Frame, Mask, Region};

    const SIZE: [u32; 2] = [96, 80];
    const WHOLE: Region = Region { x: 0, y: 0, width: 96, height: 80 };

    /// Maps of a relief with noise of this deviation over a window, shifted by `n` and tilted by `tilt * n`.
    fn maps(count: u64, noise: f64, stated: f32, window: f64, tilt: f64) -> Vec<Heights> {
        let map = |n: u64| {
            let noises = smooth_noise([96, 80], window, 40 + n);
            let values: Vec<f32> = (0..96 * 80)
                .map(|i| {
                    let (x, y) = ((i % 96) as f64, (i / 96) as f64);
                    let relief = (0.3 * x).sin() + 0.2 * (0.1 * y).cos();
                    (relief + n as f64 + tilt * n as f64 * (x - 47.5) + noise * noises[i]) as f32
                })
                .collect();
            Heights::new(SIZE, &values, &vec![stated; values.len()]).unwrap()
        };
        (0..count).map(map).collect()
    }

    fn scale(window: f64) -> f64 {
        let noise = smooth_noise([96, 80], window, 1);
        (noise.iter().map(|v| v * v).sum::<f64>() / noise.len() as f64).sqrt()
    }

    fn compared(maps: &[Heights], form: Form) -> RepeatedMaps {
        repeated_maps(maps, &Area { region: WHOLE, mask: None }, form).unwrap()
    }

    #[test]
    fn noise_of_known_deviation_is_found_with_its_standard_error() {
        for (window, count) in [(0.5, 2), (2.0, 2), (2.0, 6)] {
            let sigma = 0.05;
            let found = compared(&maps(count, sigma / scale(window), 0.05, window, 0.0), Form::None);
            println!("window {window}, {count} maps: {:?} {:?}", found.noise, found.seen_over_stated);
            let off = (found.noise.value - sigma).abs();
            assert!(off < 3.0 * found.noise.standard_error.hypot(0.05 * sigma), "{:?}", found.noise);
            assert!((0.002..0.2).contains(&(found.noise.standard_error / sigma)), "{:?}", found.noise);
            assert!((found.seen_over_stated.value - 1.0).abs() < 0.15);
            assert!((found.within[0].value - 0.683).abs() < 0.08 && (found.within[1].value - 0.954).abs() < 0.05);
            // The maps are 1 apart.
            assert!(found.pairs.iter().all(|pair| (pair.shift - (pair.second - pair.first) as f64).abs() < 0.05));
            let [middle, least, most] = found.pair_noise;
            assert!(least <= middle && middle <= most && found.pairs.len() as u64 == count * (count - 1) / 2);
            // The variance between maps is the mean of those of the pairs.
            let mean = found.pairs.iter().map(|pair| pair.noise.value.powi(2)).sum::<f64>() / found.pairs.len() as f64;
            assert!((mean.sqrt() - found.noise.value).abs() < 1e-9);
            assert!((found.histogram.iter().sum::<f64>() - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn stated_deviations_that_are_wrong_are_seen() {
        for (stated, ratio) in [(0.1, 0.5), (0.025, 2.0)] {
            let found = compared(&maps(3, 0.05 / scale(0.5), stated, 0.5, 0.0), Form::None);
            assert!((found.seen_over_stated.value - ratio).abs() < 0.1 * ratio, "{:?}", found.seen_over_stated);
            assert!((found.stated - f64::from(stated)).abs() < 1e-6);
        }
    }

    #[test]
    fn a_drift_of_the_tilt_is_no_noise_without_its_plane() {
        let drifting = maps(2, 0.05 / scale(0.5), 0.05, 0.5, 0.01);
        let [with, without] = [Form::None, Form::Plane].map(|form| compared(&drifting, form).noise.value);
        // A tilt of 0.01 over 96 px has a standard deviation of 0.277.
        assert!((with - (0.05f64.powi(2) + 0.277f64.powi(2) / 2.0).sqrt()).abs() < 0.01, "{with}");
        assert!((without - 0.05).abs() < 0.004, "{without}");
    }

    #[test]
    fn only_pixels_that_all_measure_count() {
        let mut holes = maps(2, 0.05, 0.05, 0.5, 0.0);
        holes[0].values[..960].fill(f32::NAN);
        holes[1].values[960..1920].fill(f32::NAN);
        let found = compared(&holes, Form::None);
        assert_eq!((found.area_px, found.measured_px), (7680, 5760));
        let upper = (0..7680).map(|i| f32::from(u8::from(i < 2880))).collect();
        let mask = Mask::from_image(&Frame::gray(96, 80, upper).unwrap());
        let found = repeated_maps(&holes, &Area { region: WHOLE, mask: Some(&mask) }, Form::None).unwrap();
        assert_eq!((found.area_px, found.measured_px), (2880, 960));
    }

    #[test]
    fn a_small_mask_has_tiles_and_a_line_of_pixels_has_too_few() {
        let two = maps(2, 0.05 / scale(0.5), 0.05, 0.5, 0.0);
        // 256 pixels that lie in one or two tiles of the whole area.
        let of = |inside: &dyn Fn(usize, usize) -> bool| {
            let marked = (0..7680).map(|i| f32::from(u8::from(inside(i % 96, i / 96)))).collect();
            let mask = Mask::from_image(&Frame::gray(96, 80, marked).unwrap());
            repeated_maps(&two, &Area { region: WHOLE, mask: Some(&mask) }, Form::None)
        };
        let found = of(&|x, y| x < 16 && y < 16).unwrap();
        for (of, value) in [(found.noise, 0.05), (found.repeatability_limit, 0.14), (found.pairs[0].noise, 0.05)] {
            let error = of.standard_error / value;
            assert!((of.value / value - 1.0).abs() < 0.2 && (0.01..0.15).contains(&error), "{of:?}");
        }
        // Pixels in four corners fill four tiles.
        let corner = |at: usize, size: usize| at < 9 || at + 9 >= size;
        let found = of(&|x, y| corner(x, 96) && corner(y, 80)).unwrap();
        assert!(found.noise.value > 0.04 && found.noise.standard_error.is_nan(), "{:?}", found.noise);
        assert!(found.repeatability_limit.standard_error.is_nan());
        let refused = of(&|x, y| x < 15 && y < 15).unwrap_err().to_string();
        assert!(refused.contains("225 in result 1"), "{refused}");
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let two = maps(2, 0.05, 0.05, 0.5, 0.0);
        let area = Area { region: WHOLE, mask: None };
        let small = Heights::new([4, 4], &[0.0; 16], &[0.1; 16]).unwrap();
        for (maps, form, part) in [
            (&two[..1], Form::None, "1 results"),
            (&two, Form::Cylinder, "cylinder"),
            (&[two[0].clone(), small], Form::None, "different sizes"),
        ] {
            let refused = repeated_maps(maps, &area, form).unwrap_err().to_string();
            assert!(refused.contains(part), "{refused}");
        }
        let corner = Region { x: 0, y: 0, width: 8, height: 8 };
        assert!(repeated_maps(&two, &Area { region: corner, mask: None }, Form::None).is_err());
    }
}
