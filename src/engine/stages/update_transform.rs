//! Updates T by the registration step and determines whether a level has settled.
//!
//! It solves `N ζ = -g` with the sums of [`linearise`](super::linearise), or descends the gradient. Section 5 of
//! `docs/method.md`.

use super::pass::{Memory, Pass};
use super::state::Registration;
use super::sums::{Layout, Sums, UNKNOWNS};
use super::{Number, WORKGROUP};
use crate::base::{Homography, Parallax, Shading};

pub use super::interface::update_transform::*;
pub use crate::engine::shaders::sums::Step;
pub(crate) use crate::engine::shaders::sums::{DESCENDS, FINDS_ALPHA, MAY_SETTLE, MAY_WARP, STEPS};
#[cfg(feature = "program")]
use crate::engine::shaders::update_transform::{AT_ONCE, MOST_CHAINS};
use crate::engine::vulkan::Variant;
use crate::engine::{arguments, shaders};

// The shader clears the words of a level by one per invocation.
const _: () = assert!(arguments::WORDS <= (WORKGROUP[0] * WORKGROUP[1]) as usize);
// An invocation for each element of N and of the right side.
const _: () = assert!(UNKNOWNS * (UNKNOWNS + 1) <= (WORKGROUP[0] * WORKGROUP[1]) as usize);

impl Step {
    /// Whether a flag is set.
    pub fn is(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }

    /// The whole step of a similarity on level 1, which may not settle.
    #[cfg(test)]
    pub(super) fn of_tests() -> Self {
        Self {
            level: 1,
            energy_place: 2,
            unknowns: 4,
            flags: 0,
            still: 0.001,
            share: 1.0,
            steady: 0.0,
            steady_by_tiles: 0.0,
            flatness: 1e-5,
            most_moving: 0.2,
            most_far: 0.03,
            least_spread: 0.0025,
        }
    }
}

impl Pass for Bindings {
    /// Compulsory traffic: the partial sums.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        4 * Layout::of_variant(variant).length as u64 * u64::from(c.rows)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let sums = memory.sums(self.partials, Layout::of_variant(variant));
        let start = memory.words(self.start_arguments).to_vec();
        let state = memory.state_mut(self.updated);
        let level = c.t_step.level as usize;
        let step = cpu_reference(
            c,
            &sums,
            &mut state.registration,
            state.levels[level].energy,
            [&mut state.moving, &mut state.moving_far, &mut state.at_limit].map(|count| std::mem::take(count).into()),
        );
        let settled = step.settled && state.parallax_moves == 0;
        state.variance = sums.variance[0] / sums.variance[1].max(1e-30);
        if level == 0 && step.steady {
            state.spread = find_spread(c, &sums, state.spread);
        }
        if c.t_step.is(FINDS_ALPHA) {
            state.alpha = find_alpha(&sums, state.alpha);
        }
        // With parallax I2 is not warped.
        let has_parallax = state.parallax != Parallax::NONE;
        let follows = (has_parallax || !moved_away(c, &state.warped, &state.registration))
            && shading_stays(&state.shading, &state.applied_shading);
        let cancelled = start.last().is_some_and(|&last| last != arguments::NOT_CANCELLED);
        let ends = settled || cancelled;
        let warps = c.t_step.is(MAY_WARP) && !ends && !follows;
        state.degenerate = step.degenerate.into();
        let progress = &mut state.levels[level];
        if warps {
            progress.warps |= 1 << (progress.iterations + 1).ilog2();
        }
        progress.iterations += 1;
        (progress.energy, progress.valid, progress.moving) = (step.energy, sums.valid, step.moving);
        progress.settled = settled.into();
        if cancelled {
            state.levels[..=level].iter_mut().for_each(|level| level.settled = 1);
        }
        let place = c.t_step.energy_place as usize;
        memory.numbers_mut(self.energies, place + 1)[place] = N::of(step.energy);
        let (words, [own, warping]) = (memory.words_mut(self.arguments), arguments::words(level));
        if ends {
            words[if cancelled { 0..own.end } else { own }].fill(0);
        }
        if warps {
            words[warping.clone()].copy_from_slice(&start[warping]);
        } else if c.t_step.is(MAY_WARP) {
            words[warping].fill(0);
        }
    }
}

/// How often invocations wait for rows of partial sums, one after the other.
#[cfg(feature = "program")]
pub(crate) fn rounds(rows: u32, variant: Variant) -> u32 {
    let chains = (WORKGROUP[0] * WORKGROUP[1] / Layout::of_variant(variant).length as u32).min(MOST_CHAINS);
    rows.div_ceil(chains * AT_ONCE)
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stepped {
    /// Energy per valid pixel, before the step.
    pub energy: f64,
    /// T and V are at rest: the level has no more iterations.
    pub settled: bool,
    /// The share of the valid pixels that moved, of those below the limit of |V|.
    pub moving: f64,
    /// It had unknowns that the images do not determine.
    pub degenerate: bool,
    /// No corner moved by `FOLLOWED` pixels of the level: errors of T no longer count as noise.
    pub steady: bool,
}

/// Updates T. `before` is the energy of the previous iteration. Its step moved `moving` pixels by more than a tenth of
/// their standard deviation and `far` by more than half of it, and left `at_limit` at the limit of |V|.
pub fn cpu_reference(
    c: &Constants,
    sums: &Sums,
    r: &mut Registration,
    before: f64,
    [moving, far, at_limit]: [f64; 3],
) -> Stepped {
    let factor = f64::from(c.factor);
    let (x, degenerate) = solve(c, sums);
    let decrease: f64 = -x.iter().zip(&sums.gradient).map(|(x, g)| x * g).sum::<f64>();
    let step = displacing(c.scale_length.into(), factor, x.map(|x| f64::from(c.t_step.share) * x));
    let moved = corner_moves(c, &step);
    *r = r.after(&step);
    let energy = sums.energy / sums.valid.max(1.0);
    let change = (energy - before).abs();
    let free = (sums.valid - at_limit).max(LEAST_FREE * sums.valid).max(1.0);
    let share = moving / free;
    let few = share <= f64::from(c.t_step.most_moving) && far <= f64::from(c.t_step.most_far) * sums.valid;
    let variance = sums.variance[0] / sums.variance[1].max(1e-30);
    let by_tiles = if sums.tiles > TOO_FEW { sums.scatter / (sums.normal[0][0] + sums.normal[1][1]) } else { 0.0 };
    let is_steady =
        decrease < f64::from(c.t_step.steady) * variance || decrease < f64::from(c.t_step.steady_by_tiles) * by_tiles;
    let settled = c.t_step.is(MAY_SETTLE)
        && (moved < f64::from(c.t_step.still) * factor || is_steady)
        && few
        && change <= f64::from(c.t_step.flatness) * before;
    Stepped { energy, settled, moving: share, degenerate, steady: moved <= FOLLOWED * factor }
}

/// Pixels at the limit of |V| rest, whatever the others do, so shares are of the others. If these are less than a tenth
/// of the valid pixels, most are at depth edges, and some move on. The count at the limit is of pixels with data in
/// their window: beside masks it has a few more than the valid ones.
const LEAST_FREE: f64 = shaders::update_transform::LEAST_FREE;

/// This many tiles or fewer are too few for a variance.
pub(crate) const TOO_FEW: f64 = shaders::update_transform::TOO_FEW;

/// The map with these displacements, in pixels of a level that are `factor` wide, with places divided by `length`.
pub fn displacing(length: f64, factor: f64, x: [f64; UNKNOWNS]) -> Homography {
    let [tx, ty, zoom, turn, stretch, shear, gx, gy] = x;
    let over = 1.0 / (factor * length * length);
    let linear = |v: f64| v / length;
    let matrix = [
        [1.0 + linear(zoom + stretch), linear(shear - turn), factor * tx],
        [linear(turn + shear), 1.0 + linear(zoom - stretch), factor * ty],
        [gx * over, gy * over, 1.0],
    ];
    // A step that mirrors the image becomes the identity.
    Homography::from_matrix(matrix).unwrap_or_default()
}

/// The most that a displacement moves a corner, full-size pixels: by t, by the larger singular value of the linear part
/// times the distance of the corner from the centre, and by g times its square.
fn corner_moves(c: &Constants, step: &Homography) -> f64 {
    let corner = f64::from(c.factor) * f64::from(c.half_size[0]).hypot(c.half_size[1].into());
    let [[xx, xy, tx], [yx, yy, ty], [gx, gy, _]] = step.matrix();
    let linear = 0.5 * ((xx + yy - 2.0).hypot(yx - xy) + (xx - yy).hypot(xy + yx));
    tx.hypot(ty) + (linear + gx.hypot(gy) * corner) * corner
}

/// I2 is warped again once a corner has moved by more, pixels of the level.
const FOLLOWED: f64 = shaders::update_transform::FOLLOWED;

/// Whether T has moved so far since `before` that gradients no longer follow it.
pub(crate) fn moved_away(c: &Constants, before: &Registration, r: &Registration) -> bool {
    corner_moves(c, &r.moved_since(before).transform) > FOLLOWED * f64::from(c.factor)
}

/// I2 is warped again once the shading has changed by more: a thousandth of the contrast is 0.01 px² of V.
const EVEN: f64 = shaders::update_transform::EVEN;

fn shading_stays(now: &Shading, applied_shading: &Shading) -> bool {
    let pairs = now.coefficients.iter().zip(&applied_shading.coefficients);
    pairs.map(|(now, before)| (now - before).abs()).sum::<f64>() <= EVEN
}

/// Bounds of α.
const ALPHAS: [f64; 2] = [shaders::update_transform::LEAST_ALPHA, shaders::update_transform::MOST_ALPHA];
/// Bounds of the steepness of V for the estimate of α, px² per pixel. Flatter V counts as flat: a larger α would
/// converge too slowly to help. Steeper V is noise, which a smaller α would increase.
const STEEP: [f64; 2] = [shaders::update_transform::LEAST_STEEP, shaders::update_transform::MOST_STEEP];

/// The most that the spread grows by in an iteration.
const MOST_GROWTH: f64 = shaders::update_transform::MOST_GROWTH;

/// The spread, from the mean of the [bounded squares](super::linearise::BOUND), which is a half where it is right. For
/// Gaussian noise an error falls to a fifth per iteration.
pub fn find_spread(c: &Constants, sums: &Sums, spread: f64) -> f64 {
    let share = sums.spread / sums.valid.max(1.0);
    spread.max(c.t_step.least_spread.into()) * (share / (1.0 - share).max(1e-6)).min(MOST_GROWTH)
}

/// α from the mean √|b| of the data and the steepness of V. It changes only by more than a tenth, since each change
/// takes iterations.
pub fn find_alpha(sums: &Sums, alpha: f64) -> f64 {
    let [root, steep] = sums.roughness.map(|sum| sum / sums.valid.max(1.0));
    let estimate = (0.14 * root * root / steep.clamp(STEEP[0], STEEP[1])).clamp(ALPHAS[0], ALPHAS[1]);
    if (estimate / alpha).ln().abs() > 0.1 { estimate } else { alpha }
}

/// The step of T, and whether it has unknowns that the images do not determine. By Cholesky's decomposition of N scaled
/// to a unit diagonal; or down the gradient, divided by the sum of N's row. Unknowns that are held or undetermined take
/// no step.
fn solve(c: &Constants, sums: &Sums) -> ([f64; UNKNOWNS], bool) {
    let n = |i: usize, j: usize| sums.normal[i][j];
    let most = (0..UNKNOWNS).map(|i| n(i, i)).fold(0.0, f64::max);
    // 1e-7: stripes leave a gradient 3e-4 as steep as the others', by rounding.
    let least = f64::max(1e-12 * sums.valid, 1e-7 * most);
    let unseen: [bool; UNKNOWNS] = std::array::from_fn(|i| n(i, i).is_nan() || n(i, i) <= least);
    let mut held: [bool; UNKNOWNS] = std::array::from_fn(|i| unseen[i] || i >= c.t_step.unknowns as usize);
    let mut degenerate =
        sums.valid.is_nan() || sums.valid <= 0.0 || unseen[..c.t_step.unknowns as usize].contains(&true);
    if c.t_step.is(DESCENDS) {
        let row = |i: usize| (0..UNKNOWNS).filter(|&j| !held[j]).map(|j| n(i, j).abs()).sum::<f64>();
        return (std::array::from_fn(|i| if held[i] { 0.0 } else { -sums.gradient[i] / row(i) }), degenerate);
    }
    let scale: [f64; UNKNOWNS] = std::array::from_fn(|i| if held[i] { 0.0 } else { 1.0 / n(i, i).sqrt() });
    let mut l = [[0.0; UNKNOWNS]; UNKNOWNS];
    for j in 0..UNKNOWNS {
        let pivot = 1.0 - l[j][..j].iter().map(|l| l * l).sum::<f64>();
        // 1e-5: below it single precision has no digits of this unknown left.
        if pivot.is_nan() || pivot <= 1e-5 {
            (held[j], degenerate) = (true, true);
        }
        l[j][j] = if held[j] { 1.0 } else { pivot.sqrt() };
        for i in j + 1..UNKNOWNS {
            let sum = n(i, j) * scale[i] * scale[j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if held[j] { 0.0 } else { sum / l[j][j] };
        }
    }
    let mut x: [f64; UNKNOWNS] = std::array::from_fn(|i| -sums.gradient[i] * scale[i]);
    for i in 0..UNKNOWNS {
        let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = if held[i] { 0.0 } else { (x[i] - known) / l[i][i] };
    }
    for i in (0..UNKNOWNS).rev() {
        let known: f64 = (i + 1..UNKNOWNS).map(|k| l[k][i] * x[k]).sum();
        x[i] = if held[i] { 0.0 } else { (x[i] - known) / l[i][i] };
    }
    (std::array::from_fn(|i| x[i] * scale[i]), degenerate)
}

#[cfg(test)]
mod tests {
    use super::super::NO_VARIANT;
    use super::super::harness::{Rig, random};
    use super::super::state::{DoubleState, Single, State};
    use super::super::sums::row;
    use super::*;
    use crate::base::{Photometric, Similarity};
    use crate::engine::vulkan::Resource;

    fn constants(rows: u32) -> Constants {
        Constants {
            rows,
            factor: 2.0,
            scale_length: 30.0,
            half_size: [60.0, 40.0],
            t_step: Step { energy_place: 3, flags: MAY_SETTLE, ..Step::of_tests() },
        }
    }

    /// The constants with another number of unknowns and other flags.
    fn with(c: Constants, unknowns: u32, flags: u32) -> Constants {
        Constants { t_step: Step { unknowns, flags, ..c.t_step }, ..c }
    }

    /// The words of three levels: of each the first two are those of the grids and of the warping passes.
    fn of_levels(words: [[u32; 2]; 3]) -> Vec<u32> {
        let level = |n: usize| {
            let [own, warping] = arguments::words(n);
            let [grids, warps] = words[n];
            [vec![grids; own.len() - warping.len()], vec![warps; warping.len()]].concat()
        };
        (0..3).flat_map(level).collect()
    }

    const ALL: [[u32; 2]; 3] = [[7; 2]; 3];

    /// Partial sums of a well-posed problem: a few random residuals per row.
    fn partials(rows: usize, pixels: usize, layout: Layout) -> Vec<f32> {
        let numbers = random(rows * pixels * 5, 11);
        let residuals: Vec<_> = numbers
            .chunks_exact(5)
            .map(|n| ([n[0] - 0.5, n[1] - 0.5], 0.01 * (n[2] - 0.5), [4.0 * n[3] - 2.0, 4.0 * n[4] - 2.0]))
            .collect();
        residuals.chunks_exact(pixels).flat_map(|residuals| row(residuals, layout)).collect()
    }

    /// The state, the arguments and the energies after the pass.
    fn run(
        c: &Constants,
        variant: Variant,
        partials: &[f32],
        state: &State,
        [words, start_words]: [&[u32]; 2],
    ) -> (State, Vec<u32>, Vec<f32>) {
        let rig = Rig::new();
        let buffers = [
            rig.upload(bytemuck::cast_slice(partials)),
            rig.upload(bytemuck::bytes_of(state)),
            rig.upload(&[0; 32]),
            rig.upload(bytemuck::cast_slice(words)),
            rig.upload(bytemuck::cast_slice(start_words)),
        ];
        rig.run_variant(&STAGE, variant, &buffers.each_ref().map(Resource::Buffer), c, [1, 1, 1]);
        (rig.value(&buffers[1]), rig.words(&buffers[3]), rig.floats(&buffers[2]))
    }

    fn identity() -> State {
        State::new(&DoubleState::default().registration)
    }

    fn check(c: Constants, partials: &[f32], before: f32) -> (State, Vec<u32>) {
        check_warped(c, partials, before, [0.0; 2], NO_VARIANT)
    }

    /// `t` is T's translation when I2 was last warped; its other terms are those of the start.
    fn check_warped(c: Constants, partials: &[f32], before: f32, t: [f32; 2], variant: Variant) -> (State, Vec<u32>) {
        let start = Registration::new(Similarity::new(1.0, -2.0, 1.0, 1.05), &Photometric { gain: 0.9, offset: 0.1 });
        let mut state = State::new(&start);
        state.levels[c.t_step.level as usize].energy = before;
        state.warped = Single { tx: t[0], ty: t[1], ..state.registration };
        let start_words = [of_levels([[9; 2]; 3]), vec![arguments::NOT_CANCELLED]].concat();
        let (actual, words, energies) = run(&c, variant, partials, &state, [&of_levels(ALL), &start_words]);
        let sums = Sums::from_partials(partials, Layout::of_variant(variant));
        let mut expected = state.registration();
        let step = cpu_reference(
            &c,
            &sums,
            &mut expected,
            before.into(),
            [state.moving, state.moving_far, state.at_limit].map(f64::from),
        );
        let corner = actual.registration().transform.corner_distance(expected.transform, 121, 81);
        // Single precision of sums of up to 4000 residuals.
        assert!(corner < 1e-4, "{corner} px: {actual:?} {expected:?}");
        assert_eq!(actual.registration().photometric(), state.registration().photometric());
        let close = |f: f64, e: f64| assert!((f - e).abs() < 1e-5, "{f}, not {e}");
        close(actual.levels[c.t_step.level as usize].energy.into(), step.energy);
        let is_found = c.t_step.level == 0 && step.steady;
        close(actual.spread.into(), if is_found { find_spread(&c, &sums, state.spread.into()) } else { 0.0 });
        close(energies[3].into(), step.energy);
        assert_eq!(actual.levels[c.t_step.level as usize].iterations, 1);
        close(
            actual.alpha.into(),
            if c.t_step.is(FINDS_ALPHA) { find_alpha(&sums, state.alpha.into()) } else { state.alpha.into() },
        );
        assert_eq!(actual.levels[c.t_step.level as usize].settled, u32::from(step.settled));
        (actual, words)
    }

    #[test]
    fn alpha_follows_the_data_and_the_steepness_of_v() {
        let layout = Layout::of_variant(NO_VARIANT);
        for (root, steep) in [(0.03, 0.03), (0.2, 1.0), (1e-4, 0.03), (0.06, 1e-6), (0.0294, 0.04)] {
            let mut partials = partials(8, 40, layout);
            for row in partials.chunks_exact_mut(layout.length) {
                let valid = row[layout.energy + 1];
                row[layout.energy + 2..layout.energy + 5].copy_from_slice(&[root * valid, steep * valid, 0.7 * valid]);
            }
            for finds_alpha in [0, FINDS_ALPHA] {
                check(with(constants(8), 4, MAY_SETTLE | finds_alpha), &partials, 0.1);
                let finest = Step { level: 0, unknowns: 0, ..constants(8).t_step };
                check(Constants { t_step: finest, ..constants(8) }, &partials, 0.1);
            }
        }
    }

    #[test]
    fn settles_only_when_allowed_and_zeroes_its_own_arguments() {
        let partials = partials(8, 40, Layout::of(false));
        let held = with(constants(8), 0, MAY_SETTLE);
        let energy = check(held, &partials, 0.1).0.levels[1].energy;
        let (state, arguments) = check(held, &partials, energy);
        assert_eq!(state.levels[1].settled, 1);
        assert_eq!(arguments, of_levels([[7; 2], [0; 2], [7; 2]]));
        let (state, arguments) = check(held, &partials, 1.0005 * energy);
        assert_eq!(state.levels[1].settled, 0);
        assert_eq!(arguments, of_levels(ALL));
        let (state, arguments) = check(with(held, 0, 0), &partials, energy);
        assert_eq!(state.levels[1].settled, 0);
        assert_eq!(arguments, of_levels(ALL));
    }

    #[test]
    fn warps_again_where_t_has_moved() {
        let partials = partials(8, 40, Layout::of(false));
        let held = with(constants(8), 0, MAY_WARP);
        // The start is at (1, -2); 0.02 px of a level of factor 2 are 0.04 px.
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.0, -2.0], NO_VARIANT);
        assert_eq!(arguments, of_levels([[7; 2], [7, 0], [7; 2]]));
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.035, -2.0], NO_VARIANT);
        assert_eq!(arguments, of_levels([[7; 2], [7, 0], [7; 2]]));
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.0, -2.045], NO_VARIANT);
        assert_eq!(arguments, of_levels([[7; 2], [7, 9], [7; 2]]));
        let none = with(held, 0, 0);
        assert_eq!(check_warped(none, &partials, 0.1, [1.0, -2.045], NO_VARIANT).1, of_levels(ALL));
    }

    #[test]
    fn a_cancelled_solve_ends_the_level_and_all_finer_levels() {
        let partials = partials(8, 40, Layout::of(false));
        let c = with(constants(8), 4, MAY_WARP);
        let start_words = [of_levels([[9; 2]; 3]), vec![arguments::CANCELLED]].concat();
        let (state, words, _) = run(&c, NO_VARIANT, &partials, &identity(), [&of_levels(ALL), &start_words]);
        assert_eq!(state.levels.map(|level| level.settled)[..3], [1, 1, 0]);
        assert_eq!(words, of_levels([[0; 2], [0; 2], [7; 2]]));
    }

    #[test]
    fn without_data_t_does_not_move() {
        let (state, _) = check(constants(3), &vec![0.0; 3 * 32], 0.0);
        assert_eq!(state.degenerate, 1);
        // With gradients along x at one place only, shift, zoom and turn cannot be separated: only the first may step.
        let sums = row(&[([0.5, 0.0], 0.025, [1.0, 0.0]); 16], Layout::of(false));
        let (state, ..) =
            run(&constants(1), NO_VARIANT, &sums, &identity(), [&of_levels([[0; 2]; 3]); 2].map(Vec::as_slice));
        assert_eq!(state.degenerate, 1);
        assert!((state.registration.tx + 0.1).abs() < 1e-5, "{state:?}");
        assert_eq!(Single { tx: 0.0, ..state.registration }, identity().registration);
    }
}
