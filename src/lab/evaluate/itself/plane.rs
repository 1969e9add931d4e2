//! The slanted plane, V ±4 px²: shaded unevenly, and under noise.

use super::truth::{Errors, Known};
use crate::base::{Frame, Samples};
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::section::{Case, Section};
use crate::lab::scene::{Preset, Scene};

/// I2 shines by `1 + amount q(x)`; x and y from 0 to 1 over the frame, q from -1 to 1.
type Shape = (&'static str, fn(f64, f64) -> f64);

const SHAPES: [Shape; 5] = [
    ("radial", |x, y| 1.0 - 4.0 * ((x - 0.5).powi(2) + (y - 0.5).powi(2))),
    ("cos⁴", |x, y| 1.0 - 2.0 * cos4(x, y)),
    ("ramp", |x, _| 2.0 * x - 1.0),
    ("diagonal", |x, y| x + y - 1.0),
    // The farthest corner, (1, 0), is √1.13 away.
    ("off-centre", |x, y| 1.0 - 2.0 * ((x - 0.3).powi(2) + (y - 0.8).powi(2)) / 1.13),
];

/// What cos⁴ of the angle to the axis lacks of 1, over what it lacks in the corners, which are 30° away.
fn cos4(x: f64, y: f64) -> f64 {
    let corner = (30f64.to_radians().tan()).powi(2);
    let lost = |tan2: f64| 1.0 - (1.0 + tan2).powi(-2);
    lost(corner * ((x - 0.5).powi(2) + (y - 0.5).powi(2)) / 0.5) / lost(corner)
}

/// How uneven, and the bounds: corner in px, rms of V in px².
const AMOUNTS: [(f64, f64, f64); 2] = [(0.06, 0.012, 0.08), (0.15, 0.02, 0.12)];

/// Noise of the shaded pairs, white = 1.
const LITTLE: f64 = 0.003;

/// I2 of a smoothly different brightness.
pub(super) fn shading(bench: &mut Bench) -> Section {
    let shapes = if bench.quick { &SHAPES[2..3] } else { &SHAPES };
    let mut cases = Vec::new();
    for (amount, corner, rms) in AMOUNTS {
        for (name, shape) in shapes {
            let name = format!("{:.0} %, {name}", 100.0 * amount);
            bench.say(&format!("itself: shading {name}"));
            cases.push(match shaded(amount, *shape).and_then(|known| known.errors(bench)) {
                Ok(e) => {
                    let case = Case::new(name).at_most("corner, px", e.corner, corner);
                    case.at_most("V rms, px²", e.rms, rms).told("V bias, px²", e.bias)
                }
                Err(e) => Case::failed(name, e),
            });
        }
    }
    let what =
        format!("A slanted plane of 256 x 256 px, V ±4 px², noise {LITTLE}; I2 brighter and darker by up to so much.");
    Section { name: "Shading", what, cases }
}

fn shaded(amount: f64, shape: fn(f64, f64) -> f64) -> Result<Known, String> {
    let known = Known::of(&Scene { noise: LITTLE, ..Preset::Plane.scene() })?;
    let [i1, i2] = &known.images;
    let images = [i1.clone(), shaded_by(i2, |x, y| 1.0 + amount * shape(x, y))?];
    Ok(Known { images, ..known })
}

fn shaded_by(frame: &Frame, gain: impl Fn(f64, f64) -> f64) -> Result<Frame, String> {
    let Samples::F32(values) = frame.samples() else { return Err("a scene's pixels are floats".to_string()) };
    let (width, last) = (frame.width() as usize, [frame.width() - 1, frame.height() - 1].map(f64::from));
    let shaded = values.iter().enumerate().map(|(i, v)| {
        let (x, y) = ((i % width) as f64 / last[0], (i / width) as f64 / last[1]);
        (f64::from(*v) * gain(x, y)) as f32
    });
    Frame::gray(frame.width(), frame.height(), shaded.collect())
}

/// Noise, and the bounds: bias and rms of V in px², and today's median corner in px.
const NOISES: [(f64, f64, f64, f64); 3] =
    [(0.003, 0.01, 0.06, 0.0045), (0.01, 0.02, 0.13, 0.016), (0.03, 0.05, 0.35, 0.0552)];

/// Seeds of texture and noise.
const SEEDS: [u64; 5] = [1, 2, 3, 4, 5];

/// Noise in both images.
pub(super) fn noise(bench: &mut Bench) -> Section {
    let noises = if bench.quick { &NOISES[1..2] } else { &NOISES[..] };
    let mut cases = Vec::new();
    for &(noise, bias, rms, corner) in noises {
        bench.say(&format!("itself: noise {noise}"));
        let one = |seed| Known::of(&Scene { noise, seed, ..Preset::Plane.scene() })?.errors(bench);
        let solved: Result<Vec<Errors>, String> = SEEDS.into_iter().map(one).collect();
        let median = solved.and_then(|all| Errors::median(&all).ok_or("no numbers".to_string()));
        cases.push(match median {
            Ok(e) => {
                let case = Case::new(noise.to_string()).within("V bias, px²", e.bias, [-bias, bias]);
                case.at_most("V rms, px²", e.rms, rms).at_most("corner, px", e.corner, corner)
            }
            Err(e) => Case::failed(noise.to_string(), e),
        });
    }
    let what = format!(
        "The same plane, noise in both images: medians of {} seeds. Corners must be no worse than they were when the \
         bounds were set.",
        SEEDS.len()
    );
    Section { name: "Noise", what, cases }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_runs_from_darkest_to_brightest() {
        for (name, shape) in SHAPES {
            let places = (0..=100).flat_map(|y| (0..=100).map(move |x| (f64::from(x) / 100.0, f64::from(y) / 100.0)));
            let values: Vec<f64> = places.map(|(x, y)| shape(x, y)).collect();
            let (low, high) = values.iter().fold((1.0f64, -1.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
            assert!((low + 1.0).abs() < 1e-9 && (high - 1.0).abs() < 1e-3, "{name}: {low} to {high}");
        }
    }
}
