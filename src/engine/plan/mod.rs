//! The plan of a solve: levels of the pyramid, filters, and what each iteration does.

use crate::base::{
    Channels, DeviceInfo, Error, Format, Kernel, Method, Motion, ParallaxSearch, PixelFormat, Settings, centre,
};
use crate::engine::filter::{self, Filter};
use crate::engine::shaders::filter::TAPS;
use crate::engine::slot::Slot;
use crate::engine::stages::exposure::{self, Adopt};
use crate::engine::stages::noise::Noise;
use crate::engine::stages::stack::{self, Slopes, node_count};
use crate::engine::stages::state::MAX_LEVELS;
use crate::engine::stages::{
    self, cascade, edge, grid, lens_windows, linearise, parallax_windows, relax_tiles, separable, uncertainty_terms,
};

mod layout;

pub(crate) use layout::{Allocation, AllocationKind, HostAccess};

/// The least width and height: no blur window fits into a smaller image.
pub(crate) const LEAST_SIZE: u32 = 16;
/// Without [`Settings::levels`], levels are added while the short side of the coarsest stays at least this long.
const LEAST_COARSEST: u32 = 32;
/// The least short side of a level that [`Settings::levels`] may ask for.
const LEAST_LEVEL: u32 = 8;
// `system_tiles` mirrors a level twice: its window must reach no further beyond the border.
const _: () = assert!(TAPS / 2 <= 2 * (LEAST_LEVEL - 1));
/// Outer iterations in which α of the coarsest level, which starts from V = 0, falls to its final value. The others
/// start from a coarser V and need none: the cascade carries V across a level in one iteration.
const CONTINUATION: f64 = 6.0;
/// With fewer outer iterations than these, the continuation is shortened in proportion, so that it ends before they do.
const WHOLE_CONTINUATION: f64 = 20.0;
/// Layers of results before the fused channels: V, its standard deviation, the residual.
pub(crate) const MAP_LAYERS: u32 = 3;
/// Layers of the scratch image, which filters take at once: those of both photographs, or D and b.
pub(crate) const SCRATCH_LAYERS: u32 = 2;
/// The most layers of results: three fused channels more.
const RESULT_LAYERS: u32 = MAP_LAYERS + 3;

/// Outer iterations between two checks whether a level has settled. A check takes as long as some empty dispatches, of
/// which an iteration has a dozen.
const ITERATIONS_A_CHECK: usize = 2;
/// The number of coarsest levels on which T may still move far. I2 is read at T x there; on finer levels it is warped
/// onto I1's pixels first.
const UNWARPED_LEVELS: usize = 2;
/// The widest limit of |V| at which blur stacks are packed, px². Filters of packed layers have at most 60 weights
/// (glsl/separable.comp), and wider blur needs more.
const WIDEST_PACKED: f64 = Settings::USUAL_BLUR;
/// The stack of I2 is read at s² V₁: a fifth above the limit leaves room for s up to 1.095.
const READ_BEYOND: f64 = 1.2;

/// Everything about a solve that does not depend on the pixels.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) size: [u32; 2],
    /// Pixel formats of the photographs as the caller passes them.
    pub(crate) packed: [PixelFormat; 2],
    /// Formats once they are unpacked.
    pub(crate) formats: [Format; 2],
    pub(crate) settings: Settings,
    /// The levels of the pyramid, finest first.
    pub(crate) pyramid: Vec<Level>,
    /// The number of levels.
    pub(crate) solved: usize,
    pub(crate) weights: Weights,
    pub(crate) halve: FilterRange,
    pub(crate) prefilter: FilterRange,
    /// Averages over the window of the uncertainty.
    pub(crate) window: FilterRange,
    /// The layers of a stack after the first.
    pub(crate) layers: Vec<StackLayer>,
    /// Filters of the frames of a sweep: a low pass; then along x and along y the part that a high pass adds.
    pub(crate) band: [FilterRange; 3],
    /// Whether a texel of the blur stacks may hold a coefficient of each photograph in 16 bits, instead of a float.
    pub(crate) may_pack: bool,
}

impl Plan {
    /// Checks settings and size, resolves [`Decode::Auto`](crate::base::Decode::Auto), and computes levels and filters.
    pub(crate) fn new(
        width: u32,
        height: u32,
        packed: [impl Into<PixelFormat>; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        let packed = packed.map(Into::into);
        let formats = packed.map(PixelFormat::format);
        settings.check()?;
        if width < LEAST_SIZE || height < LEAST_SIZE {
            return Err(Error::TooSmall { width, height, least: LEAST_SIZE });
        }
        let solved = solved_levels(width, height, settings)?;
        let mut pyramid: Vec<Level> =
            (0..solved).map(|l| Level::new(l, width, height, settings.blur_limit())).collect();
        if settings.kernel == Kernel::Auto {
            // A lens blurs both photographs, one of them by more than |V|.
            pyramid.iter_mut().for_each(|level| level.nodes += 1);
        }
        let mut weights = Weights::default();
        let layers = (1..pyramid[0].nodes * Slopes::of(&settings.kernel).layers()).map(|n| {
            let stack::Layer { from, sampling, terms } = stack::layer(&settings.kernel, n);
            let terms = terms.iter().map(|filters| weights.add(filters.each_ref())).collect();
            StackLayer { from: from as u32, sampling, terms }
        });
        let layers = layers.collect();
        let [low, wide, less] = band();
        let [along_x, along_y] = weights.add([&wide, &less]);
        Ok(Self {
            size: [width, height],
            packed,
            formats,
            settings: Settings { decode: settings.decode.resolved(formats.map(|f| f.depth)), ..settings.clone() },
            solved,
            halve: weights.add_one(&halving_filter()),
            prefilter: weights.add_one(&filter::spline_prefilter()),
            window: weights.add_one(&uncertainty_terms::window()),
            layers,
            band: [weights.add_one(&low), along_x, along_y],
            may_pack: true,
            pyramid,
            weights,
        })
    }

    /// The plan for a device.
    pub(crate) fn for_device(self, device: &DeviceInfo) -> Self {
        if device.is_processor() { self.for_processor() } else { self }
    }

    /// The plan for a processor, which stores blur stacks as floats, since unpacking takes it longer than reading, and
    /// takes longer tiles of `linearise`, since it runs fewer at once.
    pub(crate) fn for_processor(mut self) -> Self {
        self.may_pack = false;
        self.pyramid.iter_mut().for_each(|level| level.rows = linearise::rows_on_processor(level.size));
        self
    }

    /// The levels solved, coarsest first.
    pub(crate) fn coarse_to_fine(&self) -> impl Iterator<Item = &Level> {
        self.pyramid[..self.solved].iter().rev()
    }

    /// Outer iterations of a level in which α falls to its value.
    fn continuation(&self, level: &Level) -> f64 {
        let allowed = f64::from(self.settings.outer_iterations) / WHOLE_CONTINUATION;
        if level.index + 1 == self.solved { CONTINUATION * allowed.min(1.0) } else { 0.0 }
    }

    /// The factor by which α is larger than its final value in outer iteration k of a level.
    pub(crate) fn continued(&self, level: &Level, k: u32) -> f64 {
        let share = if self.continuation(level) > 0.0 { f64::from(k) / self.continuation(level) } else { 1.0 };
        1.0 + self.settings.continuation * (1.0 - share).max(0.0)
    }

    /// Whether an earlier iteration than k had the final α.
    fn has_final_alpha(&self, level: &Level, k: u32) -> bool {
        k > 0 && f64::from(k - 1) >= self.continuation(level)
    }

    /// Whether a level may settle in iteration k: after a whole step at the final α.
    pub(crate) fn may_settle(&self, level: &Level, k: u32) -> bool {
        k % 2 == 1 && self.has_final_alpha(level, k)
    }

    /// Whether α is estimated after iteration k of a level.
    ///
    /// V from a coarser level gives an estimate nearly as good as the last one. Each change of α takes iterations,
    /// which then coincide with the continuation. During the continuation V is too smooth, and the estimate would be
    /// too large. All levels but the finest, which provide a start only, estimate once more.
    pub(crate) fn finds_alpha(&self, level: &Level, k: u32) -> bool {
        let starts_well = level.index + 1 < self.solved;
        let once = starts_well && level.index > 0 && k > 0 && self.has_final_alpha(level, k - 1);
        self.settings.regularization.is_none() && (k == 0 && starts_well || self.has_final_alpha(level, k) && !once)
    }

    /// Whether a part of the script begins before iteration k that is skipped once the level has settled. `may_settle`
    /// says in which iterations it can settle.
    pub(crate) fn checks_before(k: u32, may_settle: impl Fn(u32) -> bool) -> bool {
        let since_first = (0..k).rev().take_while(|&k| may_settle(k)).count();
        since_first % ITERATIONS_A_CHECK == 1
    }

    /// Whether T is solved for together with V. Otherwise it is known before.
    pub(crate) fn solves_transform(&self) -> bool {
        self.settings.method == Method::Unified
    }

    /// Whether T is solved for by appearance, before V.
    pub(crate) fn solves_appearance(&self) -> bool {
        self.settings.method == Method::Appearance
    }

    /// The levels on which T is solved for by appearance, coarsest first: all or none.
    pub(crate) fn appearance_levels(&self) -> impl Iterator<Item = &Level> {
        self.coarse_to_fine().filter(|_| self.solves_appearance())
    }

    /// Whether gain, offset and shading are matched.
    pub(crate) fn matches_exposure(&self) -> bool {
        self.settings.photometric
    }

    /// Whether T is a homography, whose step needs more sums.
    pub(crate) fn projective(&self) -> bool {
        self.settings.motion == Motion::Homography
    }

    /// Whether a level computes the sums of a homography while it solves for V. The finest level does: the last of its
    /// sums rate the motion models.
    pub(crate) fn sums_all(&self, level: &Level) -> bool {
        self.projective() || self.solves_transform() && level.index == 0
    }

    /// Whether gain and offset are matched before iteration k of a level: before 0, 1 and 3, and on the coarsest level
    /// before 5 too, while α still falls. A match must not follow an extrapolated step, which may go too far: the gain
    /// then takes up what V has too much of, and both come back slowly. With steps doubled in turn, matched before 2
    /// and 4 instead, a uniform V of 1 px² without noise ended at 1.013 instead of 1.003.
    pub(crate) fn matches_before(&self, level: &Level, k: u32) -> bool {
        let coarsest = level.index + 1 == self.solved;
        self.matches_exposure() && (k <= 3 && k != 2 || coarsest && k == 5)
    }

    /// What is matched on a level: the shading only where a coarser level has found T.
    pub(crate) fn adopts(&self, level: &Level) -> Adopt {
        let knows_transform = level.index + 1 < self.solved || self.solved == 1;
        if knows_transform && exposure::shows_shading(level.size) { Adopt::Shading } else { Adopt::Exposure }
    }

    /// Whether a level reads I2 as `warp` has resampled it onto I1's pixels. Only Gaussians allow it, since their mean
    /// is zero.
    pub(crate) fn warps(&self, level: &Level) -> bool {
        self.slopes() == Slopes::Laplacian && level.index + UNWARPED_LEVELS < self.solved
    }

    /// Whether I2 may be warped again before iteration k, where T or the shading has changed. Seldom: they change
    /// little on the finer levels, and even empty dispatches take time.
    pub(crate) fn warps_again(&self, level: &Level, k: u32) -> bool {
        let moves = self.solves_transform() || self.matches_exposure();
        self.warps(level) && moves && k.is_power_of_two()
    }

    /// Whether T and the parallax are stepped together before iteration k of a level: before those after which it may
    /// settle. Not on the coarsest level, where blur hardly shows the sign of V, which the parallax then would choose.
    pub(crate) fn steps_parallax(&self, level: &Level, k: u32) -> bool {
        let is_free =
            self.settings.parallax == ParallaxSearch::On && self.solves_transform() && level.index + 1 < self.solved;
        is_free && k % 2 == 1 && parallax_windows::fits(level.size)
    }

    /// Whether law and kernel are found on a level, before its first iteration: where I2 is warped.
    pub(crate) fn finds_lens(&self, level: &Level) -> bool {
        self.settings.kernel == Kernel::Auto && self.warps(level) && lens_windows::fits(level.size)
    }

    /// Whether they are found again before iteration k of a level: V depends on them, and they on V.
    pub(crate) fn finds_lens_again(&self, level: &Level, k: u32) -> bool {
        self.finds_lens(level) && k == 2
    }

    /// Layers of the results: V, its standard deviation, the residual, and the channels of the fused image if there is
    /// one.
    pub(crate) fn map_layers(&self) -> u32 {
        MAP_LAYERS + self.fused_count()
    }

    /// Channels of the fused image that is computed: none without [`Settings::fused`].
    pub(crate) fn fused_count(&self) -> u32 {
        if self.settings.fused { self.fused_channels().count() } else { 0 }
    }

    /// Channels of the fused image.
    pub(crate) fn fused_channels(&self) -> Channels {
        if self.formats.iter().all(|f| f.channels == Channels::Gray) { Channels::Gray } else { Channels::Rgb }
    }

    /// First layer of the blur stack of I2, behind that of I1. The layers of the stack of I1 hold the results at the
    /// end. If stacks are packed, a device has both in the layers of I1, and CPU references still have them apart.
    pub(crate) fn second_stack(&self, level: &Level) -> u32 {
        let behind = self.layers_of(&self.pyramid[0]).max(RESULT_LAYERS);
        if self.packs_stacks() && !self.packs(level) { self.layers_of(level) } else { behind }
    }

    /// Whether the blur stacks of a level are packed: those that would not fit as floats. Passes over small levels
    /// take longer with packed ones.
    pub(crate) fn packs(&self, level: &Level) -> bool {
        self.packs_stacks() && self.exceeds_packed(level)
    }

    /// Whether the blur stacks of a level, as floats, have more layers than packed ones of the finest level.
    fn exceeds_packed(&self, level: &Level) -> bool {
        2 * self.layers_of(level) > self.layers_with(self.layers_of(&self.pyramid[0]).max(RESULT_LAYERS))
    }

    /// The finest of a level's coarse grids that another dispatch relaxes in shared memory. `None` if each grid has
    /// dispatches of its own. That is so with more sweeps than tiles take. It is also so on long strips, whose coarsest
    /// grid does not fit shared memory.
    pub(crate) fn small_grid(&self, level: &Level) -> Option<usize> {
        let small = || grid::grids(level.size).iter().position(|grid| cascade::fits(grid.size));
        (self.settings.relaxation_sweeps <= relax_tiles::MOST_SWEEPS).then(small).flatten()
    }

    /// The number of a level's coarse grids up to which dispatches sum the system.
    pub(crate) fn summed_grids(&self, level: &Level) -> usize {
        self.small_grid(level).map_or_else(|| grid::grids(level.size).len(), |small| small + 1)
    }

    /// Relaxation sweeps on the n-th of a level's coarse grids.
    pub(crate) fn sweeps_on_grid(&self, level: &Level, n: usize) -> u32 {
        let is_coarsest = n + 1 == grid::grids(level.size).len();
        if is_coarsest { cascade::COARSEST_SWEEPS } else { self.settings.relaxation_sweeps }
    }

    /// Numbers of dV of a level's grids, and of the spare place behind them: for a grid with several dispatches, and for
    /// the level if its half-sweeps are stored.
    pub(crate) fn grid_steps(&self, level: &Level) -> u64 {
        let grids = grid::grids(level.size);
        let spare = match self.small_grid(level) {
            Some(_) => 0,
            None if self.settings.relaxation_sweeps > relax_tiles::MOST_SWEEPS => level.pixels(),
            None => grids.last().map_or(0, |grid| stages::pixels(grid.size[0], grid.size[1])),
        };
        grid::cells(level.size) + spare
    }

    /// Whether blur stacks are packed, at least those of the finest level.
    pub(crate) fn packs_stacks(&self) -> bool {
        self.may_pack && self.slopes() == Slopes::Laplacian && self.settings.blur_limit() <= WIDEST_PACKED
    }

    /// Layers of both blur stacks as a device stores them, and of the results.
    pub(crate) fn stack_layers(&self) -> u32 {
        let of_one = self.layers_of(&self.pyramid[0]);
        self.layers_with(of_one.max(RESULT_LAYERS) + if self.packs_stacks() { 0 } else { of_one })
    }

    /// The number of layers, or of those of the passes over edges if there are more.
    fn layers_with(&self, stacks: u32) -> u32 {
        if self.settings.edges { stacks.max(edge::LAYERS) } else { stacks }
    }

    /// Layers of a blur stack on a level.
    pub(crate) fn layers_of(&self, level: &Level) -> u32 {
        (level.nodes * self.slopes().layers()) as u32
    }

    /// Whether a photograph is unpacked on the device.
    pub(crate) fn unpacks(&self, image: usize) -> bool {
        !self.packed[image].is_plain()
    }

    /// The slot that a photograph is uploaded to.
    pub(crate) fn entry(&self, image: usize) -> Slot {
        if self.unpacks(image) { Slot::Packed { image } } else { Slot::Photograph { image } }
    }

    /// How the slopes of a blur stack are computed.
    pub(crate) fn slopes(&self) -> Slopes {
        Slopes::of(&self.settings.kernel)
    }
}

/// Outer iterations of a level after which the steps of V and T are damped. Most levels settle before. Of the others,
/// some alternate between two states.
const UNDAMPED: f32 = 20.0;
/// The share of a step that is taken after [`UNDAMPED`] iterations. From twice as many on it falls further: dots under
/// a half-Gaussian, 32 px, had not settled after 100 iterations at a half, and after 67 with a falling share.
///
/// Half heat sink, finest level: alternated by 0.04 % of the energy after 300 whole steps, settled after 23 damped
/// ones. Half pcb-macro, coarsest level: by 1 % after 300, settled after 29.
const DAMPED: f32 = 0.5;

/// The share of the steps of V and T that iteration k takes.
pub(crate) fn step_share(k: u32) -> f32 {
    let k = k as f32;
    if k < UNDAMPED { 1.0 } else { DAMPED * (2.0 * UNDAMPED / k).min(1.0) }
}

/// σ of the low pass of a sweep's frames, px: finer detail is mostly noise and JPEG artifacts.
pub(crate) const LOW_PASS: f64 = 0.5;
/// σ of the high pass, px: wider structure, such as drifts of brightness, says little about focus.
const HIGH_PASS: f64 = 2.0;

/// The low pass; then the part that the high pass adds, along x and along y.
pub(crate) fn band() -> [Filter; 3] {
    let wide = filter::gaussian(HIGH_PASS * HIGH_PASS);
    let less = wide.iter().map(|w| -w).collect();
    [filter::gaussian(LOW_PASS * LOW_PASS), wide, less]
}

/// The filter of the pyramid: σ 1 px before every other pixel is taken.
pub(crate) fn halving_filter() -> Filter {
    filter::gaussian(1.0)
}

fn solved_levels(width: u32, height: u32, settings: &Settings) -> Result<usize, Error> {
    let short = width.min(height);
    let most = |least: u32| (1..MAX_LEVELS).take_while(|&l| half_size(short, l) >= least).count() + 1;
    match settings.levels {
        None => Ok(most(LEAST_COARSEST)),
        Some(levels) if levels as usize <= most(LEAST_LEVEL) => Ok(levels as usize),
        Some(levels) => Err(Error::Setting {
            name: "levels",
            value: levels.into(),
            range: format!("1 to {} for {width}x{height}", most(LEAST_LEVEL)),
        }),
    }
}

/// One level of the pyramid; level 0 is the image itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Level {
    /// Index, 0 the finest.
    pub(crate) index: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
    /// Pixels of the full-size image per pixel of this level.
    pub(crate) factor: f64,
    /// The image centre in pixels of this level. It differs from the middle of the level's own grid.
    pub(crate) centre: [f64; 2],
    /// L, the length that places are divided by: a quarter of the diagonal, pixels.
    pub(crate) length: f64,
    /// Largest |V|, px² of this level.
    pub(crate) limit: f64,
    /// Nodes of the stack of blurred images.
    pub(crate) nodes: usize,
    /// Lines of pairs of pixels that an invocation of `linearise` computes.
    pub(crate) rows: u32,
    /// Noise of a photograph on this level.
    pub(crate) noise: Noise,
}

impl Level {
    pub(crate) fn new(index: usize, width: u32, height: u32, max_relative_blur: f64) -> Self {
        let factor = f64::from(1u32 << index);
        let size = [half_size(width, index), half_size(height, index)];
        // At least 1 px²: less blur is not visible on a coarse level, and V must be free to move.
        let limit = (max_relative_blur / (factor * factor)).max(1.0);
        Self {
            index,
            size,
            factor,
            centre: centre(width, height).map(|c| c / factor),
            length: f64::from(size[0]).hypot(size[1].into()) / 4.0,
            limit,
            nodes: node_count(READ_BEYOND * limit),
            // The tiles of the finest level also state the deviation of T, which is not to depend on the device.
            rows: if index == 0 { linearise::rows_on_processor(size) } else { linearise::rows_on_gpu(size) },
            noise: Noise::new(index),
        }
    }

    /// Workgroups of `linearise`: a row of partial sums each.
    pub(crate) fn tiles(&self) -> [u32; 3] {
        linearise::tiles(self.size, self.rows)
    }

    pub(crate) fn pixels(&self) -> u64 {
        stages::pixels(self.size[0], self.size[1])
    }

    /// Width and height of an image that holds one color of a checkerboard.
    pub(crate) fn half(&self) -> [u32; 2] {
        [self.size[0].div_ceil(2), self.size[1]]
    }
}

/// A side after `halvings` halvings. Pixel i of a level is at pixel 2i of the level below.
fn half_size(side: u32, halvings: usize) -> u32 {
    side.div_ceil(1 << halvings)
}

/// Where a filter is among the weights of all filters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FilterRange {
    pub(crate) bank: usize,
    /// Of the first weight, in units of four weights.
    pub(crate) offset: u32,
    pub(crate) blocks: u32,
    pub(crate) radius: u32,
}

/// The recipe of a layer of a blur stack: its source layer, and the separable filters whose results are added.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StackLayer {
    pub(crate) from: u32,
    pub(crate) sampling: stack::Sampling,
    pub(crate) terms: Vec<[FilterRange; 2]>,
}

/// The weights of all filters, in banks that fit into a uniform buffer each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub(crate) banks: Vec<Vec<f64>>,
}

impl Weights {
    /// Adds a filter along x and one along y, which are in one bank.
    fn add(&mut self, filters: [&Filter; 2]) -> [FilterRange; 2] {
        let length = |filter: &Filter| filter.len().next_multiple_of(separable::BLOCK as usize);
        let both: usize = filters.map(length).iter().sum();
        if self.banks.last().is_none_or(|bank| bank.len() + both > separable::WEIGHTS) {
            self.banks.push(Vec::new());
        }
        let bank = self.banks.len() - 1;
        filters.map(|filter| {
            let weights = &mut self.banks[bank];
            let (offset, end) = (weights.len() as u32 / 4, weights.len() + length(filter));
            weights.extend(filter);
            weights.resize(end, 0.0);
            let blocks = (length(filter) as u32) / separable::BLOCK;
            FilterRange { bank, offset, blocks, radius: (filter.len() / 2) as u32 }
        })
    }

    /// Adds a filter that serves along both axes.
    fn add_one(&mut self, filter: &Filter) -> FilterRange {
        self.add([filter, &Filter::new()])[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Depth;

    const GRAY: Format = Format { channels: Channels::Gray, depth: Depth::F32 };

    fn plan(width: u32, height: u32) -> Plan {
        Plan::new(width, height, [GRAY; 2], &Settings::default()).unwrap()
    }

    #[test]
    fn auto_levels_stop_at_a_short_side_of_32() {
        assert_eq!(plan(1920, 1080).solved, 6);
        assert_eq!(plan(256, 256).solved, 4);
        assert_eq!(plan(255, 63).solved, 2);
        assert_eq!(plan(16, 16).solved, 1);
    }

    #[test]
    fn levels_keep_the_centre_of_the_image() {
        let settings = Settings { levels: Some(3), ..Settings::default() };
        let plan = Plan::new(101, 77, [GRAY; 2], &settings).unwrap();
        let level = &plan.pyramid[2];
        assert_eq!(level.size, [26, 20]);
        assert_eq!(level.centre, [12.5, 9.5]);
    }

    #[test]
    fn smoothness_falls_to_its_value() {
        let plan = plan(256, 256);
        for (level, length) in [(3, 6), (2, 0), (1, 0), (0, 0)] {
            let level = &plan.pyramid[level];
            assert!(length == 0 || (plan.continued(level, 0) - 11.0).abs() < 1e-12);
            assert_eq!(plan.continued(level, length), 1.0);
            assert!(!plan.may_settle(level, length) && plan.may_settle(level, length + 1));
        }
    }

    #[test]
    fn more_iterations_do_not_stretch_the_continuation_and_fewer_shorten_it() {
        let of = |outer_iterations| {
            let settings = Settings { outer_iterations, ..Settings::default() };
            let plan = Plan::new(256, 256, [GRAY; 2], &settings).unwrap();
            plan.coarse_to_fine().map(|level| plan.continuation(level)).collect::<Vec<_>>()
        };
        assert_eq!(of(20), [6.0, 0.0, 0.0, 0.0]);
        assert_eq!(of(1000), of(20));
        assert_eq!(of(10), [3.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_level_with_many_iterations_is_damped() {
        assert_eq!([0, 19, 20, 40, 80].map(step_share), [1.0, 1.0, 0.5, 0.5, 0.25]);
    }

    #[test]
    fn settling_is_checked_from_the_first_iteration_that_may_settle_on() {
        let checks = |may_settle: fn(u32) -> bool| {
            (0..9).filter(move |&k| Plan::checks_before(k, may_settle)).collect::<Vec<_>>()
        };
        assert_eq!(checks(|k| k >= 3), [4, 6, 8]);
        assert_eq!(checks(|k| k >= 8), [0; 0]);
    }

    #[test]
    fn bytes_a_pixel() {
        for (width, height) in [(4000, 3000), (1024, 1024), (640, 480), (320, 240)] {
            let bytes = |plan: &Plan| plan.bytes().0 as f64 / f64::from(width * height);
            let packed = plan(width, height);
            let [packed, floats] = [&packed, &Plan { may_pack: false, ..packed.clone() }].map(bytes);
            assert!(floats < 172.0 && packed < 120.0, "{width}x{height}: {floats}, {packed}");
        }
    }

    #[test]
    fn small_images_and_too_many_levels_are_refused() {
        let settings = Settings { levels: Some(5), ..Settings::default() };
        assert!(matches!(Plan::new(8, 8, [GRAY; 2], &settings), Err(Error::TooSmall { .. })));
        assert!(matches!(Plan::new(64, 64, [GRAY; 2], &settings), Err(Error::Setting { name: "levels", .. })));
    }
}
