//! A photograph on the pixels of another.

use crate::base::color::stored;
use crate::base::{Brightness, Decode, Frame, Homography, centre, workers};

/// Interleaved values of so many channels, row-major.
#[derive(Clone, Copy)]
pub(crate) struct Interleaved<'a> {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) channels: usize,
    pub(crate) values: &'a [f32],
}

impl Interleaved<'_> {
    fn at(&self, x: isize, y: isize, channel: usize) -> f64 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values[(y * self.width + x) * self.channels + channel].into()
    }

    /// Whether a place lies between the outermost pixels' centres.
    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x <= self.width as f64 - 1.0 && y <= self.height as f64 - 1.0
    }

    /// By cubic convolution (Keys 1981, a = -½), which follows a parabola exactly; NaN outside.
    fn cubic(&self, place: [f64; 2], channel: usize) -> f32 {
        if !self.holds(place) {
            return f32::NAN;
        }
        let [(x, wx), (y, wy)] = place.map(|p| (p.floor() as isize, cubic_weights(p - p.floor())));
        let line = |row: usize| -> f64 {
            (0..4).map(|column| wx[column] * self.at(x + column as isize - 1, y + row as isize - 1, channel)).sum()
        };
        (0..4).map(|row| wy[row] * line(row)).sum::<f64>() as f32
    }
}

fn cubic_weights(f: f64) -> [f64; 4] {
    let near = |d: f64| (1.5 * d - 2.5) * d * d + 1.0;
    let far = |d: f64| ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0;
    [far(1.0 + f), near(f), near(1.0 - f), far(2.0 - f)]
}

/// What a image holds where T takes the pixels of an image of `size`; NaN where that is outside.
pub(crate) fn onto(image: &Interleaved<'_>, t: &Homography, [width, height]: [usize; 2]) -> Vec<f32> {
    let mut values = vec![0.0; width * height * image.channels];
    let middle = centre(width as u32, height as u32);
    in_rows(&mut values, width * image.channels, |y, row| {
        for (x, pixel) in row.chunks_exact_mut(image.channels).enumerate() {
            let place = t.apply([x as f64, y as f64], middle);
            for (channel, value) in pixel.iter_mut().enumerate() {
                *value = image.cubic(place, channel);
            }
        }
    });
    values
}

/// A photograph on the pixels of I1: what it holds where T takes them, of its own format; black where that is outside.
/// Its brightness is changed in intensities decoded so.
pub fn registered(frame: &Frame, transform: &Homography, brightness: &Brightness, decode: Decode) -> Frame {
    let (width, height, channels) = (frame.width() as usize, frame.height() as usize, frame.format().channels);
    let values = brightened(frame, brightness, decode);
    let image = Interleaved { width, height, channels: channels.count() as usize, values: &values };
    let mut moved = onto(&image, transform, [width, height]);
    for value in &mut moved {
        *value = match decode {
            _ if value.is_nan() => 0.0,
            Decode::None => *value,
            Decode::Srgb => stored(*value, decode),
        };
    }
    frame.with_intensities(&moved)
}

/// The intensities of a photograph, as bright as another's.
pub(crate) fn brightened(frame: &Frame, brightness: &Brightness, decode: Decode) -> Vec<f32> {
    let channels = frame.format().channels.count() as usize;
    let mut values = frame.intensities(decode);
    in_rows(&mut values, frame.width() as usize * channels, |y, row| {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let place = [x as f64, y as f64];
            pixel.iter_mut().for_each(|value| *value = brightness.of((*value).into(), place) as f32);
        }
    });
    values
}

/// Fills rows of so many values, by all processors.
pub(crate) fn in_rows<T: Send>(values: &mut [T], row: usize, fill: impl Fn(usize, &mut [T]) + Sync) {
    workers::each(values.chunks_exact_mut(row.max(1)).enumerate(), |(n, values)| fill(n, values));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Photometric, Similarity};

    #[test]
    fn a_parabola_is_followed_and_a_plane_under_any_similarity() {
        let (width, height) = (31, 23);
        let of = |x: f64, y: f64| 0.2 + 0.01 * x - 0.02 * y + 1e-3 * x * x;
        let values: Vec<f32> = (0..width * height).map(|i| of((i % width) as f64, (i / width) as f64) as f32).collect();
        let image = Interleaved { width, height, channels: 1, values: &values };
        let t = Homography::from(Similarity::new(1.3, -0.6, 2.0, 0.9));
        let found = onto(&image, &t, [width, height]);
        for (x, y) in [(8usize, 7usize), (15, 11), (20, 15)] {
            let [px, py] = t.apply([x as f64, y as f64], centre(31, 23));
            assert!((f64::from(found[y * width + x]) - of(px, py)).abs() < 1e-6);
        }
        let away = onto(&image, &Similarity::new(100.0, 0.0, 0.0, 1.0).into(), [width, height]);
        assert!(away.iter().all(|v| v.is_nan()));
    }

    #[test]
    fn exposure_is_taken_over_in_intensities() {
        let exposed = |byte: u8, gain: f64, offset: f64, decode: Decode| {
            let frame = Frame::new(2, 2, crate::base::Channels::Gray, crate::base::Samples::U8(vec![byte; 4])).unwrap();
            let unchanged = Brightness::unchanged([2, 2]);
            let brightness = Brightness { photometric: Photometric { gain, offset }, ..unchanged };
            registered(&frame, &Homography::IDENTITY, &brightness, decode).bytes()[0]
        };
        assert_eq!(exposed(50, 2.0, 0.1, Decode::None), 126);
        assert_eq!(exposed(200, 2.0, 0.0, Decode::None), 255);
        // 188 is half the intensity of white.
        assert!(exposed(188, 0.5, 0.0, Decode::Srgb).abs_diff(137) <= 1);
        assert_eq!(exposed(77, 1.0, 0.0, Decode::Srgb), 77);
    }
}
