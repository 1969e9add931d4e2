//! Sizes before anything is allocated: levels, images, bytes, limits, and what each iteration is told.

use crate::base::{Channels, Error, Format, Kernel, Method, Motion, PixelFormat, Settings};
use crate::engine::filter::{self, Filter};
use crate::engine::slot::Slot;
use crate::engine::stages::exposure::{self, Adopt};
use crate::engine::stages::stack::{self, Slopes};
use crate::engine::stages::state::MAX_LEVELS;
use crate::engine::stages::{shape_windows, uncertainty_terms};

mod level;
mod limits;
mod push_constants;
mod weights;

pub(crate) use level::Level;
use level::half_size;
use weights::Weights;
pub(crate) use weights::{FilterRange, StackLayer};

/// The least width and height: below it no blur window fits into the image.
pub(crate) const LEAST_SIZE: u32 = 16;
/// `auto` halves while the short side stays at least this.
const LEAST_COARSEST: u32 = 32;
/// The least short side of a level that is asked for by number.
const LEAST_LEVEL: u32 = 8;
/// Outer iterations in which α falls to its value, from the coarsest level on; the last holds for all that are finer. The
/// coarsest starts from nothing, the others from a V that needs less of it: with 12 everywhere levels did 14 to 20
/// iterations, with 2 on the finest 5 to 9, with 1 one less, and errors are the same (`docs/experiments/iterations.md`).
const CONTINUATION: [f64; 5] = [12.0, 8.0, 6.0, 6.0, 1.0];
/// Where fewer iterations than these are allowed, the continuation is shorter in proportion, so that it ends before they do.
const WHOLE_CONTINUATION: f64 = 20.0;
/// Layers of results before the fused channels: V, its standard deviation, the residual.
pub(crate) const MAP_LAYERS: u32 = 3;
/// Layers that the results need at most: three colours besides.
const RESULT_LAYERS: u32 = MAP_LAYERS + 3;

/// A level that may have settled goes on for so many outer iterations before the host is asked: a question takes as long as
/// some dispatches over nothing, of which an iteration has a dozen.
const ITERATIONS_A_QUESTION: usize = 2;
/// Coarsest levels, on which T is still being found: I2 is read where T takes each pixel. On finer ones I2 is brought onto
/// I1's pixels first.
const FINDING: usize = 2;

/// Everything about a solve that does not depend on the pixels.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) size: [u32; 2],
    /// How cameras pack the photographs.
    pub(crate) packed: [PixelFormat; 2],
    /// What they are once they are unpacked.
    pub(crate) formats: [Format; 2],
    pub(crate) settings: Settings,
    /// The pyramid, finest first: the levels solved.
    pub(crate) pyramid: Vec<Level>,
    /// How many of them are solved.
    pub(crate) solved: usize,
    pub(crate) weights: Weights,
    pub(crate) halve: FilterRange,
    pub(crate) prefilter: FilterRange,
    /// Over which what decided V is averaged.
    pub(crate) window: FilterRange,
    /// The layers of a stack after the first.
    pub(crate) layers: Vec<StackLayer>,
    /// What the frames of a sweep are filtered by: a low pass; then along x and along y what a high pass adds.
    pub(crate) band: [FilterRange; 3],
}

impl Plan {
    /// Checks settings and size, resolves [`Decode::Auto`](crate::base::Decode::Auto), and lays out the levels.
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
        let pyramid: Vec<Level> =
            (0..solved).map(|l| Level::new(l, width, height, settings.max_relative_blur)).collect();
        let mut weights = Weights::default();
        let layers = (1..pyramid[0].nodes * Slopes::of(&settings.kernel).layers()).map(|n| {
            let stack::Layer { from, sampling, terms } = stack::layer(&settings.kernel, n);
            let terms = terms.iter().map(|filters| filters.each_ref().map(|f| weights.add(f))).collect();
            StackLayer { from: from as u32, sampling, terms }
        });
        let layers = layers.collect();
        Ok(Self {
            size: [width, height],
            packed,
            formats,
            settings: Settings { decode: settings.decode.resolved(formats.map(|f| f.depth)), ..settings.clone() },
            solved,
            halve: weights.add(&halving_filter()),
            prefilter: weights.add(&filter::spline_prefilter()),
            window: weights.add(&uncertainty_terms::window()),
            layers,
            band: band().map(|filter| weights.add(&filter)),
            pyramid,
            weights,
        })
    }

    /// The levels solved, coarsest first.
    pub(crate) fn coarse_to_fine(&self) -> impl Iterator<Item = &Level> {
        self.pyramid[..self.solved].iter().rev()
    }

    /// Outer iterations of a level in which α falls to its value.
    fn continuation(&self, level: &Level) -> f64 {
        let from_coarsest = (self.solved - 1).saturating_sub(level.index);
        let allowed = f64::from(self.settings.outer_iterations) / WHOLE_CONTINUATION;
        CONTINUATION[from_coarsest.min(CONTINUATION.len() - 1)] * allowed.min(1.0)
    }

    /// How many times too large α is in a level's outer iteration k: it falls to its value.
    pub(crate) fn continued(&self, level: &Level, k: u32) -> f64 {
        let share = f64::from(k) / self.continuation(level);
        1.0 + self.settings.continuation * (1.0 - share).max(0.0)
    }

    /// Whether a level may settle in iteration k: it has done one at the final α, whose energy it can compare with.
    pub(crate) fn may_settle(&self, level: &Level, k: u32) -> bool {
        k > 0 && f64::from(k - 1) >= self.continuation(level)
    }

    /// Whether α is found after iteration k of a level. V that comes from a coarser level tells of it at once, nearly as well as in the
    /// end, so that changes of α, each of which takes iterations, fall together with the continuation; what is smoothed by that tells
    /// of an α too large. Levels before the finest, which only hand on a start, look once more.
    pub(crate) fn finds_alpha(&self, level: &Level, k: u32) -> bool {
        let starts_well = level.index + 1 < self.solved;
        let once = starts_well && level.index > 0 && k > 0 && self.may_settle(level, k - 1);
        self.settings.regularization.is_none() && (k == 0 && starts_well || self.may_settle(level, k) && !once)
    }

    /// Whether the host asks before iteration k if a level has settled, and leaves out what is recorded for it from there on
    /// if it has; `may_settle` tells of iterations in which it can.
    pub(crate) fn asks_before(k: u32, may_settle: impl Fn(u32) -> bool) -> bool {
        let since_first = (0..k).rev().take_while(|&k| may_settle(k)).count();
        since_first % ITERATIONS_A_QUESTION == 1
    }

    /// Whether T is solved for together with V; otherwise it is known before V is.
    pub(crate) fn solves_transform(&self) -> bool {
        self.settings.method == Method::Unified
    }

    /// Whether T is solved for before V is, by appearance.
    pub(crate) fn solves_appearance(&self) -> bool {
        self.settings.method == Method::Appearance
    }

    /// The levels on which it is, coarsest first: all, or none.
    pub(crate) fn appearance_levels(&self) -> impl Iterator<Item = &Level> {
        self.coarse_to_fine().filter(|_| self.solves_appearance())
    }

    /// Whether gain, offset and shading are matched.
    pub(crate) fn matches_exposure(&self) -> bool {
        self.settings.photometric
    }

    /// Whether T's step takes sums that tell of homographies.
    pub(crate) fn projective(&self) -> bool {
        self.settings.motion == Motion::Homography
    }

    /// Whether sums of a level do where V is solved for: on the finest too, where T's motion model is judged by the last of them.
    pub(crate) fn sums_all(&self, level: &Level) -> bool {
        self.projective() || self.solves_transform() && level.index == 0
    }

    /// Whether gain and offset are matched before iteration k of a level: often at first, and never once it may have settled.
    pub(crate) fn matches_before(&self, level: &Level, k: u32) -> bool {
        self.matches_exposure() && (k == 0 || k > 1 && k.is_power_of_two() && !self.may_settle(level, k - 1))
    }

    /// What is matched there: the shading only once a coarser level has found T.
    pub(crate) fn adopts(&self, level: &Level) -> Adopt {
        let found = level.index + 1 < self.solved || self.solved == 1;
        if found && exposure::shows_shading(level.size) { Adopt::Shading } else { Adopt::Exposure }
    }

    /// Whether a level reads I2 on I1's pixels, where `warp` has brought it; only a Gaussian's blur has no mean to follow.
    pub(crate) fn warps(&self, level: &Level) -> bool {
        self.slopes() == Slopes::Laplacian && level.index + FINDING < self.solved
    }

    /// Whether I2 may be brought there anew before iteration k, where T or the shading has moved: seldom, since they move little
    /// on the finer levels and even passes over nothing take time.
    pub(crate) fn warps_anew(&self, level: &Level, k: u32) -> bool {
        let moves = self.solves_transform() || self.matches_exposure();
        self.warps(level) && moves && k.is_power_of_two()
    }

    /// Whether the kernel's shape is sought on a level, before its first iteration: where T is known, and I2 on I1's pixels.
    pub(crate) fn finds_shape(&self, level: &Level) -> bool {
        self.settings.kernel == Kernel::Auto && self.warps(level) && shape_windows::fits(level.size)
    }

    /// Layers of the results: V, its standard deviation, the residual; the channels of the fused image where one is made.
    pub(crate) fn map_layers(&self) -> u32 {
        MAP_LAYERS + self.fused_count()
    }

    /// Channels of the fused image that is made.
    pub(crate) fn fused_count(&self) -> u32 {
        if self.settings.fused { self.fused_channels().count() } else { 0 }
    }

    /// Channels of the fused image.
    pub(crate) fn fused_channels(&self) -> Channels {
        if self.formats.iter().all(|f| f.channels == Channels::Gray) { Channels::Gray } else { Channels::Rgb }
    }

    /// First layer of an image's stack. The layers of the stack of I1 hold the results at the end.
    pub(crate) fn first_layer(&self, image: usize) -> u32 {
        image as u32 * self.layers_of(&self.pyramid[0]).max(RESULT_LAYERS)
    }

    /// Layers of both stacks.
    pub(crate) fn stack_layers(&self) -> u32 {
        self.first_layer(1) + self.layers_of(&self.pyramid[0])
    }

    /// Layers of a level's stacks.
    pub(crate) fn layers_of(&self, level: &Level) -> u32 {
        (level.nodes * self.slopes().layers()) as u32
    }

    /// Whether a photograph is unpacked on the device.
    pub(crate) fn unpacks(&self, image: usize) -> bool {
        !self.packed[image].is_plain()
    }

    /// Where a photograph is brought to.
    pub(crate) fn entry(&self, image: usize) -> Slot {
        if self.unpacks(image) { Slot::Packed { image } } else { Slot::Photograph { image } }
    }

    /// How a stack's slopes are known.
    pub(crate) fn slopes(&self) -> Slopes {
        Slopes::of(&self.settings.kernel)
    }
}

/// σ of the low pass of a sweep's frames, px: below it is noise, and JPEG's.
pub(crate) const LOW_PASS: f64 = 0.5;
/// σ of the high pass, px: what is wider, drifts of brightness for one, tells little of focus.
const HIGH_PASS: f64 = 2.0;

/// The low pass; what the high pass adds, along x and along y.
pub(crate) fn band() -> [Filter; 3] {
    let wide = filter::gaussian(HIGH_PASS * HIGH_PASS);
    let less = wide.iter().map(|w| -w).collect();
    [filter::gaussian(LOW_PASS * LOW_PASS), wide, less]
}

/// Of the pyramid: σ 1 px before every other pixel is taken.
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
        for (level, length) in [(3, 12), (2, 8), (1, 6), (0, 6)] {
            let level = &plan.pyramid[level];
            assert!((plan.continued(level, 0) - 11.0).abs() < 1e-12);
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
        assert_eq!(of(20), [12.0, 8.0, 6.0, 6.0]);
        assert_eq!(of(1000), of(20));
        assert_eq!(of(10), [6.0, 4.0, 3.0, 3.0]);
    }

    #[test]
    fn a_level_that_goes_on_for_long_is_damped() {
        let plan = plan(64, 64);
        let share = |k| plan.update(&plan.pyramid[0], k).share;
        assert_eq!([0, 19, 20, 40, 80].map(share), [1.0, 1.0, 0.5, 0.5, 0.25]);
    }

    #[test]
    fn the_host_asks_from_the_first_iteration_that_may_settle_on() {
        let asks =
            |may_settle: fn(u32) -> bool| (0..9).filter(move |&k| Plan::asks_before(k, may_settle)).collect::<Vec<_>>();
        assert_eq!(asks(|k| k >= 3), [4, 6, 8]);
        assert_eq!(asks(|k| k >= 8), [0; 0]);
    }

    #[test]
    fn bytes_a_pixel() {
        let (device, _) = plan(4000, 3000).bytes();
        let per_pixel = device as f64 / 12e6;
        assert!(per_pixel < 160.0, "{per_pixel}");
    }

    #[test]
    fn small_images_and_too_many_levels_are_refused() {
        let settings = Settings { levels: Some(5), ..Settings::default() };
        assert!(matches!(Plan::new(8, 8, [GRAY; 2], &settings), Err(Error::TooSmall { .. })));
        assert!(matches!(Plan::new(64, 64, [GRAY; 2], &settings), Err(Error::Setting { name: "levels", .. })));
    }
}
