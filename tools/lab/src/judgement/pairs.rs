//! Pairs that do not fit the model.

use std::f64::consts::{PI, TAU};

use parfocal::{
    Error, Frame, Region,
    internals::Random,
    internals::scene::{Exposure, Preset, Radiance, Scene, Shape, Wave},
    transform::Similarity,
};

use super::alterations::{
    blank, composed, compressed, denoised, exposed, in_8_bits, in_16_bits, mirrored, mixed, noisy, quantile, rotated,
    shaken, sharpened,
};
use super::answer::{Input, Pair};
use super::{Kind, Trial, kind};

/// Words for photographs that do not show one scene.
const OTHER: &[&str] = &["explain", "correlate", "scene", "belong", "mirror", "motion", "moved"];
/// Words of a warning that a part of the scene differs.
const PART: &[&str] = &["explain", "moved", "motion", "scene", "does not fit", "do not fit"];
/// Words for a change of sharpness that is not defocus.
const SPECTRUM: &[&str] = &["explain", "spectr", "sharpen", "denois", "compress", "processed", "defocus"];
/// Words for no difference of blur.
const NO_BLUR: &[&str] = &["difference of blur", "differ in blur", "same focus", "no defocus"];
/// Words for too little texture.
const TEXTURE: &[&str] = &["texture", "determine", "contrast"];
/// Words for a T that is not determined.
const TRANSFORM: &[&str] = &["determine", "direction", "period", "repeat", "registration", "correlate", "overlap"];

pub(crate) const KINDS: &[Kind] = &[
    kind("I2 of another seed", OTHER, |trial| replaced(trial, |_, other| other.clone())),
    kind("half of I2 moved by 6 px", PART, half_moved),
    kind("I2 mirrored", OTHER, |trial| replaced(trial, |i2, _| mirrored(i2))),
    kind("I2 rotated by 180°", OTHER, |trial| replaced(trial, |i2, _| rotated(i2))),
    kind("half of I2 of another scene", PART, |trial| partly_replaced(trial, half(trial))),
    kind("a quarter of I2 of another scene", PART, |trial| partly_replaced(trial, quarter(trial))),
    kind("three strips moved apart by 3 px: parallax", PART, parallax),
    kind("a quarter of I2 in shadow", &["explain", "shadow", "light", "bright"], shadow),
    kind("displaced by 30 % of the width", TRANSFORM, far),
    kind("no defocus between the two", NO_BLUR, |trial| no_defocus(trial, [0.005, 0.005])),
    kind("no defocus, I1 noisy", NO_BLUR, |trial| no_defocus(trial, [0.03, 0.0])),
    kind("no defocus, I2 noisy", NO_BLUR, |trial| no_defocus(trial, [0.0, 0.03])),
    kind("I2 sharpened", SPECTRUM, |trial| processed(trial, 0.003, |i2| Ok(sharpened(i2, 1.0)))),
    kind("I2 denoised by a median", SPECTRUM, |trial| processed(trial, 0.02, |i2| Ok(denoised(i2)))),
    kind("I2 by JPEG of quality 10", SPECTRUM, jpeg),
    kind("I2 shaken along rows by 9 px", SPECTRUM, |trial| processed(trial, 0.003, |i2| Ok(shaken(i2, 4)))),
    kind("92 % of the pixels clipped", &["clip", "expos"], clipped),
    kind("dark background of low contrast, 8 bits", &["dark", "contrast", "texture", "bright"], dark),
    kind("stripes in one direction only", TRANSFORM, stripes),
    kind("texture and stripes, period below the shift", TRANSFORM, ambiguous),
    kind("a grating of one frequency", &["gain", "contrast", "period", "determine"], grating),
    kind("one smooth blob", TEXTURE, blob),
    kind("a blank wall with noise", TEXTURE, wall),
    kind("a region of 10 x 10 px", &["region", "small", "determine"], small_region),
];

/// A slanted plane with texture, V ±4 px².
fn plane(trial: Trial) -> Scene {
    let (side, seed) = (trial.side, trial.seed());
    Scene { width: side, height: side, seed, noise: 0.003, ..Preset::Plane.scene() }
}

/// The scene, displaced further along x.
fn shifted(scene: &Scene, by: f64) -> Scene {
    Scene { transform: Similarity { tx: scene.transform.tx + by, ..scene.transform }, ..scene.clone() }
}

/// The scene with another texture.
fn other(scene: &Scene) -> Scene {
    Scene { seed: scene.seed + 1000, ..scene.clone() }
}

/// The seed of the noise of an image: the same noise in both would be a pattern that stays sharp.
fn noise_seed(trial: Trial, image: usize) -> u64 {
    2 * trial.seed() + image as u64
}

fn whole(trial: Trial) -> Region {
    Region { x: 0, y: 0, width: trial.side, height: trial.side }
}

/// The right half.
fn half(trial: Trial) -> Region {
    Region { x: trial.side / 2, width: trial.side - trial.side / 2, ..whole(trial) }
}

/// The lower right quarter.
fn quarter(trial: Trial) -> Region {
    Region { y: trial.side / 2, height: trial.side - trial.side / 2, ..half(trial) }
}

/// A pair whose I2 shows something else. It is computed from I2 and I2 of another texture.
fn replaced(trial: Trial, i2: impl Fn(&Frame, &Frame) -> Frame) -> Result<Input, Error> {
    let scene = plane(trial);
    let mut pair = Pair::render(&scene)?.without_truth(whole(trial));
    pair.known.images[1] = i2(&pair.known.images[1], &other(&scene).render()?.i2);
    pair.has_transform = false;
    Ok(pair.into())
}

fn partly_replaced(trial: Trial, part: Region) -> Result<Input, Error> {
    let scene = plane(trial);
    let mut pair = Pair::render(&scene)?.without_truth(part);
    pair.known.images[1] = composed(&pair.known.images[1], &other(&scene).render()?.i2, part);
    pair.parts = vec![part];
    Ok(pair.into())
}

/// Either half may be taken for the one that moved, so that both are judged and T has no truth.
fn half_moved(trial: Trial) -> Result<Input, Error> {
    let (scene, moved) = (plane(trial), half(trial));
    let mut pair = Pair::render(&scene)?;
    pair.known.images[1] = composed(&pair.known.images[1], &shifted(&scene, 6.0).render()?.i2, moved);
    (pair.parts, pair.has_transform) = (vec![Region { x: 0, ..moved }, moved], false);
    Ok(pair.into())
}

fn parallax(trial: Trial) -> Result<Input, Error> {
    let scene = Scene { shape: Shape::Steps { limit: 4.0 }, ..plane(trial) };
    let mut pair = Pair::render(&scene)?;
    let width = trial.side / 3;
    pair.parts = [0, width, 2 * width].map(|x| Region { x, width, ..whole(trial) }).to_vec();
    for (strip, by) in [(0, -3.0), (2, 3.0)] {
        let moved = shifted(&scene, by).render()?.i2;
        pair.known.images[1] = composed(&pair.known.images[1], &moved, pair.parts[strip]);
    }
    pair.has_transform = false;
    Ok(pair.into())
}

fn shadow(trial: Trial) -> Result<Input, Error> {
    let mut pair = Pair::render(&plane(trial))?;
    let darker = exposed(&pair.known.images[1], |_, _| [0.7, 0.5, 0.3][trial.number], 0.0);
    pair.known.images[1] = composed(&pair.known.images[1], &darker, quarter(trial));
    pair.parts = vec![whole(trial), quarter(trial)];
    Ok(pair.into())
}

fn far(trial: Trial) -> Result<Input, Error> {
    Ok(Pair::render(&shifted(&plane(trial), 0.3 * f64::from(trial.side)))?.into())
}

/// A pair of one sharpness, with noise of I1 and I2.
fn no_defocus(trial: Trial, noise: [f64; 2]) -> Result<Input, Error> {
    let mut pair = Pair::render(&Scene { shape: Shape::Uniform { variance: 0.0 }, noise: 0.0, ..plane(trial) })?;
    for (n, image) in pair.known.images.iter_mut().enumerate() {
        *image = noisy(image, noise[n], noise_seed(trial, n));
    }
    Ok(pair.into())
}

/// A pair whose I2 the camera processed.
fn processed(trial: Trial, noise: f64, process: impl Fn(&Frame) -> Result<Frame, Error>) -> Result<Input, Error> {
    let mut pair = Pair::render(&Scene { noise, ..plane(trial) })?;
    pair.known.images[1] = process(&pair.known.images[1])?;
    Ok(pair.into())
}

fn jpeg(trial: Trial) -> Result<Input, Error> {
    let mut pair = Pair::render(&plane(trial))?;
    pair.known.images = [in_8_bits(&pair.known.images[0])?, compressed(&pair.known.images[1], 10)?];
    Ok(pair.into())
}

fn clipped(trial: Trial) -> Result<Input, Error> {
    let mut pair = Pair::render(&plane(trial))?;
    let white = f64::from(quantile(&pair.known.images[0], 0.08));
    for image in &mut pair.known.images {
        *image = in_16_bits(&exposed(image, |_, _| 1.0 / white, 0.0))?;
    }
    Ok(pair.into())
}

/// A bright half and a dark one, as a machine part before a black ground. The dark half is at 0.005 with a contrast of
/// ±0.001, some levels of 8 bits. Photon noise grows with the root of the intensity. I2 is blurred far more, and
/// differs in gain and offset by a few per cent of the range that the dark half fills.
fn dark(trial: Trial) -> Result<Input, Error> {
    let shape = Shape::Uniform { variance: [9.0, 25.0, 64.0][trial.number] };
    let exposure = Exposure { gain: 1.04, offset: 0.0003 };
    let scene = Scene { shape, exposure, noise: 0.0, transform: Similarity::IDENTITY, ..plane(trial) };
    let mut pair = Pair::render(&scene)?;
    let background = Scene { contrast: 0.002, ..other(&scene) }.render()?;
    let bright = half(trial);
    for (n, (image, dark)) in pair.known.images.iter_mut().zip([background.i1, background.i2]).enumerate() {
        let dark = noisy(&exposed(&dark, |_, _| 1.0, 0.005 - 0.5), 0.0004, noise_seed(trial, n));
        *image = in_8_bits(&composed(&dark, &noisy(image, 0.005, noise_seed(trial, n)), bright))?;
    }
    pair.parts = vec![Region { x: 0, ..bright }];
    Ok(pair.into())
}

/// Upright stripes of several periods: no picture of them shows a shift along y.
fn stripes(trial: Trial) -> Result<Input, Error> {
    let mut random = Random::new(trial.seed(), 101);
    let wave = |_| Wave { k: [0.2 + 1.8 * random.uniform(), 0.0], phase: TAU * random.uniform(), amplitude: 0.06 };
    let radiance = Radiance::Waves { waves: (0..12).map(wave).collect() };
    let transform = Similarity::new(1.3, -6.0, 0.0, 1.0);
    Ok(Pair::render(&Scene { radiance, transform, ..plane(trial) })?.into())
}

/// Stripes that dominate a texture, displaced by most of a period or more.
fn ambiguous(trial: Trial) -> Result<Input, Error> {
    let (period, shift) = [(8.0, 6.0), (7.0, 9.0), (10.0, 11.0)][trial.number];
    let waves = vec![Wave { k: [TAU / period, 0.0], phase: 0.0, amplitude: 0.5 }];
    let scene = Scene { noise: 0.0, ..shifted(&plane(trial), shift) };
    let mut pair = Pair::render(&scene)?;
    let stripes = Scene { radiance: Radiance::Waves { waves }, ..scene }.render()?;
    for (n, (image, stripes)) in pair.known.images.iter_mut().zip([stripes.i1, stripes.i2]).enumerate() {
        *image = noisy(&mixed(image, &stripes, [0.3, 0.6]), 0.003, noise_seed(trial, n));
    }
    Ok(pair.into())
}

/// A grating of one frequency in both directions, blurred by one V: a lower gain lowers its contrast as blur does.
fn grating(trial: Trial) -> Result<Input, Error> {
    let k = TAU / [12.0, 16.0, 20.0][trial.number];
    let waves = [[k, 0.0], [0.0, k]].map(|k| Wave { k, phase: 0.4, amplitude: 0.25 }).to_vec();
    let (radiance, shape) = (Radiance::Waves { waves }, Shape::Uniform { variance: 4.0 });
    Ok(Pair::render(&Scene { radiance, shape, ..plane(trial) })?.into())
}

/// A raised cosine as wide as the picture.
fn blob(trial: Trial) -> Result<Input, Error> {
    let k = TAU / f64::from(trial.side);
    // ¼ (1 - cos kx) (1 - cos ky), less the ½ that is added to all waves.
    let wave = |k, phase, amplitude| Wave { k, phase, amplitude };
    let waves = vec![
        wave([0.0, 0.0], 0.0, -0.25),
        wave([k, 0.0], PI, 0.25),
        wave([0.0, k], PI, 0.25),
        wave([k, k], 0.0, 0.125),
        wave([k, -k], 0.0, 0.125),
    ];
    let (radiance, shape) = (Radiance::Waves { waves }, Shape::Uniform { variance: 9.0 });
    let noise = [0.001, 0.003, 0.01][trial.number];
    Ok(Pair::render(&Scene { radiance, shape, noise, ..plane(trial) })?.into())
}

fn wall(trial: Trial) -> Result<Input, Error> {
    let mut pair = Pair::render(&plane(trial))?.without_truth(whole(trial));
    for (n, image) in pair.known.images.iter_mut().enumerate() {
        *image = noisy(&blank(image, 0.5), [0.002, 0.005, 0.02][trial.number], noise_seed(trial, n));
    }
    pair.has_transform = false;
    Ok(pair.into())
}

fn small_region(trial: Trial) -> Result<Input, Error> {
    let mut pair = Pair::render(&shifted(&plane(trial), [3.0, 6.0, 10.0][trial.number]))?;
    let part = Region { x: trial.side / 2, y: trial.side / 3, width: 10, height: 10 };
    (pair.region, pair.parts) = (Some(part), vec![part]);
    Ok(pair.into())
}
