//! A pair too large for one solve: T, gain, offset and shading are found at half its size, or a quarter, where all of the frame is seen, and V part
//! by part at full size, where they stay.

use super::frame_in_flight::Start;
use super::parts::{self, Grid, Part};
use super::plan::Plan;
use super::solution::{self, Counts, Solution};
use super::{Engine, PairSolver, Progress};
use crate::base::color::srgb_to_linear;
use crate::base::{CancellationToken, Decode, Error, Format, Frame, Mask, Method, Photometric, Region, Settings};

/// The largest pair that is solved in parts: its results and photographs take some 8 GiB of the host.
pub(crate) const MOST_PIXELS: u64 = 1 << 28;
/// Px that a part reaches beyond what is taken of it, besides the widest window of blur: so far smoothness is felt.
const HALO: u32 = 48;
/// The same as a share of its side: T that scales or turns moves the borders of a part against its middle.
const HALO_SHARE: f64 = 0.03;
/// The least side of a part, px: of smaller ones most is halo.
const LEAST: u32 = 320;

impl Engine {
    /// Whether a pair is too large for one solve, and can be solved in parts.
    pub(crate) fn needs_parts(&self, size: [u32; 2], formats: [Format; 2], settings: &Settings) -> Result<bool, Error> {
        let plan = Plan::new(size[0], size[1], formats, settings)?;
        match self.admits(&plan, 1) {
            Err(Error::TooLarge { .. }) if u64::from(size[0]) * u64::from(size[1]) <= MOST_PIXELS => Ok(true),
            other => other.map(|()| false),
        }
    }
}

/// Solves a pair in parts.
///
/// # Errors
/// As [`PairSolver::solve`]; [`Error::TooLarge`] where the device does not hold a part either.
pub(crate) fn solve(
    engine: &Engine,
    [i1, i2]: [&Frame; 2],
    settings: &Settings,
    mask: Option<&Mask>,
    cancel: &CancellationToken,
    progress: &mut dyn FnMut(Progress),
) -> Result<Solution, Error> {
    let (size, formats) = ([i1.width(), i1.height()], [i1.format(), i2.format()]);
    let settings = &Settings { decode: settings.decode.resolved(formats.map(|f| f.depth)), ..settings.clone() };
    let grid = grid(engine, size, formats, settings)?;
    let mut whole = at_half_size(engine, [i1, i2], settings, mask, cancel).map_err(|error| match error {
        // Too long and too narrow to be halved: what the device said of the whole.
        Error::TooSmall { .. } => refusal(engine, size, formats, settings).unwrap_or(error),
        other => other,
    })?;
    let own = Settings { method: Method::Aligned, photometric: false, ..settings.clone() };
    let mut solver = PairSolver::with_slots(1, engine, grid.side(), formats, &own)?;
    solver.set_cancel(cancel.clone());
    empty(&mut whole, size);
    let (all, mut alpha) = (grid.count(), 0.0);
    for (n, part) in grid.parts().enumerate() {
        let (place, transform) = parts::cut(&whole.transform, part.solved, size);
        let (gain, shading) = parts::shading_within(whole.photometric.gain, &whole.shading, place, size);
        let photometric = Photometric { gain, ..whole.photometric };
        let kernel_shape = whole.kernel_shape.unwrap_or(0.0);
        solver.start_from(Start { transform, photometric, shading, kernel_shape });
        solver.set_mask(mask.map(|mask| mask.cropped(part.solved)))?;
        let cropped = |frame: &Frame, region| frame.cropped(region).map_err(Error::Region);
        let solved = solver.solve(&cropped(i1, part.solved)?, &cropped(i2, place)?)?;
        alpha += solved.regularization / all as f64;
        take_over(&mut whole, &solved, part);
        let pixels = whole.relative_blur.len() as u64;
        progress(Progress {
            done: n as u32 + 1,
            levels: all as u32,
            pixels_done: pixels * (n as u64 + 1) / all as u64,
            pixels,
            width: grid.side()[0],
            height: grid.side()[1],
        });
    }
    whole.regularization = alpha;
    let counts = Counts::of(&whole.relative_blur, &whole.uncertainty, settings.max_relative_blur);
    whole.findings.tell(&counts);
    whole.findings.warnings.extend(whole.findings.saturation(settings.max_relative_blur));
    Ok(whole)
}

/// What is taken of a part.
fn take_over(whole: &mut Solution, solved: &Solution, part: Part) {
    let width = whole.width as usize;
    part.bring(&solved.relative_blur, &mut whole.relative_blur, width, 1);
    part.bring(&solved.uncertainty, &mut whole.uncertainty, width, 1);
    part.bring(&solved.confidence, &mut whole.confidence, width, 1);
    part.bring(&solved.residual, &mut whole.residual, width, 1);
    whole.fused_channels = solved.fused_channels;
    if !solved.fused.is_empty() {
        let channels = solved.fused_channels.count() as usize;
        whole.fused.resize(channels * whole.relative_blur.len(), 0.0);
        part.bring(&solved.fused, &mut whole.fused, width, channels);
    }
    whole.timings.gpu_ms += solved.timings.gpu_ms;
    whole.timings.total_ms += solved.timings.total_ms;
}

/// Why the device does not hold the whole.
fn refusal(engine: &Engine, size: [u32; 2], formats: [Format; 2], settings: &Settings) -> Option<Error> {
    Plan::new(size[0], size[1], formats, settings).and_then(|plan| engine.admits(&plan, 1)).err()
}

/// Parts that the device holds.
fn grid(engine: &Engine, size: [u32; 2], formats: [Format; 2], settings: &Settings) -> Result<Grid, Error> {
    let plan = Plan::new(size[0], size[1], formats, settings)?;
    let (on_device, host) = plan.bytes();
    let share = engine.memory() as f64 / (on_device + host) as f64;
    let sides = (share * f64::from(size[0]) * f64::from(size[1])).sqrt().min(engine.info().max_image_size.into());
    let mut most = (sides as u32).max(LEAST);
    loop {
        let halo = HALO + (3.0 * settings.max_relative_blur.sqrt() + HALO_SHARE * f64::from(most)).ceil() as u32;
        let grid = Grid::covering(size, most, halo);
        let [width, height] = grid.side();
        match engine.admits(&Plan::new(width, height, formats, settings)?, 1) {
            Err(Error::TooLarge { .. }) if most > LEAST => most = (most * 7 / 8).max(LEAST),
            other => return other.map(|()| grid),
        }
    }
}

/// What is found at half the size, or at the largest of its halves that the device holds, told of full-size pixels; the fields are of that size.
fn at_half_size(
    engine: &Engine,
    frames: [&Frame; 2],
    settings: &Settings,
    mask: Option<&Mask>,
    cancel: &CancellationToken,
) -> Result<Solution, Error> {
    let depth = frames[0].format().depth;
    let mut settings = Settings { fused: false, levels: None, ..settings.clone() };
    [settings.black_level, settings.white_level] = intensities(settings.clipped(depth), settings.decode);
    let (mut sizes, mut halves) = (Vec::new(), None);
    let [i1, i2] = loop {
        let [i1, i2] = halves.as_ref().map_or(frames, |[i1, i2]: &[Frame; 2]| [i1, i2]);
        let size = [i1.width(), i1.height()];
        let small = [parts::halved(i1, settings.decode)?, parts::halved(i2, settings.decode)?];
        sizes.push(size);
        settings.decode = Decode::None;
        settings.max_relative_blur = (settings.max_relative_blur / 4.0).max(1.0);
        settings.start = parts::halved_map(&settings.start, size);
        if !engine.needs_parts([small[0].width(), small[0].height()], small.each_ref().map(Frame::format), &settings)? {
            break small;
        }
        halves = Some(small);
    };
    let mut solver = PairSolver::for_pair(engine, &i1, &i2, &settings)?;
    solver.set_cancel(cancel.clone());
    solver.set_mask(mask.map(|mask| mask.subsampled(1 << sizes.len())))?;
    let mut found = solver.solve(&i1, &i2)?;
    // What is at the limit of |V| at half the size need not be.
    let saturation = found.saturation(settings.max_relative_blur);
    found.warnings.retain(|warning| Some(warning) != saturation.as_ref());
    for &size in sizes.iter().rev() {
        found.transform = parts::doubled(&found.transform, size);
        (found.photometric.gain, found.shading) = parts::shading_doubled(found.photometric.gain, &found.shading, size);
        found.other_motion.iter_mut().for_each(|other| other.corner_px *= 2.0);
    }
    Ok(found)
}

/// Levels, on a scale from 0 to 1 as stored, at which pixels are clipped, as intensities. At half the size those that lie among others are told by them.
fn intensities(levels: [f32; 2], decode: Decode) -> [Option<f64>; 2] {
    let of = |level: f32| if decode == Decode::Srgb { srgb_to_linear(level.into()) } else { level.into() };
    levels.map(|level| level.is_finite().then(|| of(level)))
}

/// Fields of full size without results.
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
