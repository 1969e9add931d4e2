//! The surface in motion: an animated GIF.

use std::f64::consts::TAU;

use gif::{AnyExtension, Encoder, Extension, Frame, Repeat};
use image::RgbImage;

use super::camera::{Camera, Fit};
use super::picture::Model;
use super::{Surface, View};
use crate::base::Error;
use crate::files::export::{self, Destination, FileKind, SOFTWARE};

/// Frames of one swing there and back, a multiple of 4.
const FRAMES: usize = 48;

/// How far the camera swings to either side, degrees: farther, near parts hide the rest.
const SWING: f64 = 40.0;

/// Hundredths of a second that a frame stays.
const DELAY: u16 = 7;

/// Effort of the choice of each frame's colours, 1 (most) to 30.
const SPEED: i32 = 10;

/// Writes the animation.
pub(super) fn write(surface: &Surface, view: &View, file: Destination<'_>) -> Result<(), Error> {
    let model = Model::new(surface, view);
    // From one end to the other; the way back shows the same frames.
    let cameras: Vec<Camera> = (0..=FRAMES / 2)
        .map(|i| Camera::new(view.elevation, view.azimuth - SWING * (TAU * i as f64 / FRAMES as f64).cos()))
        .collect();
    let fit = Fit::new(&cameras, &model.mesh, view.width, 4.0);
    let there: Vec<Frame> = cameras.iter().map(|camera| frame(&beside(&model.panels(camera, &fit)))).collect();
    let back = there[1..FRAMES / 2].iter().rev();
    export::write_file(file, FileKind::Gif, |writer| {
        let size = (there[0].width, there[0].height);
        let mut encoder = Encoder::new(writer, size.0, size.1, &[]).map_err(|e| e.to_string())?;
        encoder.set_repeat(Repeat::Infinite).map_err(|e| e.to_string())?;
        let comment = AnyExtension::from(Extension::Comment);
        encoder.write_raw_extension(comment, &[SOFTWARE.as_bytes()]).map_err(|e| e.to_string())?;
        there.iter().chain(back).try_for_each(|frame| encoder.write_frame(frame)).map_err(|e| e.to_string())
    })
}

fn frame(image: &RgbImage) -> Frame<'static> {
    // Two panels of 2048 px at most, neither taller than twice its width: the sides fit.
    let mut frame = Frame::from_rgb_speed(image.width() as u16, image.height() as u16, image, SPEED);
    frame.delay = DELAY;
    frame
}

fn beside([left, right]: &[RgbImage; 2]) -> RgbImage {
    let mut both = RgbImage::new(2 * left.width(), left.height());
    image::imageops::replace(&mut both, left, 0, 0);
    image::imageops::replace(&mut both, right, i64::from(left.width()), 0);
    both
}
