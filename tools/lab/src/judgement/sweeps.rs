//! Focus sweeps that do not fit the model.

use parfocal::{
    Error, Frame, Region,
    internals::scene::{Preset, Scene, Shape, SimulatedSweep, SweepScene},
    transform::Similarity,
};

use super::alterations::{blank, composed, compressed, exposed, in_16_bits, mirrored, noisy, rotated};
use super::answer::Input;
use super::{Kind, Trial, kind};

/// Words for a frame that does not belong.
const FOREIGN: &[&str] = &["scene", "blank", "merged", "does not", "belong", "left out"];
/// Words for frames of one focus setting.
const ONE_FOCUS: &[&str] = &["one focus", "same focus", "difference of blur", "differ in blur", "no defocus"];

pub(crate) const KINDS: &[Kind] = &[
    kind("a frame of another seed", FOREIGN, |trial| foreign(trial, |frame| other(trial, frame))),
    kind("one focus setting, noisy", ONE_FOCUS, one_focus),
    kind("a frame mirrored", FOREIGN, |trial| foreign(trial, |frame| Ok(mirrored(frame)))),
    kind("a frame rotated by 180°", FOREIGN, |trial| foreign(trial, |frame| Ok(rotated(frame)))),
    kind("a white frame", FOREIGN, |trial| foreign(trial, |frame| Ok(blank(frame, 1.0)))),
    kind("a black frame", FOREIGN, |trial| foreign(trial, |frame| Ok(blank(frame, 0.0)))),
    kind("a frame of noise", FOREIGN, |trial| foreign(trial, |frame| Ok(noise(trial, frame)))),
    kind("a merged frame", FOREIGN, |trial| foreign(trial, |_| merged(trial))),
    kind("half of a frame of another seed", FOREIGN, |trial| foreign(trial, |f| half_other(trial, f))),
    kind("a frame overexposed threefold", &["expos", "clip", "bright", "scene", "left out"], overexposed),
    kind("three frames of three scenes", FOREIGN, three_scenes),
    kind("one focus setting, shifted", ONE_FOCUS, one_focus_shifted),
    kind("one focus setting, recompressed", ONE_FOCUS, one_focus_recompressed),
    kind("four frames, blur of σ 8 px per step", &["coarse", "more frames", "frames would"], coarse),
];

const FRAMES: usize = 8;
const PRESETS: [Preset; 3] = [Preset::Relief, Preset::Plane, Preset::Steps];

fn scene(trial: Trial) -> Scene {
    let (side, seed) = (trial.side, trial.seed());
    Scene { width: side, height: side, seed, noise: 0.005, ..PRESETS[trial.number].scene() }
}

/// The scene in focus everywhere, without displacement.
fn sharp(scene: Scene) -> Scene {
    Scene { shape: Shape::Uniform { variance: 0.0 }, transform: Similarity::IDENTITY, ..scene }
}

/// A sweep with one frame that is computed from the right one: the sixth, third or fifth. The fifth is the reference.
fn foreign(trial: Trial, frame: impl Fn(&Frame) -> Result<Frame, Error>) -> Result<Input, Error> {
    let SimulatedSweep { mut frames, focus, .. } = SweepScene::new(scene(trial), FRAMES).render()?;
    let n = [5, 2, 4][trial.number];
    frames[n] = frame(&frames[n])?;
    Ok(Input::Sweep { frames, focus })
}

fn other(trial: Trial, _: &Frame) -> Result<Frame, Error> {
    Ok(sharp(Scene { seed: trial.seed() + 1000, ..scene(trial) }).render()?.i1)
}

fn half_other(trial: Trial, frame: &Frame) -> Result<Frame, Error> {
    let half = Region { x: 0, y: 0, width: trial.side / 2, height: trial.side };
    Ok(composed(frame, &other(trial, frame)?, half))
}

fn noise(trial: Trial, frame: &Frame) -> Frame {
    noisy(&blank(frame, 0.5), 0.2, trial.seed())
}

fn merged(trial: Trial) -> Result<Frame, Error> {
    Ok(sharp(scene(trial)).render()?.i1)
}

/// All frames are 16-bit, so that white is a limit.
fn overexposed(trial: Trial) -> Result<Input, Error> {
    match foreign(trial, |frame| Ok(exposed(frame, |_, _| 3.0, 0.0)))? {
        Input::Sweep { frames, focus } => {
            Ok(Input::Sweep { frames: frames.iter().map(in_16_bits).collect::<Result<_, _>>()?, focus })
        }
        input => Ok(input),
    }
}

fn three_scenes(trial: Trial) -> Result<Input, Error> {
    let frame = |n: u64| Ok(sharp(Scene { seed: 10 * trial.seed() + n, ..scene(trial) }).render()?.i1);
    Ok(Input::without_focus((0..3).map(frame).collect::<Result<_, Error>>()?))
}

/// One photograph with noise that differs from frame to frame.
fn one_focus(trial: Trial) -> Result<Input, Error> {
    let photograph = sharp(Scene { noise: 0.0, ..scene(trial) }).render()?.i1;
    let deviation = [0.002, 0.005, 0.02][trial.number];
    let frame = |n: u64| noisy(&photograph, deviation, 10 * trial.seed() + n);
    Ok(Input::without_focus((0..FRAMES as u64).map(frame).collect()))
}

/// A camera that moved instead of refocusing.
fn one_focus_shifted(trial: Trial) -> Result<Input, Error> {
    let frame = |n: usize| {
        let transform = Similarity::new(1.5 * n as f64, -0.7 * n as f64, 0.0, 1.0);
        let moved = Scene { transform, noise: 0.0, ..sharp(scene(trial)) }.render()?.i2;
        Ok(noisy(&moved, 0.005, 10 * trial.seed() + n as u64))
    };
    Ok(Input::without_focus((0..FRAMES).map(frame).collect::<Result<_, Error>>()?))
}

fn one_focus_recompressed(trial: Trial) -> Result<Input, Error> {
    let photograph = sharp(scene(trial)).render()?.i1;
    let frames = (0..FRAMES as u8).map(|n| compressed(&photograph, 40 + 7 * n));
    Ok(Input::without_focus(frames.collect::<Result<_, Error>>()?))
}

fn coarse(trial: Trial) -> Result<Input, Error> {
    // Three steps from the focus the blur would exceed the widest that scenes have, so that the ends are moved in.
    Input::sweep(&SweepScene { blur_rate: 64.0, span: [0.2, 0.8], ..SweepScene::new(scene(trial), 4) })
}
