//! Whether a patch without texture is said to have a focus.

use super::truth::solved;
use crate::base::random::Random;
use crate::base::{Decode, Frame, centre};
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::section::{Case, Section};
use crate::lab::scene::{Preset, SweepScene};
use crate::solve::focus_stack::Sweep;

const FRAMES: usize = 11;
/// Deviations of the noise, white = 1; the middle one alone of a quick run.
const NOISES: [f64; 3] = [0.001, 0.005, 0.02];
/// Half the side of the patch in the middle of 256 px, and how far from its border texture is whole again, px: so slowly that blur hardly
/// carries any into the patch.
const HALF: f64 = 65.0;
const FADES: f64 = 24.0;
/// Px along the border of the patch that do not count: there the window over which a deviation is judged, σ 4 px, sees texture.
const LEFT_OUT: f64 = 16.0;
/// How much of the patch may have a focus, and how much of what is around it must, %.
const MOST: f64 = 1.0;
const LEAST: f64 = 99.0;

/// One sweep under several noises.
pub(super) fn section(bench: &mut Bench) -> Section {
    let noises = if bench.quick { &NOISES[1..2] } else { &NOISES[..] };
    let rendered = SweepScene::new(Preset::Plane.scene(), FRAMES).render().map_err(|e| e.to_string());
    let cases = noises.iter().map(|&noise| {
        let name = format!("noise {noise}");
        bench.say(&format!("sweeps: flat patch, {name}"));
        let frames = rendered.clone().map(|sweep| patched(&sweep.frames, noise));
        let found = frames.and_then(|frames| solved(bench.engine(), &frames?, (0..FRAMES).map(|n| n as f64).collect()));
        found.map_or_else(|e| Case::failed(name.clone(), e), |sweep| judged(&sweep, name.clone()))
    });
    let cases = cases.collect();
    let what = format!(
        "A slanted plane of 256 x 256 px in {FRAMES} frames, in its middle a patch of {0} x {0} px without texture: how much of the patch and \
         of what is around has a focus, {LEFT_OUT} px along both borders left out; and of all of it.",
        2.0 * HALF
    );
    Section { name: "Flat patch", what, cases }
}

fn judged(sweep: &Sweep, name: String) -> Case {
    let size = [sweep.width, sweep.height];
    let valid = |counts: &dyn Fn(f64) -> bool| {
        let all: Vec<bool> =
            (0..sweep.focus.len()).filter(|i| counts(outside(*i, size))).map(|i| sweep.focus[i].is_finite()).collect();
        100.0 * all.iter().filter(|valid| **valid).count() as f64 / all.len() as f64
    };
    let border = 0.5 * f64::from(size[0]) - HALF - LEFT_OUT;
    let case = Case::new(name).at_most("of the patch, %", valid(&|away| away < -LEFT_OUT), MOST);
    let case = case.told("of all of it, %", valid(&|away| away < 0.0));
    case.within("around, %", valid(&|away| away > FADES && away < border), [LEAST, 100.0])
}

/// The frames without texture in the patch, under noise.
fn patched(frames: &[Frame], noise: f64) -> Result<Vec<Frame>, String> {
    let mut random = Random::new(1, 0);
    let mut patch = |frame: &Frame| {
        let size = [frame.width(), frame.height()];
        let value = |(i, v): (usize, &f32)| {
            let texture = (outside(i, size) / FADES).clamp(0.0, 1.0);
            let smooth = texture * texture * (3.0 - 2.0 * texture);
            (0.5 + smooth * (f64::from(*v) - 0.5) + noise * random.normal()) as f32
        };
        Frame::gray(size[0], size[1], frame.intensities(Decode::None).iter().enumerate().map(value).collect())
    };
    frames.iter().map(&mut patch).collect()
}

/// How far a pixel lies outside the patch, px; within it negative.
fn outside(i: usize, [width, height]: [u32; 2]) -> f64 {
    let [x, y] = centre(width, height);
    let (column, row) = ((i % width as usize) as f64, (i / width as usize) as f64);
    (column - x).abs().max((row - y).abs()) - HALF
}
