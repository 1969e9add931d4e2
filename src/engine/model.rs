//! What solves dispatch, and with how many iterations: the input of the model of GPUs in `tools/lab`.

use std::sync::Arc;

use bytemuck::Zeroable;

use crate::base::{Channels, Depth, Error, Format, Settings};
use crate::engine::arguments::{Edges, Grid, Indirect};
use crate::engine::plan::{Allocation, Plan};
use crate::engine::script::{Action, CountedPixels, Dispatch, Part, Script, compose};
use crate::engine::slot::Slot;
use crate::engine::stages::cascade::Coarser;
use crate::engine::stages::state::{LevelState, MAX_LEVELS};
use crate::engine::stages::{
    edge, edge_cells, exposure, half_pair, linearise, pixels, relax, relax_grid_tiles, relax_tiles, separable,
    subdivide, update_transform,
};
use crate::engine::sweep::model as sweep;
use crate::engine::vulkan::statistics::{Statistics, null_hardware, statistics};
use crate::engine::vulkan::{Device, Stage, Variant};

/// Invocations of a wave.
const WAVE: u32 = 64;
/// Frames of a sweep.
const FRAMES: usize = 11;

/// A pair that was solved on lavapipe, the largest on the CPU device.
struct Measured {
    title: &'static str,
    size: [u32; 2],
    channels: Channels,
    pixels: CountedPixels,
    /// Iterations of each level, finest first, and before which I2 was warped again: bit n is iteration 2ⁿ.
    levels: &'static [(u32, u32)],
}

/// From the trace of `parfocal bench`: the heat sink in `data`, and `--sizes 1M,4M,16M,5000x4000`. The synthetic pairs
/// are modelled without their few clipped pixels, so that sizes compare.
const PAIRS: [Measured; 5] = [
    Measured {
        title: "heat sink, 2 Mpx",
        size: [1920, 1080],
        channels: Channels::Rgb,
        pixels: CountedPixels::Unmasked,
        levels: &[(10, 0b1111), (8, 0b111), (8, 0b111), (8, 0b111), (6, 0), (14, 0)],
    },
    Measured {
        title: "1 Mpx",
        size: [1000; 2],
        channels: Channels::Gray,
        pixels: CountedPixels::All,
        levels: &[(4, 0), (6, 0), (6, 0b1), (4, 0b1), (6, 0), (14, 0)],
    },
    Measured {
        title: "4 Mpx",
        size: [2000; 2],
        channels: Channels::Gray,
        pixels: CountedPixels::All,
        levels: &[(4, 0), (6, 0), (6, 0), (6, 0b11), (6, 0b11), (8, 0), (14, 0)],
    },
    Measured {
        title: "16 Mpx",
        size: [4000; 2],
        channels: Channels::Gray,
        pixels: CountedPixels::All,
        levels: &[(4, 0), (6, 0), (6, 0), (6, 0b1), (6, 0b11), (6, 0b11), (8, 0), (10, 0)],
    },
    Measured {
        title: "20 Mpx",
        size: [5000, 4000],
        channels: Channels::Gray,
        pixels: CountedPixels::All,
        levels: &[(4, 0), (6, 0), (6, 0), (6, 0b1), (6, 0b11), (6, 0b11), (8, 0), (8, 0)],
    },
];

/// The share of the work of a pass over depth edges that is needed, measured on the heat sink: 0.8 % of its cells have
/// an edge. In its sweep of seven frames 1.0 % have one.
fn share_at_edges(over: Edges) -> f64 {
    match over {
        Edges::Cells(_) => 0.008,
        // Waves within the reach of such a cell.
        Edges::Pixels(_) | Edges::Fused => 0.26,
    }
}

/// A solve, and what its passes did.
pub struct Solve {
    /// What it solves.
    pub title: String,
    /// Width and height, px.
    pub size: [u32; 2],
    scripts: Vec<Script>,
    /// The scripts from this one on search for outlines. A pair does so within its only one.
    search: usize,
    layout: Vec<Allocation>,
    levels: [LevelState; MAX_LEVELS],
}

/// A pass, or a copy.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pass {
    /// The name of its shader.
    pub name: &'static str,
    variant: Variant,
    /// `None` for copies.
    stage: Option<&'static Stage>,
}

impl Pass {
    fn of(stage: &'static Stage, variant: Variant) -> Self {
        Self { name: stage.shader.name, variant, stage: Some(stage) }
    }

    /// The name of its shader, and its variant.
    pub fn label(&self) -> String {
        let flags: String = (2..7).map(|id| if self.variant.has(Variant::flag(id)) { '1' } else { '0' }).collect();
        format!("{} {flags}", self.name)
    }

    /// A copy.
    pub fn copy(name: &'static str) -> Self {
        Self { name, ..Self::default() }
    }
}

/// Compiles passes on a machine without their GPU.
pub struct Compiler(Arc<Device>);

impl Compiler {
    /// Opens Mesa's null hardware.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::Vulkan`].
    pub fn open() -> Result<Self, Error> {
        null_hardware().map(Self)
    }

    /// The name and the version of the driver.
    pub fn driver(&self) -> &str {
        &self.0.info().driver
    }

    /// What the driver's compiler states about a pass; `None` for a copy.
    ///
    /// # Errors
    /// [`Error::Vulkan`].
    pub fn statistics(&self, pass: Pass) -> Result<Option<Statistics>, Error> {
        pass.stage.map(|stage| statistics(&self.0, stage, pass.variant)).transpose()
    }
}

/// An entry of a script as the GPU executes it.
#[derive(Default)]
pub struct Work {
    /// The pass.
    pub pass: Pass,
    /// Its level, 0 the finest.
    pub level: usize,
    /// Zero for copies, and for dispatches that are not needed.
    pub waves: f64,
    /// The compulsory traffic.
    pub bytes: f64,
    /// Whether a barrier precedes it.
    pub waits: bool,
    /// Whether it belongs to the search for outlines.
    pub is_at_edges: bool,
    /// The rounds of its loops, as a share of those that the compiler counts.
    pub rounds: f64,
    /// The pass that the last workgroup runs when all others are done, and the rounds of its loops.
    pub last: Option<(Pass, f64)>,
}

impl Solve {
    fn pair(pair: &Measured) -> Result<Self, Error> {
        let [width, height] = pair.size;
        let format = Format { channels: pair.channels, depth: Depth::U8 };
        let plan = Plan::new(width, height, [format; 2], &Settings::default())?;
        let scripts = vec![compose(&plan, pair.pixels)];
        let mut levels = [LevelState::zeroed(); MAX_LEVELS];
        for (level, &(iterations, warps)) in levels.iter_mut().zip(pair.levels) {
            (level.iterations, level.warps) = (iterations, warps);
        }
        let title = format!("pair, {}", pair.title);
        Ok(Self { title, size: pair.size, scripts, search: 1, layout: plan.pair_layout(), levels })
    }

    /// The registration of a pair, the first parts of its solve.
    fn registration(pair: &Measured) -> Result<Self, Error> {
        let mut solve = Self::pair(pair)?;
        solve.title = format!("registration, {}", pair.title);
        solve.scripts.iter_mut().for_each(|script| script.parts.truncate(script.registered));
        Ok(solve)
    }

    fn sweep(size: [u32; 2], title: &str) -> Result<Self, Error> {
        let plan = sweep::plan(size, Format { channels: Channels::Gray, depth: Depth::U8 })?;
        let (mut scripts, outlines) = sweep::scripts(&plan, FRAMES);
        let (search, layout) = (scripts.len(), plan.sweep_layout(FRAMES as u32));
        scripts.extend(outlines);
        let title = format!("sweep of {FRAMES}, {title}");
        Ok(Self { title, size, scripts, search, layout, levels: [LevelState::zeroed(); MAX_LEVELS] })
    }

    /// All solves of the model.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`] or [`Error::TooLarge`] if no plan can be made.
    pub fn all() -> Result<Vec<Self>, Error> {
        let sweeps = PAIRS[1..4].iter().map(|pair| Self::sweep(pair.size, pair.title));
        PAIRS.iter().map(Self::pair).chain(PAIRS.iter().map(Self::registration)).chain(sweeps).collect()
    }

    /// The batches of command buffers that are submitted.
    pub fn batches(&self) -> usize {
        self.scripts.iter().flat_map(|script| &script.parts).filter(|part| part.ends_batch).count()
    }

    /// What the GPU executes. Parts in which no dispatch is needed are skipped by conditional rendering, and so are
    /// passes that would warp I2 again. Elsewhere a dispatch that is not needed is executed with no workgroups.
    pub fn work(&self) -> Vec<Work> {
        let mut all = Vec::new();
        let scripts = self.scripts.iter().enumerate();
        for (script_index, script, part) in
            scripts.flat_map(|(n, script)| script.parts.iter().map(move |part| (n, script, part)))
        {
            if dispatches(part).next().is_some() && !dispatches(part).any(|dispatch| self.needs(dispatch)) {
                continue;
            }
            let mut level = dispatches(part).next().map_or(0, |dispatch| dispatch.place.level);
            for (n, entry) in part.entries.iter().enumerate() {
                let work = match &entry.action {
                    Action::Dispatch(dispatch)
                        if matches!(dispatch.grid, Grid::Indirect(Indirect::IfMoved { .. }))
                            && !self.needs(dispatch) =>
                    {
                        continue;
                    }
                    Action::Dispatch(dispatch) => self.dispatch(script, dispatch),
                    transfer => self.transfer(transfer, level),
                };
                level = work.level;
                // A part begins with a barrier.
                let is_at_edges = script_index >= self.search || work.pass.name.starts_with("edge_");
                all.push(Work { waits: entry.waits || n == 0, is_at_edges, ..work });
            }
        }
        all
    }

    /// Whether a dispatch has workgroups.
    fn needs(&self, dispatch: &Dispatch) -> bool {
        dispatch.place.executed(dispatch.grid, &[self.levels; 2])
    }

    fn dispatch(&self, script: &Script, dispatch: &Dispatch) -> Work {
        let (groups, share) = match dispatch.grid {
            Grid::Direct(groups) => (groups, 1.0),
            Grid::Indirect(Indirect::Edges { levels, over }) => {
                (groups_at_edges(script, levels, over), share_at_edges(over))
            }
            Grid::Indirect(indirect) => (std::array::from_fn(|n| script.arguments[indirect.word() + n]), 1.0),
        };
        let needed = if self.needs(dispatch) { 1.0 } else { 0.0 };
        let groups: f64 = groups.map(f64::from).iter().product();
        let [width, height] = dispatch.stage.workgroup;
        Work {
            pass: Pass::of(dispatch.stage, dispatch.variant),
            level: dispatch.place.level,
            waves: needed * share * groups * f64::from((width * height).div_ceil(WAVE)),
            bytes: needed * bytes(dispatch) * share_of_tiles(dispatch, groups),
            rounds: rounds(dispatch),
            last: (dispatch.stage.shader.name == "linearise").then(|| {
                let c: linearise::Constants = bytemuck::pod_read_unaligned(&dispatch.constants);
                let rows = c.step_constants().rows;
                (Pass::of(&update_transform::STAGE, dispatch.variant), rounds_of_step(rows, dispatch.variant))
            }),
            ..Work::default()
        }
    }

    /// A copy, with the bytes that it reads and writes.
    fn transfer(&self, action: &Action, level: usize) -> Work {
        let bytes = |slot: Slot| self.layout.iter().find(|a| a.slot == slot).map_or(0, Allocation::bytes);
        let layer_bytes = |slot: Slot| self.layout.iter().find(|a| a.slot == slot).map_or(0, Allocation::layer_bytes);
        let (name, bytes) = match action {
            Action::Copy { from, to, .. } => ("copy", 2 * bytes(*from).min(bytes(*to))),
            Action::Clear { image, layers, .. } => ("clear", layers.len() as u64 * layer_bytes(*image)),
            Action::Download { .. } => ("download", 2 * bytes(Slot::EndMaps)),
            Action::Dispatch(_) => unreachable!("it copies nothing"),
        };
        Work { pass: Pass::copy(name), level, bytes: bytes as f64, rounds: 1.0, ..Work::default() }
    }
}

/// The workgroups of a pass over depth edges, if all cells have one. None if the script has no such pass.
fn groups_at_edges(script: &Script, levels: usize, over: Edges) -> [u32; 3] {
    let level = |n: usize| {
        let found = script.dispatches().filter_map(Dispatch::of::<edge_cells::Bindings>);
        let place = Edges::Cells(n).word(levels) as u32;
        found.map(|(_, constants, _)| constants).find(|c| c.argument_place == place)
    };
    let groups = match over {
        Edges::Fused => level(0).map(|c| c.fused),
        Edges::Cells(n) => level(n).map(|c| edge::cells([c.width, c.height])),
        Edges::Pixels(n) => level(n).map(|c| c.pixels),
    };
    groups.map_or([0; 3], |[x, y]| [x, y, 1])
}

fn dispatches(part: &Part) -> impl Iterator<Item = &Dispatch> {
    part.entries.iter().filter_map(|entry| if let Action::Dispatch(d) = &entry.action { Some(d) } else { None })
}

/// The compulsory traffic of a dispatch. `shape` returns at once where the blur is Gaussian, as in these pairs.
fn bytes(dispatch: &Dispatch) -> f64 {
    if dispatch.stage.shader.name == "shape" { 0.0 } else { dispatch.bytes as f64 }
}

/// The rounds of the loop in which a pass spends its time, as a share of those that the compiler counts: 8, in a loop
/// within it 4 for each, and 2 in those within that. 1 for passes whose rounds are not in their push constants.
///
/// Other work of the passes of the relaxation counts as a number of sweeps: by the latency on navi21, as compiled
/// without the loop over sweeps and with one round of it.
fn rounds(dispatch: &Dispatch) -> f64 {
    let c = &dispatch.constants;
    match (dispatch.stage.shader.name, dispatch.variant.has(Variant::JOINED)) {
        ("relax_tiles", joined) => {
            let c: relax_tiles::Constants = bytemuck::pod_read_unaligned(c);
            rounds_of_relaxation(if joined { 12.5 } else { 7.3 }, c.sweeps, joined.then_some(c.coarser))
        }
        ("relax_grid_tiles", joined) => {
            let c: relax_grid_tiles::Constants = bytemuck::pod_read_unaligned(c);
            rounds_of_relaxation(4.5, c.sweeps, joined.then_some(c.coarser))
        }
        ("update_transform", _) => {
            let rows = bytemuck::pod_read_unaligned::<update_transform::Constants>(c).rows;
            rounds_of_step(rows, dispatch.variant)
        }
        ("linearise", _) => {
            // In lines, by variant: the fixed cost of an invocation; the step as the compiler counts it, which only the
            // last workgroup takes.
            let [warped, projective] =
                [Variant::WARPED, Variant::PROJECTIVE].map(|flag| usize::from(dispatch.variant.has(flag)));
            let (once, step) = ([[0.6, 0.95], [0.75, 1.1]][warped][projective], [1.0, 1.2][warped]);
            let rows = bytemuck::pod_read_unaligned::<linearise::Constants>(c).rows;
            (once + f64::from(rows)) / (once + 8.0 + step)
        }
        ("exposure", shades) => {
            // In the cost of a sample of a round: the moments, the three rounds of the shading, and what these leave.
            let c: exposure::Constants = bytemuck::pod_read_unaligned(c);
            let [width, height] = exposure::STAGE.workgroup;
            let each = c.samples().div_ceil((width * height) as usize) as f64;
            if shades {
                (8.2 + 3.17 * each + 3.0 * (6.37 + each)) / (8.2 + 3.17 * 8.0 + 8.0 * (6.37 + 4.0))
            } else {
                (1.5 + 2.0 * each) / (1.5 + 2.0 * 8.0)
            }
        }
        ("relax", _) => f64::from(bytemuck::pod_read_unaligned::<relax::Constants>(c).rows) / 8.0,
        ("separable", true) => {
            let [x, y] = bytemuck::pod_read_unaligned::<separable::Constants>(c).blocks;
            // Layers that are not packed have a loop over further chunks of weights, which these filters do not enter.
            let compiled = if dispatch.variant.has(Variant::PACKED) { 8.0 } else { 8.0 + 8.0 * 4.0 };
            f64::from(x.max(y)) / compiled
        }
        _ => 1.0,
    }
}

/// The rounds of the step of T. Its other work takes as long as 19.7 of them.
fn rounds_of_step(rows: u32, variant: Variant) -> f64 {
    (19.7 + f64::from(update_transform::rounds(rows, variant))) / (19.7 + 8.0)
}

/// The rounds of a relaxation of a grid or level, as a share of those that the compiler counts. Its other work takes as
/// long as `once` sweeps, and that of each coarser grid on tiles as long as 3.4. A sweep on a small grid takes 0.49 of
/// one on a tile. In its cost, other work of the small grids takes 3 sweeps once, and 6 for each of them.
fn rounds_of_relaxation(once: f64, sweeps: u32, coarser: Option<Coarser>) -> f64 {
    let Some(c) = coarser else { return (once + f64::from(sweeps)) / (once + 8.0) };
    let rounds = |sweeps: [f64; 3], tiles: f64, small: f64| {
        once + sweeps[0] + tiles * (3.4 + sweeps[1]) + 0.49 * (3.0 + 6.0 * small + sweeps[2])
    };
    let on_small = c.coarsest_sweeps + (c.small_grids - 1) * sweeps;
    let each = [sweeps, sweeps, on_small].map(f64::from);
    rounds(each, c.grids.into(), c.small_grids.into()) / rounds([8.0, 4.0, 8.0 * 4.0], 8.0, 8.0)
}

/// The share of the image that the listed tiles of a sweep cover; 1 for passes over the whole image.
fn share_of_tiles(dispatch: &Dispatch, tiles: f64) -> f64 {
    let c = &dispatch.constants;
    let (tile, size) = match (dispatch.stage.shader.name, dispatch.variant.has(Variant::LISTED)) {
        ("half_pair", _) => {
            let c: half_pair::Constants = bytemuck::pod_read_unaligned(c);
            (half_pair::TILE, [c.width, c.height])
        }
        ("separable", true) => {
            let c: separable::Constants = bytemuck::pod_read_unaligned(c);
            let stride = separable::stride(dispatch.variant);
            (
                separable::tile(stride, dispatch.variant.has(Variant::ANY)),
                [c.width, c.height].map(|side| side.div_ceil(stride)),
            )
        }
        ("subdivide", true) => {
            let c: subdivide::Constants = bytemuck::pod_read_unaligned(c);
            (subdivide::STAGE.workgroup.map(|side| 2 * side), [c.width, c.height])
        }
        _ => return 1.0,
    };
    (tiles * pixels(tile[0], tile[1]) as f64 / pixels(size[0], size[1]) as f64).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the passes of a name do.
    fn of<'a>(work: &'a [Work], name: &'a str) -> impl Iterator<Item = &'a Work> {
        work.iter().filter(move |work| work.pass.name == name)
    }

    #[test]
    fn passes_run_as_often_as_their_levels_have_iterations() {
        let pair = &PAIRS[1];
        let work = Solve::pair(pair).unwrap().work();
        for (level, &(iterations, warps)) in pair.levels.iter().enumerate() {
            let count = |name| of(&work, name).filter(|work| work.level == level && work.waves > 0.0).count() as u32;
            assert_eq!(count("linearise"), iterations, "level {level}");
            assert_eq!(count("relax_tiles"), iterations - 1, "level {level}");
            // A level is warped before its first iteration, except for the two coarsest.
            let first = u32::from(level + 2 < pair.levels.len());
            assert_eq!(count("warp"), first + warps.count_ones(), "level {level}");
        }
        // A level settles after an odd iteration: the rest of this iteration is executed with no workgroups.
        let skipped = of(&work, "relax_tiles").filter(|work| work.waves == 0.0);
        assert_eq!(skipped.count(), pair.levels.len());
        assert!(
            work.iter().filter(|work| work.pass.stage.is_some() && work.waves == 0.0).all(|work| work.bytes == 0.0)
        );
    }

    #[test]
    fn a_registration_ends_before_the_results() {
        let [solve, registration] = [Solve::pair, Solve::registration].map(|solve| solve(&PAIRS[1]).unwrap());
        assert_eq!(registration.scripts[0].parts.len() + 1, solve.scripts[0].parts.len());
        let passes = ["linearise", "uncertainty", "edge_costs", "fuse"];
        let counts = |solve: &Solve| passes.map(|name| of(&solve.work(), name).count());
        let ([all, uncertainty, edges, fused], [registering, rest @ ..]) = (counts(&solve), counts(&registration));
        assert_eq!((registering, rest), (all, [0; 3]));
        assert_eq!([uncertainty, edges, fused], [1, Edges::COARSEST + 1, 1]);
    }

    #[test]
    fn waves_and_bytes_are_those_of_the_whole_image() {
        let pair = &PAIRS[1];
        let work = Solve::pair(pair).unwrap().work();
        // 16 x 250 workgroups of 64 x 4 invocations. V, its standard deviation and terms: 21 bytes per pixel.
        let whole: Vec<_> = of(&work, "uncertainty").map(|work| (work.waves, work.bytes)).collect();
        assert_eq!(whole, [(16.0 * 250.0 * 4.0, 21e6)]);
        // V of the coarsest level, 32 x 32 px; the sides of edges.
        let cleared: Vec<f64> = of(&work, "clear").map(|work| work.bytes).collect();
        assert_eq!(cleared, [4.0 * 32.0 * 32.0, 4e6]);
        // V, its deviation, the residual and the grey fused image, read and written.
        let downloaded: Vec<f64> = of(&work, "download").map(|work| work.bytes).collect();
        assert_eq!(downloaded, [32e6]);
        // 62, 125 and 250 cells along a side: workgroups of two waves.
        let edges: Vec<f64> = of(&work, "edge_costs").map(|work| work.waves).collect();
        let waves = |side: f64| share_at_edges(Edges::Cells(0)) * side * side * 2.0;
        assert_eq!(edges, [62.0, 125.0, 250.0].map(waves));
    }

    #[test]
    fn rounds_of_loops_are_those_of_the_constants() {
        let work = Solve::pair(&PAIRS[1]).unwrap().work();
        let rounds = |name, level| of(&work, name).find(|work| work.level == level).unwrap().rounds;
        // Three sweeps, and what takes as long as 7.3.
        assert_eq!(rounds("relax_tiles", 0), (7.3 + 3.0) / 15.3);
        // Grids of 16 x 16 and 8 x 8 cells before the level: 3 sweeps and 30.
        let compiled = 12.5 + 8.0 + 8.0 * 7.4 + 0.49 * (3.0 + 8.0 * 6.0 + 32.0);
        assert_eq!(rounds("relax_tiles", 5), (12.5 + 3.0 + 0.49 * (3.0 + 2.0 * 6.0 + 33.0)) / compiled);
        // The grid of 250 cells along a side, after those of 63 and 125 and three small ones.
        let compiled = compiled - 12.5 + 4.5;
        let small = 0.49 * (3.0 + 3.0 * 6.0 + 36.0);
        assert!((rounds("relax_grid_tiles", 0) - (4.5 + 3.0 + 2.0 * 6.4 + small) / compiled).abs() < 1e-12);
        // Lines per invocation: two on small levels; and what takes as long as 0.6, with a warped I2 as 1.1.
        assert_eq!(
            [5, 0].map(|level| rounds("linearise", level)),
            [(0.6 + 2.0) / 9.6, (1.1 + 16.0) / (1.1 + 8.0 + 1.2)]
        );
        // 16 x 16 workgroups: 8 chains of 32 rows, 4 at once.
        let step = of(&work, "linearise").find(|work| work.level == 0).unwrap().last.unwrap();
        assert_eq!(step.1, rounds_of_step(256, step.0.variant));
        assert_eq!(rounds("system_tiles", 0), 1.0);
    }

    #[test]
    fn passes_of_a_sweep_run_where_a_frame_is_nearly_in_focus() {
        let solve = Solve::sweep([1000; 2], "1 Mpx").unwrap();
        let work = solve.work();
        let finest: Vec<f64> = of(&work, "half_pair").filter(|work| work.level == 0).map(|work| work.bytes).collect();
        // Frames at distances of 1 and 2 settings, each the sharper one of a pair once.
        assert_eq!(finest.len(), 2 * (10 + 9));
        // c is 0.36 px² of variance by squared settings: a blur of 1 px² is reached 1.67 settings away, a sixth of the
        // image on either side. Two tiles of 64 px reach beyond.
        let largest = finest.iter().copied().fold(0.0, f64::max) / 40e6;
        assert!((1.0 / 3.0..1.0 / 3.0 + 0.13).contains(&largest), "{largest}");
        // The spline and u are read, the frame is written.
        assert!(of(&work, "align").all(|work| work.bytes <= 12e6));
        // Levels 2, 1 and 0 use 2, 3 and 6 frames, at most 1.5 px of blur apart, and all their pairs. On level 0 the
        // first and the last frame, 6 px apart, are no pair.
        let pairs = [2, 1, 0].map(|n| of(&work, "edge_costs").filter(|work| work.level == n).count());
        assert_eq!(pairs, [1, 3, 15 - 1]);
    }
}
