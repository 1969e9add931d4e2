//! Photographs moved and reduced, to make pairs with known registration.

use std::f64::consts::PI;

use crate::base::color::LUMINANCE;
use crate::base::{Channels, Decode, Frame, Samples, Similarity, centre};
use crate::engine::stages::{Field, ingest};

/// Neighbours on either side that the interpolation reads: flat to 0.8 of the Nyquist frequency.
const RADIUS: isize = 12;

/// The frame J with `J(T x) = frame(x)`, grey: read by a sinc under a squared cosine.
pub(super) fn displaced(frame: &Frame, transform: &Similarity) -> Result<Frame, String> {
    let (width, height) = (frame.width(), frame.height());
    let grey = ingest::cpu_reference(frame, Decode::None, LUMINANCE);
    let (back, c) = (transform.inverse(), centre(width, height));
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [f64::from(x), f64::from(y)]));
    Frame::gray(width, height, places.map(|place| read(&grey, back.apply(place, c)) as f32).collect())
}

/// The field at a place between its pixels, mirrored about its border.
fn read(field: &Field, [x, y]: [f64; 2]) -> f64 {
    let ((left, columns), (top, rows)) = (taps(x), taps(y));
    let row = |j: isize| -> f64 { columns.iter().zip(left..).map(|(w, i)| w * field.mirrored(i, j)).sum() };
    rows.iter().zip(top..).map(|(w, j)| w * row(j)).sum()
}

/// The first neighbour, and the weights from there on; their sum is 1.
fn taps(place: f64) -> (isize, [f64; 2 * RADIUS as usize]) {
    let first = place.floor() as isize - RADIUS + 1;
    let weight = |n: usize| {
        let d = PI * (place - (first + n as isize) as f64);
        let sinc = if d.abs() < 1e-9 { 1.0 } else { d.sin() / d };
        sinc * (d / (2.0 * RADIUS as f64)).cos().powi(2)
    };
    let weights: [f64; 2 * RADIUS as usize] = std::array::from_fn(weight);
    let sum: f64 = weights.iter().sum();
    (first, weights.map(|w| w / sum))
}

/// The mean of squares of `factor` x `factor` pixels; colours stay, floats come out.
pub(super) fn reduced(frame: &Frame, factor: u32) -> Result<Frame, String> {
    let (width, height) = (frame.width() / factor, frame.height() / factor);
    let channels = frame.format().channels;
    let planes: Vec<Field> = match channels {
        Channels::Gray => vec![ingest::cpu_reference(frame, Decode::None, LUMINANCE)],
        Channels::Rgb => {
            let one = |c: usize| [0, 1, 2].map(|k| if k == c { 1.0 } else { 0.0 });
            (0..3).map(|c| ingest::cpu_reference(frame, Decode::None, one(c))).collect()
        }
    };
    let mean = |plane: &Field, x: u32, y: u32| {
        let square = (0..factor).flat_map(|j| (0..factor).map(move |i| (x * factor + i, y * factor + j)));
        square.map(|(x, y)| plane.get(x as usize, y as usize)).sum::<f64>() / f64::from(factor * factor)
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let samples = pixels.flat_map(|(x, y)| planes.iter().map(move |plane| mean(plane, x, y) as f32)).collect();
    Frame::new(width, height, channels, Samples::F32(samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displaced_wave_is_the_wave_elsewhere() {
        let wave = |[x, y]: [f64; 2]| 0.5 + 0.3 * (0.9 * x + 0.4 * y).cos() + 0.1 * (1.3 * y).sin();
        let (width, height) = (80, 64);
        let at = |i: u32| wave([f64::from(i % width), f64::from(i / width)]) as f32;
        let frame = Frame::gray(width, height, (0..width * height).map(at).collect()).unwrap();
        let t = Similarity::new(1.8, 2.3, 0.2, 1.01);
        let moved = displaced(&frame, &t).unwrap();
        let Samples::F32(values) = moved.samples() else { panic!("not floats") };
        for y in 20..44 {
            for x in 20..60 {
                let expected = wave(t.inverse().apply([f64::from(x), f64::from(y)], centre(width, height)));
                assert!((f64::from(values[(y * width + x) as usize]) - expected).abs() < 2e-3, "({x}, {y})");
            }
        }
    }

    #[test]
    fn reducing_takes_means_of_each_colour() {
        let samples = vec![0, 10, 20, 255, 30, 40, 0, 0, 0, 255, 0, 0];
        let frame = Frame::new(2, 2, Channels::Rgb, Samples::U8(samples)).unwrap();
        let Samples::F32(values) = reduced(&frame, 2).unwrap().samples().clone() else { panic!("not floats") };
        for (found, expected) in values.iter().zip([127.5, 10.0, 15.0]) {
            assert!((f64::from(*found) * 255.0 - expected).abs() < 1e-4);
        }
    }
}
