//! Pairs and focus sweeps that fit the model.

use std::f64::consts::TAU;

use parfocal::{
    Error, Frame,
    internals::scene::{Exposure, Preset, Radiance, Scene, Shape, SweepScene, Wave},
    transform::Similarity,
};

use super::alterations::{compressed, exposed, in_8_bits, in_16_bits};
use super::answer::{Input, Pair};
use super::{Kind, Trial, kind};

pub(crate) const KINDS: &[Kind] = &[
    fits("plane", |trial| pair(&preset(Preset::Plane, trial))),
    fits("sweep of 8", |trial| Input::sweep(&sweep(trial, 8))),
    fits("relief", |trial| pair(&preset(Preset::Relief, trial))),
    fits("steps", |trial| pair(&preset(Preset::Steps, trial))),
    fits("cylinders", |trial| pair(&preset(Preset::Cylinders, trial))),
    fits("half-Gaussian on a texture", |trial| pair(&preset(Preset::HalfGaussianTexture, trial))),
    fits("half-Gaussian on dots", |trial| pair(&preset(Preset::HalfGaussianDots, trial))),
    fits("card", |trial| pair(&preset(Preset::Card, trial))),
    fits("blocks", |trial| pair(&preset(Preset::Blocks, trial))),
    fits("bars", |trial| pair(&preset(Preset::Bars, trial))),
    fits("uniform V of 4, -9, 16 px²", uniform),
    fits("gain 0.8, 1.25, 0.6", |trial| brightened(trial, [0.8, 1.25, 0.6][trial.number], 0.0)),
    fits("offset 0.05, -0.03, 0.1", |trial| brightened(trial, 1.0, [0.05, -0.03, 0.1][trial.number])),
    fits("shading by 5, 10, 15 %", shaded),
    fits("turned by 1, 2, 3°, scale 1.03", turned),
    fits("displaced by 6 % of the width", displaced),
    fits("periodic texture of 12, 16, 20 px", periodic),
    fits("noise 0.03, 0.04, 0.05", |trial| pair(&Scene { noise: 0.03 + 0.01 * trial.number as f64, ..plane(trial) })),
    fits("contrast 0.1", |trial| pair(&Scene { contrast: 0.1, noise: 0.001, ..plane(trial) })),
    fits("low-key, 16 bits", |trial| stored(trial, low_key)),
    fits("8 bits by sRGB", |trial| stored(trial, in_8_bits)),
    fits("JPEG of quality 95", |trial| stored(trial, |image| compressed(image, 95))),
    fits("sweep of 11", |trial| Input::sweep(&sweep(trial, 11))),
    fits("sweep of 16", |trial| Input::sweep(&sweep(trial, 16))),
    fits("sweep of 8 in reverse", reversed),
    fits("sweep of 8, breathing, drift, vignetting", handheld),
    fits("sweep of 11, little in focus at its ends", |trial| {
        Input::sweep(&SweepScene { span: [0.35, 0.65], ..sweep(trial, 11) })
    }),
    fits("sweep of 8, noise 0.02", |trial| Input::sweep(&noisy_sweep(trial, 0.02))),
    fits("sweep of 8, blocks", |trial| Input::sweep(&SweepScene::new(preset(Preset::Blocks, trial), 8))),
    fits("sweep of 8, low-key, 16 bits", low_key_sweep),
];

const fn fits(name: &'static str, input: fn(Trial) -> Result<Input, Error>) -> Kind {
    kind(name, &[], input)
}

/// A preset with noise 0, 0.003 or 0.01.
fn preset(preset: Preset, trial: Trial) -> Scene {
    let (side, seed, noise) = (trial.side, trial.seed(), [0.0, 0.003, 0.01][trial.number]);
    Scene { width: side, height: side, seed, noise, ..preset.scene() }
}

/// A slanted plane with noise 0.003.
fn plane(trial: Trial) -> Scene {
    Scene { noise: 0.003, ..preset(Preset::Plane, trial) }
}

fn pair(scene: &Scene) -> Result<Input, Error> {
    Ok(Pair::render(scene)?.into())
}

fn uniform(trial: Trial) -> Result<Input, Error> {
    pair(&Scene { shape: Shape::Uniform { variance: [4.0, -9.0, 16.0][trial.number] }, ..plane(trial) })
}

fn brightened(trial: Trial, gain: f64, offset: f64) -> Result<Input, Error> {
    pair(&Scene { exposure: Exposure { gain, offset }, ..plane(trial) })
}

/// I2 gets darker towards its corners.
fn shaded(trial: Trial) -> Result<Input, Error> {
    let amount = [0.05, 0.1, 0.15][trial.number];
    let mut pair = Pair::render(&plane(trial))?;
    let light = |x: f64, y: f64| 1.0 - 2.0 * amount * ((x - 0.5).powi(2) + (y - 0.5).powi(2));
    pair.known.images[1] = exposed(&pair.known.images[1], light, 0.0);
    Ok(pair.into())
}

fn turned(trial: Trial) -> Result<Input, Error> {
    pair(&Scene { transform: Similarity::new(1.3, -0.9, 1.0 + trial.number as f64, 1.03), ..plane(trial) })
}

fn displaced(trial: Trial) -> Result<Input, Error> {
    let length = 0.06 * f64::from(trial.side);
    pair(&Scene { transform: Similarity::new(0.8 * length, -0.6 * length, 0.15, 1.01), ..plane(trial) })
}

/// A periodic texture, displaced by much less than its period: a grating in both directions with its harmonics. The
/// harmonics tell blur from gain, for it dims them the more.
fn periodic(trial: Trial) -> Result<Input, Error> {
    let k = TAU / [12.0, 16.0, 20.0][trial.number];
    let harmonic = |n: u32| {
        let (k, phase) = (f64::from(n) * k, 0.4 * f64::from(n * n));
        [[k, 0.0], [0.0, k], [k, k]].map(|k| Wave { k, phase, amplitude: 0.08 })
    };
    let waves = (1..=4).flat_map(harmonic).collect();
    pair(&Scene { radiance: Radiance::Waves { waves }, ..plane(trial) })
}

/// A pair as files or cameras store it.
fn stored(trial: Trial, store: impl Fn(&Frame) -> Result<Frame, Error>) -> Result<Input, Error> {
    let mut pair = Pair::render(&plane(trial))?;
    for image in &mut pair.known.images {
        *image = store(image)?;
    }
    Ok(pair.into())
}

/// Below a twentieth of white.
fn low_key(frame: &Frame) -> Result<Frame, Error> {
    in_16_bits(&exposed(frame, |_, _| 0.05, 0.0))
}

/// A sweep of a relief, a plane or steps.
fn sweep(trial: Trial, frames: usize) -> SweepScene {
    let scene = preset([Preset::Relief, Preset::Plane, Preset::Steps][trial.number], trial);
    SweepScene::new(Scene { noise: 0.005, ..scene }, frames)
}

fn noisy_sweep(trial: Trial, noise: f64) -> SweepScene {
    let sweep = sweep(trial, 8);
    SweepScene { scene: Scene { noise, ..sweep.scene }, ..sweep }
}

/// A sweep from the far end to the near one. Its frames are not displaced, so that any may be the reference.
fn reversed(trial: Trial) -> Result<Input, Error> {
    let mut input = Input::sweep(&sweep(trial, 8))?;
    if let Input::Sweep { frames, focus } = &mut input {
        frames.reverse();
        focus.iter_mut().for_each(|u| *u = 7.0 - *u);
    }
    Ok(input)
}

fn handheld(trial: Trial) -> Result<Input, Error> {
    let rotation = 0.3f64.to_radians();
    let sweep = sweep(trial, 8);
    Input::sweep(&SweepScene { breathing: 0.04, drift: 6.0, rotation, gain_drift: 0.05, vignetting: 0.06, ..sweep })
}

fn low_key_sweep(trial: Trial) -> Result<Input, Error> {
    let mut input = Input::sweep(&sweep(trial, 8))?;
    if let Input::Sweep { frames, .. } = &mut input {
        for frame in frames {
            *frame = low_key(frame)?;
        }
    }
    Ok(input)
}
