//! Photographs too large for one solve: their parts, their half size, and the solve of a large pair.

use super::Engine;
use super::channels::ColorShift;
use super::filter::Filter;
use super::frame_in_flight::Start;
use super::plan::{Plan, halving_filter};
use super::prepared_solver::{PairOptions, PreparedSolver};
use super::solution::{self, Solution};
use super::stages::{Field, ingest, separable};
use crate::base::color::LUMINANCE;
use crate::base::{
    Decode, Error, Format, Frame, Homography, Method, Photometric, Progress, Region, Settings, Shading, Similarity,
    centre, workers,
};

/// The largest pair that is solved in parts: its results and photographs take some 8 GiB of the host.
pub(crate) const MOST_PIXELS: u64 = 1 << 28;
/// The margin of a part around its interior, px, in addition to the widest blur window. The smoothness term acts over
/// this distance.
const HALO: u32 = 48;
/// A further margin, as a share of the part's side. T that scales or rotates moves the borders of a part relative to
/// its centre.
const HALO_SHARE: f64 = 0.03;
/// The least side of a part, px: smaller ones are mostly halo.
const LEAST: u32 = 320;
/// The parts along one axis.
struct Axis {
    /// The length of each part, px.
    side: u32,
    /// Where each part begins.
    origins: Vec<u32>,
    /// Where the interior of each part begins, and where that of the last ends.
    borders: Vec<u32>,
}

impl Axis {
    /// Covers `whole` px by parts of `most` px at most that reach `halo` px beyond their interior. They begin at even
    /// places, since pixel i of the half-size image lies on pixel 2i.
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

/// The region of a part of a photograph.
#[derive(Clone, Copy, Debug)]
pub(super) struct PartRegion {
    /// What is solved.
    pub(super) solved: Region,
    /// The results that are kept.
    pub(super) interior: Region,
}

impl PartRegion {
    /// Copies the interior of a part into the full field of `width` px, `channels` values a pixel.
    pub(super) fn copy_interior<T: Copy>(&self, part: &[T], whole: &mut [T], width: usize, channels: usize) {
        let Self { solved, interior } = self;
        for y in interior.y..interior.y + interior.height {
            let from = (y - solved.y) as usize * solved.width as usize + (interior.x - solved.x) as usize;
            let to = y as usize * width + interior.x as usize;
            let count = channels * interior.width as usize;
            whole[channels * to..][..count].copy_from_slice(&part[channels * from..][..count]);
        }
    }
}

/// Parts that cover a photograph.
pub(super) struct Grid {
    axes: [Axis; 2],
}

impl Grid {
    /// Parts of `most` px a side at most that reach `halo` px beyond their interior.
    pub(super) fn covering(size: [u32; 2], most: u32, halo: u32) -> Self {
        Self { axes: size.map(|side| Axis::covering(side, most, halo)) }
    }

    /// Width and height of each part, px.
    pub(super) fn side(&self) -> [u32; 2] {
        self.axes.each_ref().map(|axis| axis.side)
    }

    /// The number of parts.
    pub(super) fn count(&self) -> usize {
        self.axes.iter().map(|axis| axis.origins.len()).product()
    }

    /// The parts, row by row.
    pub(super) fn parts(&self) -> impl Iterator<Item = PartRegion> {
        let [columns, rows] = self.axes.each_ref().map(|axis| axis.origins.len());
        (0..rows).flat_map(move |row| (0..columns).map(move |column| self.part([column, row])))
    }

    fn part(&self, place: [usize; 2]) -> PartRegion {
        let [x, y] = [0, 1].map(|n| self.axes[n].origins[place[n]]);
        let [left, top] = [0, 1].map(|n| self.axes[n].borders[place[n]]);
        let [right, bottom] = [0, 1].map(|n| self.axes[n].borders[place[n] + 1]);
        PartRegion {
            solved: Region { x, y, width: self.axes[0].side, height: self.axes[1].side },
            interior: Region { x: left, y: top, width: right - left, height: bottom - top },
        }
    }
}

/// The region of the other photograph for a part, centred where T maps the centre of the part, and T between the two.
pub(super) fn matching_region(t: &Homography, part: Region, size: [u32; 2]) -> (Region, Homography) {
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

/// T of photographs of this size, from T of the half-size photographs.
pub(super) fn doubled_transform(t: &Homography, size: [u32; 2]) -> Homography {
    let half = centre(size[0].div_ceil(2), size[1].div_ceil(2));
    t.scaled(2.0).about(half.map(|c| 2.0 * c), centre(size[0], size[1]))
}

/// T of half-size photographs, from T of the photographs of this size.
pub(super) fn halved_transform(t: &Homography, size: [u32; 2]) -> Homography {
    let half = centre(size[0].div_ceil(2), size[1].div_ceil(2));
    t.about(centre(size[0], size[1]), half.map(|c| 2.0 * c)).scaled(0.5)
}

/// Gain and shading of a region, from those of the photograph.
pub(super) fn shading_of_region(gain: f64, shading: &Shading, region: Region, size: [u32; 2]) -> (f64, Shading) {
    let (own, first, whole) = (centre(region.width, region.height), [region.x, region.y], centre(size[0], size[1]));
    restated(gain, shading, |at, n| (f64::from(first[n]) + own[n] * (1.0 + at) - whole[n]) / whole[n])
}

/// Gain and shading of photographs of a size, from those of photographs of half that size.
pub(super) fn doubled_shading(gain: f64, shading: &Shading, size: [u32; 2]) -> (f64, Shading) {
    let (half, whole) = (centre(size[0].div_ceil(2), size[1].div_ceil(2)), centre(size[0], size[1]));
    restated(gain, shading, |at, n| (0.5 * whole[n] * (1.0 + at) - half[n]) / half[n])
}

/// Gain and shading in other coordinates: `at` maps a place, -1 to 1 along axis n, to the old ones.
fn restated(gain: f64, shading: &Shading, at: impl Fn(f64, usize) -> f64) -> (f64, Shading) {
    let (mean, shading) = Shading::fit(|[x, y]| shading.at([at(x, 0), at(y, 1)]));
    (gain * mean, shading)
}

/// Rows of the half-size image that are computed at a time: 40 MB of a photograph that is 10,000 px wide.
const ROWS: u32 = 256;

/// Luminance at half the size, as a level of the pyramid has it.
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
        let luminance: Field = ingest::cpu_reference(&frame.cropped(strip).map_err(Error::Region)?, decode, LUMINANCE);
        let small = separable::filtered(&luminance, [&filter; 2], 2);
        let skipped = (rows.start - first / 2) as usize * small.width;
        Ok(small.data[skipped..][..rows.len() * small.width].iter().map(|&v| v as f32).collect::<Vec<f32>>())
    };
    let strips: Result<Vec<Vec<f32>>, Error> =
        workers::map(half[1].div_ceil(ROWS) as usize, strip).into_iter().collect();
    Frame::gray(half[0], half[1], strips?.concat()).map_err(Error::Mismatch)
}

impl Engine {
    /// Plans a pair. Returns `None` if it is too large for one solve, and can be solved in parts.
    pub(crate) fn plan_whole(
        &self,
        size: [u32; 2],
        formats: [Format; 2],
        settings: &Settings,
    ) -> Result<Option<Plan>, Error> {
        match self.plan_pair(size, formats, settings) {
            Err(Error::TooLarge { .. }) if u64::from(size[0]) * u64::from(size[1]) <= MOST_PIXELS => Ok(None),
            other => other.map(Some),
        }
    }

    /// Plans a pair that fits one solve.
    fn plan_pair(&self, size: [u32; 2], formats: [Format; 2], settings: &Settings) -> Result<Plan, Error> {
        let plan = Plan::new(size[0], size[1], formats, settings)?.for_device(self.info());
        self.admits(&plan, 1).map(|()| plan)
    }
}

/// Solves a pair in parts: T, gain, offset and shading at half its size, or a quarter, where all of the frame is seen,
/// then V part by part at full size with these held. The engine's time limit is that of each part.
///
/// # Errors
/// As [`PairSolver::solve`](crate::PairSolver::solve); [`Error::TooLarge`] if the device does not hold a part
/// either.
pub(crate) fn solve_pair(
    engine: &Engine,
    [i1, i2]: [&Frame; 2],
    settings: &Settings,
    options: PairOptions<'_>,
) -> Result<Solution, Error> {
    let (size, formats) = ([i1.width(), i1.height()], [i1.format(), i2.format()]);
    let settings = &Settings { decode: settings.decode.resolved(formats.map(|f| f.depth)), ..settings.clone() };
    let mut whole = solve_at_half_size(engine, [i1, i2], settings, options).map_err(|error| match error {
        // The pair is too narrow to be halved: the error states why the device does not hold the whole.
        Error::TooSmall { .. } => engine.plan_pair(size, formats, settings).err().unwrap_or(error),
        other => other,
    })?;
    // Parts overlap by the reach of the widest blur: that of V at half the size, with room for what is seen there less.
    let side = f64::from(size[0]) / f64::from(whole.width);
    let widest = whole.relative_blur.iter().fold(0.0f32, |most, v| most.max(v.abs()));
    // At least the usual one, which most pairs stay below, unless the caller states less.
    let limit = (1.2 * side * side * f64::from(widest)).max(Settings::USUAL_BLUR).min(settings.blur_limit());
    let max_relative_blur = Some(limit);
    let own = Settings { method: Method::Aligned, photometric: false, max_relative_blur, ..settings.clone() };
    let grid = grid(engine, size, formats, &own)?;
    let mut solver = PreparedSolver::new(engine, grid.side(), formats, &own, 1, None, engine.reading())?;
    empty(&mut whole, size);
    let (all, mut alpha, mut unsettled, mut scale) = (grid.count(), 0.0, 0.0, 0.0);
    for (n, part) in grid.parts().enumerate() {
        let (region, transform) = matching_region(&whole.transform, part.solved, size);
        let (gain, shading) = shading_of_region(whole.photometric.gain, &whole.shading, region, size);
        let photometric = Photometric { gain, ..whole.photometric };
        let kernel_shape = whole.kernel_shape.unwrap_or(0.0);
        let separation = whole.separation.unwrap_or(0.0);
        let parallax = whole.parallax.about(centre(size[0], size[1]), part.solved.centre());
        let start = Some(Start { transform, photometric, shading, kernel_shape, separation, parallax });
        let mask = options.mask.map(|mask| mask.cropped(part.solved));
        let cropped = |frame: &Frame, region| frame.cropped(region).map_err(Error::Region);
        let (a, b) = (cropped(i1, part.solved)?, cropped(i2, region)?);
        let own = PairOptions { mask: mask.as_ref(), progress: &|_| (), start, ..options };
        let solved = solver.solve([&a, &b], own)?.wait()?.to_owned();
        alpha += solved.regularization / all as f64;
        unsettled += solved.unsettled_fraction / all as f64;
        scale += solved.scale_deviation / all as f64;
        copy_interior(&mut whole, &solved, part);
        (options.progress)(Progress::of_steps(n + 1, all));
    }
    (whole.regularization, whole.unsettled_fraction) = (alpha, unsettled);
    whole.add_scale(scale);
    if let Some(shift) = whole.color_shift {
        whole.widen(|_| shift.included as f32);
    }
    whole.max_relative_blur = limit;
    whole.recount();
    whole.findings.warnings.extend(whole.findings.saturation());
    whole.findings.warnings.extend(whole.findings.unexplained_warning());
    Ok(whole)
}

/// Copies the interior of a part into the whole, with the standard deviation of V without that of V's scale.
fn copy_interior(whole: &mut Solution, solved: &Solution, part: PartRegion) {
    let width = whole.width as usize;
    part.copy_interior(&solved.relative_blur, &mut whole.relative_blur, width, 1);
    part.copy_interior(&solved.uncertainty_without_scale(), &mut whole.uncertainty, width, 1);
    part.copy_interior(&solved.residual, &mut whole.residual, width, 1);
    whole.fused_channels = solved.fused_channels;
    if !solved.fused.is_empty() {
        let channels = solved.fused_channels.count() as usize;
        whole.fused.resize(channels * whole.relative_blur.len(), 0.0);
        part.copy_interior(&solved.fused, &mut whole.fused, width, channels);
    }
    whole.timings.gpu_ms += solved.timings.gpu_ms;
    whole.timings.total_ms += solved.timings.total_ms;
}

/// The largest parts that the device holds.
fn grid(engine: &Engine, size: [u32; 2], formats: [Format; 2], settings: &Settings) -> Result<Grid, Error> {
    let plan = Plan::new(size[0], size[1], formats, settings)?.for_device(engine.info());
    let (on_device, host) = plan.bytes();
    let share = engine.memory() as f64 / (on_device + host) as f64;
    let sides = (share * f64::from(size[0]) * f64::from(size[1])).sqrt().min(engine.info().max_image_size.into());
    let mut most = (sides as u32).max(LEAST);
    loop {
        let halo = HALO + (3.0 * settings.blur_limit().sqrt() + HALO_SHARE * f64::from(most)).ceil() as u32;
        let grid = Grid::covering(size, most, halo);
        match engine.plan_pair(grid.side(), formats, settings) {
            Err(Error::TooLarge { .. }) if most > LEAST => most = (most * 7 / 8).max(LEAST),
            other => return other.map(|_| grid),
        }
    }
}

/// Solves the pair at half its size, or halved until the device holds it. T and brightness are stated for full-size
/// pixels; the fields have the halved size.
fn solve_at_half_size(
    engine: &Engine,
    frames: [&Frame; 2],
    settings: &Settings,
    options: PairOptions<'_>,
) -> Result<Solution, Error> {
    let depth = frames[0].format().depth;
    let mut settings = Settings { fused: false, levels: None, ..settings.clone() };
    [settings.black_level, settings.white_level] = clipping_intensities(settings.clipped(depth), settings.decode);
    let (mut sizes, mut halves) = (Vec::new(), None);
    let ([i1, i2], plan) = loop {
        let [i1, i2] = halves.as_ref().map_or(frames, |[i1, i2]: &[Frame; 2]| [i1, i2]);
        let size = [i1.width(), i1.height()];
        let small = [halved(i1, settings.decode)?, halved(i2, settings.decode)?];
        sizes.push(size);
        settings.decode = Decode::None;
        settings.max_relative_blur = Some((settings.blur_limit() / 4.0).max(1.0));
        settings.start = halved_transform(&settings.start, size);
        let (side, formats) = ([small[0].width(), small[0].height()], small.each_ref().map(Frame::format));
        if let Some(plan) = engine.plan_whole(side, formats, &settings)? {
            break (small, plan);
        }
        halves = Some(small);
    };
    let mask = options.mask.map(|mask| mask.subsampled(1 << sizes.len()));
    let options = PairOptions { mask: mask.as_ref(), progress: &|_| (), ..options };
    let mut solver = PreparedSolver::of_plan_for(engine, [&i1, &i2], plan)?;
    let mut solution = solver.solve([&i1, &i2], options)?.wait()?.to_owned();
    // Pixels at the limit of |V| at half the size need not be at the full one, and V is another.
    let colors = |solution: &Solution| solution.color_shift.and_then(|shift| shift.warning());
    let restated = [solution.saturation(), colors(&solution)];
    solution.warnings.retain(|warning| !restated.iter().flatten().any(|restated| restated == warning));
    for &size in sizes.iter().rev() {
        solution.transform = doubled_transform(&solution.transform, size);
        (solution.photometric.gain, solution.shading) =
            doubled_shading(solution.photometric.gain, &solution.shading, size);
        solution.separation = solution.separation.map(|separation| 4.0 * separation);
        solution.color_shift = solution.color_shift.map(ColorShift::doubled);
        solution.parallax = solution.parallax.doubled();
        solution.parallax_deviation = solution.parallax_deviation.doubled();
        solution.transform_deviation.iter_mut().for_each(|deviation| deviation.corner_px *= 2.0);
        solution.other_motion.iter_mut().for_each(|other| other.corner_px *= 2.0);
    }
    let colors = colors(&solution);
    solution.warnings.extend(colors);
    Ok(solution)
}

/// Stored levels at which pixels are clipped, as intensities: pixels of the half-size image hold those.
fn clipping_intensities(levels: [f32; 2], decode: Decode) -> [Option<f64>; 2] {
    let of = |level: f32| decode.intensity(level.into());
    levels.map(|level| level.is_finite().then(|| of(level)))
}

/// Replaces the fields by full-size ones without results.
fn empty(solution: &mut Solution, [width, height]: [u32; 2]) {
    let pixels = width as usize * height as usize;
    (solution.width, solution.height, solution.origin) = (width, height, [0, 0]);
    solution.photograph = [width, height];
    solution.solved = Region { x: 0, y: 0, width, height };
    solution.relative_blur = vec![f32::NAN; pixels];
    solution.uncertainty = vec![f32::NAN; pixels];
    solution.confidence = vec![solution::confidence(f32::NAN); pixels];
    solution.residual = vec![f32::NAN; pixels];
    solution.fused = Vec::new();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_the_whole_and_reach_beyond_their_interior() {
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
    fn transform_and_shading_of_a_part_agree_with_those_of_the_whole() {
        let (size, part) = ([640, 481], Region { x: 120, y: 60, width: 300, height: 201 });
        let t = Homography::from(Similarity { scale: 1.02, rotation: 0.01, tx: 5.0, ty: -7.0 });
        let mut shading = Shading::NONE;
        shading.coefficients = std::array::from_fn(|n| 0.03 * (1.3 * n as f64).cos());
        let whole = centre(size[0], size[1]);
        let bright = |(gain, shading): (f64, Shading), at: [f64; 2], c: [f64; 2]| {
            gain * shading.at([(at[0] - c[0]) / c[0], (at[1] - c[1]) / c[1]])
        };
        let (region, moved) = matching_region(&t, part, size);
        let (own, half) = (centre(part.width, part.height), centre(320, 241));
        for [x, y] in [[0.0, 0.0], [299.0, 13.0], [150.0, 200.0]] {
            let at = t.apply([x + 120.0, y + 60.0], whole);
            let there = moved.apply([x, y], own);
            let expected = [at[0] - f64::from(region.x), at[1] - f64::from(region.y)];
            assert!((0..2).all(|n| (there[n] - expected[n]).abs() < 1e-9), "{there:?} {expected:?}");
            let within = bright(shading_of_region(1.1, &shading, region, size), there, own);
            assert!((within - bright((1.1, shading), at, whole)).abs() < 1e-9);
            let small = t.apply([x, y], half);
            let large = doubled_transform(&t, size).apply([2.0 * x, 2.0 * y], whole);
            assert!((0..2).all(|n| (large[n] - 2.0 * small[n]).abs() < 1e-9), "{large:?} {small:?}");
            let back = halved_transform(&doubled_transform(&t, size), size).apply([x, y], half);
            assert!((0..2).all(|n| (back[n] - small[n]).abs() < 1e-9), "{back:?} {small:?}");
            let twice = bright(doubled_shading(1.1, &shading, size), large, whole);
            assert!((twice - bright((1.1, shading), small, half)).abs() < 1e-9);
        }
    }

    #[test]
    fn halving_in_strips_agrees_with_halving_at_once() {
        let (width, height) = (37, 2 * ROWS + 71);
        let values = (0..width * height).map(|i| ((i * 7919) % 251) as f32 / 251.0).collect();
        let frame = Frame::gray(width, height, values).unwrap();
        let filter: Filter = halving_filter();
        let luminance: Field = ingest::cpu_reference(&frame, Decode::None, LUMINANCE);
        let whole = separable::filtered(&luminance, [&filter; 2], 2);
        let found = halved(&frame, Decode::None).unwrap();
        assert_eq!([found.width(), found.height()], [19, ROWS + 36]);
        let found = found.intensities(Decode::None);
        assert!(found.iter().zip(&whole.data).all(|(found, whole)| (f64::from(*found) - whole).abs() < 1e-6));
    }
}
