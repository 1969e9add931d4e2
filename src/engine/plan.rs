//! Sizes before anything is allocated: levels, images, bytes, limits, and what each iteration is told.

use crate::base::{Channels, Error, Format, Method, Photometric, RegistrationStep, Settings};
use crate::engine::filter::{self, Filter};
use crate::engine::stages::stack::{self, Slopes, node_count};
use crate::engine::stages::state::MAX_LEVELS;
use crate::engine::stages::{appearance, confidence, convolve, evidence, expose, linearise, residual, step};
use crate::engine::vulkan::{Device, MIB, image_limits};

/// The least width and height: below it no blur window fits into the image.
pub(crate) const LEAST_SIZE: u32 = 16;
/// `auto` halves while the short side stays at least this.
const LEAST_COARSEST: u32 = 32;
/// The least short side of a level that is asked for by number.
const LEAST_LEVEL: u32 = 8;
/// The exposure is matched on this level: the pyramid's blurs up to it add up to σ 9 px, its own pixels are 16 px wide.
const LOW_PASS: usize = 4;
/// The share of a level's outer iterations in which α falls to its value, from the coarsest level on; the last holds for
/// all that are finer. The coarsest starts from nothing, the others from a V that needs less of it: with 0.6 everywhere
/// levels did 14 to 20 iterations, now 5 to 9, and errors are the same (`docs/performance.md`).
const CONTINUATION_SHARES: [f64; 5] = [0.6, 0.4, 0.3, 0.3, 0.1];
/// The stack of I2 is read at s² V: a fifth above the limit leaves room for s up to 1.095.
const READ_BEYOND: f64 = 1.2;
/// Layers that the results need: V, its standard deviation, the residual, three colours.
const RESULT_LAYERS: u32 = 6;

/// Words of indirect arguments a level: three each for `linearise`, `relax`, `update` and `step`.
pub(crate) const GRID_WORDS: usize = 12;
/// Words of indirect arguments for the passes that bring I2 onto I1's pixels anew, at most so many a level.
pub(crate) const WARP_WORDS: usize = 3 * 48;
/// Words of indirect arguments a level.
pub(crate) const ARGUMENT_WORDS: usize = GRID_WORDS + WARP_WORDS;
/// Pixels that no corner may move any more in an iteration of the finest level, for it to settle: at 0.01 half-Gaussian pairs
/// stop 0.004 px off instead of 0.002.
const STILL: f32 = 0.001;
/// The same of the levels before, which only hand on a start: they did up to 20 iterations at 0.001, and no figure was better.
const STILL_ENOUGH: f32 = 0.01;
/// A level that may have settled goes on for so many outer iterations before the host is asked: a question takes as long as
/// some dispatches over nothing, of which an iteration has a dozen.
const ITERATIONS_A_QUESTION: usize = 2;
/// Coarsest levels, on which T is still being found: I2 is read where T takes each pixel. On finer ones I2 is brought onto
/// I1's pixels first.
const FINDING: usize = 2;

/// One level of the pyramid; level 0 is the image itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Level {
    /// Index, 0 the finest.
    pub(crate) index: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
    /// Pixels of the full-size image a pixel of this level.
    pub(crate) factor: f64,
    /// The image centre in pixels of this level: not the middle of its own grid.
    pub(crate) centre: [f64; 2],
    /// L, which scales a and b of the registration step to pixels: a quarter of the diagonal.
    pub(crate) length: f64,
    /// Largest |V|, px² of this level.
    pub(crate) limit: f64,
    /// Nodes of the stack of blurred images.
    pub(crate) nodes: usize,
}

/// A filter among all the weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FilterRange {
    pub(crate) bank: usize,
    /// In fours.
    pub(crate) offset: u32,
    pub(crate) blocks: u32,
    pub(crate) radius: u32,
}

/// How a layer of a stack is made: from which, and by the sum of which filters along x and along y.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StackLayer {
    pub(crate) from: u32,
    pub(crate) grid: stack::Grid,
    pub(crate) terms: Vec<[FilterRange; 2]>,
}

/// The weights of all filters, in banks that fit a uniform buffer each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub(crate) banks: Vec<Vec<f32>>,
}

impl Weights {
    fn add(&mut self, filter: &Filter) -> FilterRange {
        let blocks = (filter.len() as u32).div_ceil(convolve::BLOCK);
        let length = (blocks * convolve::BLOCK) as usize;
        if self.banks.last().is_none_or(|bank| bank.len() + length > convolve::WEIGHTS) {
            self.banks.push(Vec::new());
        }
        let bank = self.banks.len() - 1;
        let weights = &mut self.banks[bank];
        let (offset, radius) = (weights.len() as u32 / 4, (filter.len() / 2) as u32);
        let end = weights.len() + length;
        weights.extend(filter.iter().map(|&w| w as f32));
        weights.resize(end, 0.0);
        FilterRange { bank, offset, blocks, radius }
    }
}

/// Everything about a solve that does not depend on the pixels.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) size: [u32; 2],
    pub(crate) formats: [Format; 2],
    pub(crate) settings: Settings,
    /// The pyramid, finest first: the levels solved, and what the exposure match needs beyond.
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
}

impl Plan {
    /// Checks settings and size, and lays out the levels.
    pub(crate) fn new(width: u32, height: u32, formats: [Format; 2], settings: &Settings) -> Result<Self, Error> {
        settings.check()?;
        if width < LEAST_SIZE || height < LEAST_SIZE {
            return Err(Error::TooSmall { width, height, least: LEAST_SIZE });
        }
        let solved = solved_levels(width, height, settings)?;
        let low_pass = (0..=LOW_PASS).rev().find(|&l| half_size(width.min(height), l) >= LEAST_LEVEL).unwrap_or(0);
        let pyramid: Vec<Level> =
            (0..solved.max(low_pass + 1)).map(|l| Level::new(l, width, height, settings.max_relative_blur)).collect();
        let mut weights = Weights::default();
        let layers = (1..pyramid[0].nodes * Slopes::of(&settings.kernel).layers()).map(|n| {
            let stack::Layer { from, grid, terms } = stack::layer(&settings.kernel, n);
            let terms = terms.iter().map(|filters| filters.each_ref().map(|f| weights.add(f))).collect();
            StackLayer { from: from as u32, grid, terms }
        });
        let layers = layers.collect();
        Ok(Self {
            size: [width, height],
            formats,
            settings: settings.clone(),
            solved,
            halve: weights.add(&halving_filter()),
            prefilter: weights.add(&filter::spline_prefilter()),
            window: weights.add(&evidence::window()),
            layers,
            pyramid,
            weights,
        })
    }

    /// The levels solved, coarsest first.
    pub(crate) fn coarse_to_fine(&self) -> impl Iterator<Item = &Level> {
        self.pyramid[..self.solved].iter().rev()
    }

    /// What `expose` is told for a level, and the level at low pass where it works.
    pub(crate) fn expose(&self, level: &Level, adopt: bool) -> (usize, expose::Constants) {
        let index = level.index.max(LOW_PASS.min(self.pyramid.len() - 1));
        let low_pass = &self.pyramid[index];
        let constants = expose::Constants {
            width: low_pass.size[0],
            height: low_pass.size[1],
            factor: low_pass.factor as f32,
            centre: low_pass.centre.map(|c| c as f32),
            adopt: u32::from(adopt),
            stride: 1 << (index - level.index),
        };
        (index, constants)
    }

    /// Outer iterations of a level in which α falls to its value.
    fn continuation(&self, level: &Level) -> f64 {
        let from_coarsest = (self.solved - 1).saturating_sub(level.index);
        CONTINUATION_SHARES[from_coarsest.min(CONTINUATION_SHARES.len() - 1)]
            * f64::from(self.settings.outer_iterations)
    }

    /// α of a level's outer iteration k: it starts too large and falls to its value.
    pub(crate) fn smoothness(&self, level: &Level, k: u32) -> f64 {
        let share = f64::from(k) / self.continuation(level);
        self.settings.regularization * (1.0 + self.settings.continuation * (1.0 - share).max(0.0))
    }

    /// Whether a level may settle in iteration k: it has done one at the final α, whose energy it can compare with.
    pub(crate) fn may_settle(&self, level: &Level, k: u32) -> bool {
        k > 0 && f64::from(k - 1) >= self.continuation(level)
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

    /// Whether gain and offset are solved for in iteration k of a level: on the finest, once its own V has begun.
    pub(crate) fn solves_photometric(&self, level: &Level, k: u32) -> bool {
        self.settings.photometric && level.index == 0 && k > 0
    }

    /// Whether gain and offset are matched at low pass before: not where a start other than equal exposures is given.
    pub(crate) fn matches_exposure(&self) -> bool {
        self.settings.photometric && self.settings.start_photometric == Photometric::IDENTITY
    }

    /// Whether a level reads I2 on I1's pixels, where `warp` has brought it; only a Gaussian's blur has no mean to follow.
    pub(crate) fn warps(&self, level: &Level) -> bool {
        self.slopes() == Slopes::Laplacian && level.index + FINDING < self.solved
    }

    /// Whether I2 may be brought there anew before iteration k: seldom, since T moves little on the finer levels and even
    /// passes over nothing take time.
    pub(crate) fn warps_anew(&self, level: &Level, k: u32) -> bool {
        self.warps(level) && self.solves_transform() && k.is_power_of_two()
    }

    fn descends(&self) -> bool {
        self.settings.registration == RegistrationStep::GradientDescent
    }

    /// What `linearise` is told in iteration k of a level.
    pub(crate) fn linearise(&self, level: &Level, k: u32) -> linearise::Constants {
        let s = &self.settings;
        linearise::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: self.first_layer(1),
            rows: linearise::rows(level.size),
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            length: level.length as f32,
            alpha: self.smoothness(level, k) as f32,
            final_alpha: s.regularization as f32,
            eta: s.data_eta as f32,
            smoothness_eta: s.smoothness_eta as f32,
            epsilon: s.heaviside_epsilon as f32,
            // Beside so much smoothness no pixel's V answers.
            elimination: if self.descends() { 1e20 } else { linearise::ELIMINATION },
            mean: s.kernel.mean().map(|m| m as f32),
        }
    }

    /// What `evidence` is told.
    pub(crate) fn evidence(&self) -> evidence::Constants {
        let ([width, height], s) = (self.size, &self.settings);
        evidence::Constants {
            width,
            height,
            alpha: s.regularization as f32,
            eta: s.data_eta as f32,
            smoothness_eta: s.smoothness_eta as f32,
            noise: evidence::NOISE,
        }
    }

    /// What `residual` is told.
    pub(crate) fn residual(&self) -> residual::Constants {
        let ([width, height], finest) = (self.size, &self.pyramid[0]);
        residual::Constants {
            width,
            height,
            layer: evidence::RESIDUAL as u32,
            nodes: finest.nodes as u32,
            second_stack: self.first_layer(1),
            centre: finest.centre.map(|c| c as f32),
            mean: self.settings.kernel.mean().map(|m| m as f32),
            epsilon: self.settings.heaviside_epsilon as f32,
        }
    }

    /// What `confidence` is told.
    pub(crate) fn confidence(&self) -> confidence::Constants {
        confidence::Constants::new(self.size, self.pyramid[0].centre)
    }

    /// What `appearance` is told on a level.
    pub(crate) fn appearance(&self, level: &Level) -> appearance::Constants {
        appearance::Constants {
            width: level.size[0],
            height: level.size[1],
            rows: linearise::rows(level.size),
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            length: level.length as f32,
            eta: self.settings.data_eta as f32,
        }
    }

    /// What `step` is told after `appearance`, in iteration k of a level.
    pub(crate) fn appearance_step(&self, level: &Level, k: u32) -> step::Constants {
        step::Constants { solve_transform: 1, may_settle: u32::from(k > 0), warp_count: 0, ..self.step(level, k) }
    }

    /// What `step` is told in iteration k of a level.
    pub(crate) fn step(&self, level: &Level, k: u32) -> step::Constants {
        let [columns, rows, _] = level.tiles();
        step::Constants {
            rows: columns * rows,
            level: level.index as u32,
            energy_place: level.index as u32 * self.settings.outer_iterations + k,
            argument_place: (level.index * ARGUMENT_WORDS) as u32,
            argument_count: ARGUMENT_WORDS as u32,
            solve_transform: u32::from(self.solves_transform()),
            solve_photometric: u32::from(self.solves_photometric(level, k)),
            descend: u32::from(self.descends()),
            may_settle: u32::from(self.may_settle(level, k)),
            still: if level.index == 0 { STILL } else { STILL_ENOUGH },
            warp_place: (level.index * ARGUMENT_WORDS + GRID_WORDS) as u32,
            warp_count: if self.warps_anew(level, k + 1) { WARP_WORDS as u32 } else { 0 },
            factor: level.factor as f32,
            length: level.length as f32,
            half_size: level.centre.map(|c| c as f32),
        }
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

    /// How a stack's slopes are known.
    pub(crate) fn slopes(&self) -> Slopes {
        Slopes::of(&self.settings.kernel)
    }

    /// Bytes that a frame takes on its way up.
    pub(crate) fn frame_bytes(&self, frame: usize) -> u64 {
        let format = self.formats[frame];
        pixels(self.size) * u64::from(format.channels.count() * format.depth.bytes())
    }

    /// Bytes of the mask of I1, a whole number of words.
    pub(crate) fn mask_bytes(&self) -> u64 {
        pixels(self.size).next_multiple_of(4)
    }

    /// Bytes of V, its standard deviation, the residual and the fused channels on their way down.
    pub(crate) fn result_bytes(&self) -> u64 {
        4 * pixels(self.size) * u64::from(3 + self.fused_channels().count())
    }

    /// Bytes on the device, and bytes that the host sees.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let pyramid: u64 = self.pyramid.iter().map(|l| pixels(l.size)).sum();
        let solved: u64 = self.pyramid[..self.solved].iter().map(|l| pixels(l.size)).sum();
        let full = pixels(self.size);
        let half = pixels([self.size[0].div_ceil(2), self.size[1]]);
        let stacks = u64::from(self.stack_layers());
        let evidence = evidence::LAYERS as u64 * pixels(evidence::size(self.size));
        let floats = evidence + 4 * pyramid + solved + (2 + stacks) * full + 2 * (5 + 1) * half;
        let host = self.frame_bytes(0) + self.frame_bytes(1) + self.mask_bytes() + self.result_bytes();
        (4 * floats, host)
    }

    /// Checks the plan against a device's limits, so that nothing fails half-way.
    pub(crate) fn check(&self, device: &Device) -> Result<(), Error> {
        let info = device.info();
        let [width, height] = self.size;
        let too_large = |what, needed: String, limit: String| {
            Err(Error::TooLarge { width, height, device: info.name.clone(), what, needed, limit })
        };
        let longest = width.max(height);
        if longest > info.max_image_size {
            return too_large("the longer side", format!("{longest} px"), format!("{} px", info.max_image_size));
        }
        let mib = |bytes: u64| format!("{} MiB", bytes.div_ceil(MIB));
        let upload = self.frame_bytes(0).max(self.frame_bytes(1));
        if upload > info.max_storage_buffer {
            return too_large("one photograph", mib(upload), format!("{} for a buffer", mib(info.max_storage_buffer)));
        }
        let (largest, layers) = image_limits(device)?;
        let stack = 4 * pixels(self.size) * u64::from(self.stack_layers());
        if self.stack_layers() > layers {
            return too_large(
                "the stacks of blurred images",
                format!("{} layers", self.stack_layers()),
                format!("{layers}"),
            );
        }
        let (allocation, buffer) = device.allocation_limits();
        let largest = largest.min(allocation);
        if stack > largest {
            return too_large("the stacks of blurred images", mib(stack), format!("{} for an image", mib(largest)));
        }
        let largest = buffer.min(allocation);
        if self.result_bytes() > largest {
            return too_large("the result", mib(self.result_bytes()), format!("{} for a buffer", mib(largest)));
        }
        let (on_device, host) = self.bytes();
        // A discrete GPU keeps what the host sees in the host's memory; the others have one memory for both.
        let needed = if info.kind == "discrete GPU" { on_device } else { on_device + host };
        if needed > info.memory_bytes {
            return too_large("the solve", mib(needed), format!("{} in all", mib(info.memory_bytes)));
        }
        Ok(())
    }
}

impl Level {
    fn new(index: usize, width: u32, height: u32, max_relative_blur: f64) -> Self {
        let factor = f64::from(1u32 << index);
        let size = [half_size(width, index), half_size(height, index)];
        // At least 1 px²: on a coarse level less blur than that says nothing, and V must be free to move.
        let limit = (max_relative_blur / (factor * factor)).max(1.0);
        Self {
            index,
            size,
            factor,
            centre: crate::base::centre(width, height).map(|c| c / factor),
            length: f64::from(size[0]).hypot(size[1].into()) / 4.0,
            limit,
            nodes: node_count(READ_BEYOND * limit),
        }
    }

    /// Workgroups of `linearise`, and so rows of partial sums.
    pub(crate) fn tiles(&self) -> [u32; 3] {
        linearise::tiles(self.size)
    }

    /// Pixels.
    pub(crate) fn pixels(&self) -> u64 {
        pixels(self.size)
    }

    /// Width and height of one colour.
    pub(crate) fn half(&self) -> [u32; 2] {
        [self.size[0].div_ceil(2), self.size[1]]
    }
}

/// Of the pyramid: σ 1 px before every other pixel is taken.
pub(crate) fn halving_filter() -> Filter {
    filter::gaussian(1.0)
}

fn pixels([width, height]: [u32; 2]) -> u64 {
    u64::from(width) * u64::from(height)
}

/// A side after so many halvings; pixel i of a level sits on pixel 2i of its parent.
fn half_size(side: u32, halvings: usize) -> u32 {
    side.div_ceil(1 << halvings)
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
        let plan = plan(101, 77);
        let level = &plan.pyramid[2];
        assert_eq!(level.size, [26, 20]);
        assert_eq!(level.centre, [12.5, 9.5]);
    }

    #[test]
    fn smoothness_falls_to_its_value() {
        let plan = plan(256, 256);
        for (level, length) in [(3, 12), (2, 8), (1, 6), (0, 6)] {
            let level = &plan.pyramid[level];
            assert!((plan.smoothness(level, 0) - 0.033).abs() < 1e-12);
            assert_eq!(plan.smoothness(level, length), 0.003);
            assert!(!plan.may_settle(level, length) && plan.may_settle(level, length + 1));
        }
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
