//! The all-in-focus image: each pixel from the frame that was chosen for it, read by a cubic spline; frames meet softly, over two px.

use super::choose::choose;
use super::focused::Focused;
use crate::base::{Homography, centre};
use crate::solve::resample::{Spline, in_rows};

/// The all-in-focus image on the reference's pixels.
pub(super) struct Fused {
    /// Interleaved, with the reference's white at 1.
    pub(super) values: Vec<f32>,
    /// The frame that each pixel is of, from 0.
    pub(super) frames: Vec<u16>,
}

/// Of one frame at a time: two images of floats are held besides the result.
pub(super) fn fuse(sweep: &Focused<'_>) -> Fused {
    let (size @ [width, height], count) = (sweep.size(), sweep.channels().count() as usize);
    let chosen = choose(sweep);
    let mut values = vec![0.0f32; width * height * count];
    for n in (0..sweep.frames.len()).filter(|n| chosen.has(*n)) {
        let image = Moved::new(sweep.values(n), count, sweep.found.registration.transforms[n], size);
        in_rows(&mut values, width * count, |y, row| {
            let mut read = [0.0; 3];
            for (x, pixel) in row.chunks_exact_mut(count).enumerate() {
                let share = chosen.share([x, y], n);
                if share > 0.0 {
                    image.read([x, y], &mut read[..count]);
                    pixel.iter_mut().zip(read).for_each(|(sum, value)| *sum += share * value);
                }
            }
        });
    }
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    Fused { values, frames: places.map(|place| chosen.frame(place)).collect() }
}

/// A frame, read at the reference's pixels.
enum Moved {
    /// The reference, as it is to the last bit.
    Reference {
        values: Vec<f32>,
        width: usize,
        channels: usize,
    },
    Other {
        image: Spline,
        transform: Homography,
        size: [usize; 2],
    },
}

impl Moved {
    fn new(values: Vec<f32>, channels: usize, transform: Homography, size: [usize; 2]) -> Self {
        if transform == Homography::IDENTITY {
            return Self::Reference { values, width: size[0], channels };
        }
        Self::Other { image: Spline::through(&values, size, channels), transform, size }
    }

    /// A pixel, which the frame shows: [`choose`] takes it of no other.
    fn read(&self, [x, y]: [usize; 2], into: &mut [f32]) {
        match self {
            Self::Reference { values, width, channels } => {
                into.copy_from_slice(&values[(y * width + x) * channels..][..*channels]);
            }
            Self::Other { image, transform, size } => {
                let [px, py] = transform.apply([x as f64, y as f64], centre(size[0] as u32, size[1] as u32));
                image.read([px.clamp(0.0, size[0] as f64 - 1.0), py.clamp(0.0, size[1] as f64 - 1.0)], into);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Brightness, Decode, Frame};
    use crate::engine::{JointRegistration, JointSolution};

    #[test]
    fn each_pixel_is_of_the_sharpest_frame_and_depth_decides_where_none_is() {
        let (width, height) = (48u32, 32u32);
        // Frame 0 is sharp on the left, frame 1 on the right; neither on the lowest rows, of which depth says frame 1.
        let frame = |n: u32| {
            let value = |i: u32| {
                let (x, y) = (i % width, i / width);
                let sharp = (x < width / 2) == (n == 0) && y < 20;
                let stripes = if (x + y) % 2 == 0 { 0.2 } else { -0.2 };
                0.5 + 0.01 * n as f32 + if sharp { stripes } else { 0.0 }
            };
            Frame::gray(width, height, (0..width * height).map(value).collect()).unwrap()
        };
        let frames = [frame(0), frame(1)];
        let pixels = (width * height) as usize;
        let found = JointSolution {
            focus: (0..pixels).map(|i| if i / 48 < 20 { f32::NAN } else { 1.0 }).collect(),
            deviation: vec![0.1; pixels],
            registration: JointRegistration {
                transforms: vec![Homography::IDENTITY; 2],
                brightness: vec![Brightness::identity([width, height]); 2],
                rate: 1.0,
                settings: vec![0.0, 1.0],
            },
        };
        let (frames, positions, decode) = (&frames, &[0.0, 1.0], Decode::None);
        let fused = fuse(&Focused { frames, reference: 0, positions, found: &found, decode });
        let at = |x: usize, y: usize| fused.values[y * width as usize + x];
        assert_eq!([[8, 8], [40, 8], [8, 31]].map(|[x, y]| fused.frames[y * width as usize + x]), [0, 1, 1]);
        assert!((at(8, 8) - 0.7).abs() < 1e-6 && (at(9, 8) - 0.3).abs() < 1e-6, "{} {}", at(8, 8), at(9, 8));
        assert!((at(40, 8) - 0.71).abs() < 1e-6 && (at(8, 31) - 0.51).abs() < 1e-6, "{} {}", at(40, 8), at(8, 31));
    }
}
