//! The registration step: `N ζ = -g` from the sums of [`linearise`](super::linearise), or a step down the gradient; the
//! update of T, gain and offset; and the test for convergence. Section 5 of `docs/method.md`.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use nalgebra::{Cholesky, SMatrix, SVector};

use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::state::Registration;
use super::sums::{SUMS, Sums, UNKNOWNS};
use crate::engine::vulkan::{Stage, Variant};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Rows of partial sums, one a workgroup of `linearise`.
    pub rows: u32,
    /// Level, 0 the finest.
    pub level: u32,
    /// Where the energy of this level and iteration goes.
    pub energy_place: u32,
    /// First of the level's indirect arguments, in words.
    pub argument_place: u32,
    /// Words of them, all zeroed once the level has settled.
    pub argument_count: u32,
    /// 1 if T is solved for.
    pub solve_transform: u32,
    /// 1 if gain and offset are.
    pub solve_photometric: u32,
    /// 1 to descend the gradient instead of solving.
    pub descend: u32,
    /// 1 once an iteration at the final α is done; nothing may converge before.
    pub may_settle: u32,
    /// Pixels of the level that no corner may move any more, for it to settle; the energy may change by a tenth of that share.
    pub still: f32,
    /// First of the indirect arguments of the passes that bring I2 onto I1's pixels anew, in words.
    pub warp_place: u32,
    /// Words of them; zero where no such passes come before the next iteration.
    pub warp_count: u32,
    /// Pixels of the full-size image a pixel of this level.
    pub factor: f32,
    /// L, which scales a and b to pixels of the level.
    pub length: f32,
    /// From the centre to a corner, pixels of the level.
    pub half_size: [f32; 2],
    /// How much of the step is taken.
    pub share: f32,
}

bindings! {
    STEP:
    /// Rows of sums.
    partials: Reads<Partials>,
    /// State.
    state: Updates<State>,
    /// By level and iteration.
    energies: Writes<Energies>,
    /// Indirect arguments.
    arguments: Writes<Arguments>,
    /// The same as they are before a solve.
    start_arguments: Reads<StartArguments>,
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: the partial sums.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * SUMS as u64 * u64::from(c.rows)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let sums = memory.sums(self.partials).clone();
        let state = memory.state_mut(self.state);
        let level = c.level as usize;
        let step = twin(c, &sums, &mut state.registration, state.levels[level].energy);
        let anew = c.warp_count > 0 && !step.settled && moved_away(c, &state.warped, &state.registration);
        state.levels[level].energy = step.energy;
        state.levels[level].iterations += 1;
        let energies = memory.numbers_mut(self.energies, c.energy_place as usize + 1);
        energies[c.energy_place as usize] = step.energy;
        let start = memory.words(self.start_arguments).to_vec();
        let words = memory.words_mut(self.arguments);
        if step.settled {
            words[range(c.argument_place, c.argument_count)].fill(0);
        }
        for i in range(c.warp_place, c.warp_count) {
            words[i] = if anew { start[i] } else { 0 };
        }
    }
}

fn range(first: u32, count: u32) -> Range<usize> {
    first as usize..(first + count) as usize
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Energy a valid pixel, before the step.
    pub energy: f64,
    /// No corner moved by 0.01 px and the energy changed by less than 0.1 %.
    pub converged: bool,
    /// No corner moved by [`still`](Constants::still) pixels of the level, the energy changed by less than a tenth of that
    /// share, and the level stops. The energy is flat before V and T are, so the finest level goes on after it has converged.
    pub settled: bool,
}

/// Steps T, gain and offset in place. `before` is the energy of the iteration before.
pub fn twin(c: &Constants, sums: &Sums, r: &mut Registration, before: f64) -> Step {
    let x = solve(c, sums).map(|x| f64::from(c.share) * x);
    let (a, b) = (x[0] / f64::from(c.length), x[1] / f64::from(c.length));
    let factor = f64::from(c.factor);
    let moved = corner_moves(c, [a, b], [factor * x[2], factor * x[3]]);
    r.a += a;
    r.b += b;
    r.t[0] += factor * x[2];
    r.t[1] += factor * x[3];
    r.offset += x[5] - 0.5 * x[4];
    r.gain += x[4];
    let energy = sums.energy / sums.valid.max(1.0);
    let change = (energy - before).abs();
    let converged = c.may_settle == 1 && moved < 0.01 && change <= 1e-3 * before;
    let still = f64::from(c.still);
    let settled = c.may_settle == 1 && moved < still * factor && change <= 0.1 * still * before;
    Step { energy, converged, settled }
}

/// How far a corner moves, full-size pixels: by t and by (a, b) times its distance from the centre.
fn corner_moves(c: &Constants, [a, b]: [f64; 2], [tx, ty]: [f64; 2]) -> f64 {
    let corner = f64::from(c.half_size[0]).hypot(c.half_size[1].into());
    tx.hypot(ty) + a.hypot(b) * f64::from(c.factor) * corner
}

/// Pixels of the level that a corner may move before I2 is brought onto I1's pixels anew.
const FOLLOWED: f64 = 0.02;

/// Whether T has moved so far since `before` that gradients on the pixels no longer follow it.
pub(crate) fn moved_away(c: &Constants, before: &Registration, r: &Registration) -> bool {
    let since = r.moved_since(before);
    corner_moves(c, [since.a, since.b], since.t) > FOLLOWED * f64::from(c.factor)
}

/// Solves for the unknowns that are free; where N is singular nothing steps (the shader holds only the dependent unknowns).
///
/// Down the gradient, each unknown steps by its gradient over `Σ_j |N_ij|`: the paper names no step length, and by
/// Gershgorin's theorem these are the longest, one an unknown, that always descend while the weights are lagged.
fn solve(c: &Constants, sums: &Sums) -> [f64; UNKNOWNS] {
    let free = |i: usize| (if i < 4 { c.solve_transform } else { c.solve_photometric }) == 1;
    let mut n = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|i, j| sums.normal[i][j]);
    let held: [bool; UNKNOWNS] = std::array::from_fn(|i| !free(i) || n[(i, i)] <= 1e-12 * sums.valid);
    let mut g = SVector::<f64, UNKNOWNS>::from_fn(|i, _| -sums.gradient[i]);
    for i in (0..UNKNOWNS).filter(|&i| held[i]) {
        n.row_mut(i).fill(0.0);
        n.column_mut(i).fill(0.0);
        n[(i, i)] = 1.0;
        g[i] = 0.0;
    }
    if c.descend == 1 {
        return std::array::from_fn(|i| if held[i] { 0.0 } else { g[i] / n.row(i).abs().sum() });
    }
    Cholesky::new(n).map_or([0.0; UNKNOWNS], |l| l.solve(&g).into())
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random};
    use super::super::state::State;
    use super::super::sums::{ENERGY, GRADIENT, SUMS, VALID, normal_place};
    use super::*;
    use crate::base::{Photometric, Similarity};
    use crate::engine::vulkan::Resource;

    fn constants(rows: u32) -> Constants {
        Constants {
            rows,
            level: 1,
            energy_place: 3,
            argument_place: 4,
            argument_count: 4,
            solve_transform: 1,
            solve_photometric: 1,
            descend: 0,
            may_settle: 1,
            still: 0.001,
            warp_place: 8,
            warp_count: 0,
            factor: 2.0,
            length: 30.0,
            half_size: [60.0, 40.0],
            share: 1.0,
        }
    }

    /// Partial sums of a well-posed problem: each row a few random residuals.
    fn partials(rows: usize, pixels: usize) -> Vec<f32> {
        let mut numbers = random(rows * pixels * 8, 11).into_iter();
        let mut all = Vec::new();
        for _ in 0..rows {
            let mut sums = [0.0; SUMS];
            for _ in 0..pixels {
                let j: [f64; UNKNOWNS] = std::array::from_fn(|_| numbers.next().unwrap() - 0.5);
                let s = 0.01 * (numbers.next().unwrap() - 0.5);
                for i in 0..UNKNOWNS {
                    sums[GRADIENT + i] += j[i] * s;
                    for k in i..UNKNOWNS {
                        sums[normal_place(i, k)] += j[i] * j[k];
                    }
                }
                sums[ENERGY] += s.abs();
                sums[VALID] += 1.0;
            }
            all.extend(sums.map(|s| s as f32));
        }
        all
    }

    fn check(c: Constants, partials: &[f32], before: f32) -> (State, Vec<u32>) {
        check_warped(c, partials, before, [0.0; 2])
    }

    /// `t` is T's translation when I2 was last warped, its other terms are those of the start.
    fn check_warped(c: Constants, partials: &[f32], before: f32, t: [f32; 2]) -> (State, Vec<u32>) {
        let start = Registration::new(&Similarity::new(1.0, -2.0, 1.0, 1.05), &Photometric { gain: 0.9, offset: 0.1 });
        let mut state = State::new(&start);
        state.levels[1].energy = before;
        state.warped = [state.a, state.b, t[0], t[1], 1.0, 0.0];
        let rig = Rig::new();
        let buffers = [
            rig.upload(bytemuck::cast_slice(partials)),
            rig.upload(bytemuck::bytes_of(&state)),
            rig.upload(&[0; 32]),
            rig.upload(bytemuck::cast_slice(&[7u32; 12])),
            rig.upload(bytemuck::cast_slice(&[9u32; 12])),
        ];
        rig.run_groups(&STAGE, &buffers.each_ref().map(Resource::Buffer), &c, [1, 1, 1]);
        let found: State = rig.value(&buffers[1]);
        let sums = Sums::from_partials(partials);
        let mut expected = state.registration();
        let step = twin(&c, &sums, &mut expected, before.into());
        let found_registration = found.registration();
        let close = |f: f64, e: f64| assert!((f - e).abs() < 1e-5, "{found_registration:?} {expected:?}");
        close(found_registration.a, expected.a);
        close(found_registration.b, expected.b);
        close(found_registration.t[0], expected.t[0]);
        close(found_registration.t[1], expected.t[1]);
        close(found_registration.gain, expected.gain);
        close(found_registration.offset, expected.offset);
        close(found.levels[1].energy.into(), step.energy);
        close(rig.floats(&buffers[2])[3].into(), step.energy);
        assert_eq!(found.levels[1].iterations, 1);
        assert_eq!(found.levels[1].converged, u32::from(step.converged));
        assert_eq!(found.levels[1].settled, u32::from(step.settled));
        (found, rig.words(&buffers[3]))
    }

    #[test]
    fn agrees_with_the_twin() {
        for rows in [1, 7, 8, 100] {
            let partials = partials(rows, 40);
            for (solve_transform, solve_photometric) in [(1, 1), (1, 0), (0, 1), (0, 0)] {
                for (descend, share) in [(0, 1.0), (1, 1.0), (0, 0.5)] {
                    let c = Constants { solve_transform, solve_photometric, descend, share, ..constants(rows as u32) };
                    check(c, &partials, 0.1);
                }
            }
        }
    }

    #[test]
    fn settles_only_when_allowed_and_zeroes_its_own_arguments() {
        let partials = partials(8, 40);
        let held = Constants { solve_transform: 0, solve_photometric: 0, ..constants(8) };
        let energy = check(held, &partials, 0.1).0.levels[1].energy;
        let (state, arguments) = check(held, &partials, energy);
        assert_eq!(state.levels[1].converged, 1);
        assert_eq!(arguments, [7, 7, 7, 7, 0, 0, 0, 0, 7, 7, 7, 7]);
        let (state, arguments) = check(held, &partials, 1.0005 * energy);
        assert_eq!(state.levels[1].converged, 1);
        assert_eq!(arguments, [7; 12], "converged, and not yet settled");
        let (state, arguments) = check(Constants { may_settle: 0, ..held }, &partials, energy);
        assert_eq!(state.levels[1].converged, 0);
        assert_eq!(arguments, [7; 12]);
    }

    #[test]
    fn warps_anew_where_t_has_moved() {
        let partials = partials(8, 40);
        let held = Constants { solve_transform: 0, solve_photometric: 0, warp_count: 4, ..constants(8) };
        // The start is at (1, -2); 0.02 px of a level of factor 2 are 0.04 px.
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.0, -2.0]);
        assert_eq!(arguments, [7, 7, 7, 7, 7, 7, 7, 7, 0, 0, 0, 0]);
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.035, -2.0]);
        assert_eq!(arguments[8..], [0; 4]);
        let (_, arguments) = check_warped(held, &partials, 0.1, [1.0, -2.045]);
        assert_eq!(arguments, [7, 7, 7, 7, 7, 7, 7, 7, 9, 9, 9, 9]);
        let none = Constants { warp_count: 0, ..held };
        assert_eq!(check_warped(none, &partials, 0.1, [1.0, -2.045]).1, [7; 12]);
    }

    #[test]
    fn nothing_to_go_by_is_no_step() {
        let (state, _) = check(constants(3), &vec![0.0; 3 * SUMS], 0.0);
        assert_eq!(state.degenerate, 1);
        // Gain and offset of a constant image cannot be told apart: only one of them may step.
        let mut sums = [0.0f32; SUMS];
        sums[normal_place(4, 4)] = 4.0;
        sums[normal_place(4, 5)] = 8.0;
        sums[normal_place(5, 5)] = 16.0;
        sums[GRADIENT + 4..][..2].copy_from_slice(&[0.2, 0.4]);
        sums[VALID] = 16.0;
        let rig = Rig::new();
        let buffers = [
            rig.upload(bytemuck::cast_slice(&sums)),
            rig.upload(bytemuck::bytes_of(&State::new(&Registration::new(
                &Similarity::IDENTITY,
                &Photometric::IDENTITY,
            )))),
            rig.upload(&[0; 32]),
            rig.upload(&[0; 48]),
            rig.upload(&[0; 48]),
        ];
        rig.run_groups(&STAGE, &buffers.each_ref().map(Resource::Buffer), &constants(1), [1, 1, 1]);
        let state: State = rig.value(&buffers[1]);
        assert_eq!(state.degenerate, 1);
        assert!((state.gain - 0.95).abs() < 1e-5 && state.offset.is_finite(), "{state:?}");
    }
}
