//! Pictures of the surface: two panels with a key, still or as an animated GIF.

use std::f64::consts::TAU;

use gif::{AnyExtension, Encoder, Extension, Frame, Repeat};
use image::RgbImage;

use super::heights::Heights;
use super::render::{Camera, Fit, Model};
use super::surface::{Surface, View};
use crate::base::Error;
use crate::files::export::{Destination, FileKind, SOFTWARE, write_file};
use crate::page::figure::{Align, Area, BLACK, Canvas, GRAY, bar_width, color_bar};

/// Size of text, px.
const TEXT: f32 = 15.0;
const MARGIN: f32 = 12.0;

/// Number of frames of one swing to the far end and back, a multiple of 4.
const FRAMES: usize = 48;

/// Greatest angle of the camera to either side, degrees. Beyond it, near parts of the surface hide the far ones.
const SWING: f64 = 40.0;

/// Duration of a frame, hundredths of a second.
const DELAY: u16 = 7;

/// Speed of the choice of each frame's colours, from 1 (slow, accurate) to 30.
const SPEED: i32 = 10;

impl Surface<'_> {
    /// The model at the resolution of the panels of a view.
    fn model(&self, view: &View) -> Model {
        let heights = Heights::of(self.values, self.texture.width() as usize, &self.scale, view.width, view.smoothing);
        Model::new(&heights, view.relief as f32, &self.texture, view.palette)
    }

    /// Draws both panels side by side, textured and colour-coded, with a key to the colours.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn picture(&self, view: &View) -> Result<RgbImage, Error> {
        view.check()?;
        let model = self.model(view);
        let camera = Camera::new(view.elevation, view.azimuth);
        let fit = Fit::new(&[camera], &model, view.width, MARGIN);
        let [textured, coded] = model.draw(&camera, &fit);
        let (width, height) = fit.size;
        let top = (3.0 * TEXT) as u32;
        let key = bar_width(TEXT) + 2.0 * MARGIN;
        let mut canvas = Canvas::new(2 * width + key.ceil() as u32, height + top);
        canvas.image(&textured, (0, top));
        canvas.image(&coded, (width, top));
        let [[near, far], [near_end, far_end]] = [view.palette.ends(), self.ends];
        let [quantity, unit] = self.names;
        let coded = format!("{quantity}: {near} {near_end}, {far} {far_end}");
        for (name, left) in [("Best focus", 0.0), (coded.as_str(), width as f32)] {
            canvas.text(name, (left + width as f32 / 2.0, 2.0 * TEXT), TEXT, Align::Middle, BLACK);
        }
        let x = 2.0 * width as f32 + MARGIN;
        canvas.text(unit, (x, 2.0 * TEXT), TEXT, Align::Left, GRAY);
        let long = (height as f32 * 0.7).min(320.0);
        let y = top as f32 + (height as f32 - long) / 2.0;
        color_bar(&mut canvas, Area { x, y, width: bar_width(TEXT), height: long }, &self.scale, view.palette, TEXT);
        Ok(canvas.into_image())
    }

    /// Writes an animated GIF of both panels. The camera swings 40° to either side of `view`. Creates the folder if it
    /// is missing. Replaces an animation of parfocal; the [`Destination`] must force the replacement of another file.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::File`].
    pub fn write_turntable<'d>(&self, file: impl Into<Destination<'d>>, view: &View) -> Result<(), Error> {
        view.check()?;
        let model = self.model(view);
        // From one end to the other. The way back repeats these frames.
        let cameras: Vec<Camera> = (0..=FRAMES / 2)
            .map(|i| Camera::new(view.elevation, view.azimuth - SWING * (TAU * i as f64 / FRAMES as f64).cos()))
            .collect();
        let fit = Fit::new(&cameras, &model, view.width, 4.0);
        let there: Vec<Frame> = cameras.iter().map(|camera| frame(&beside(&model.draw(camera, &fit)))).collect();
        let back = there[1..FRAMES / 2].iter().rev();
        write_file(file.into(), FileKind::Gif, |writer| {
            let size = (there[0].width, there[0].height);
            let mut encoder = Encoder::new(writer, size.0, size.1, &[]).map_err(|e| e.to_string())?;
            encoder.set_repeat(Repeat::Infinite).map_err(|e| e.to_string())?;
            let comment = AnyExtension::from(Extension::Comment);
            encoder.write_raw_extension(comment, &[SOFTWARE.as_bytes()]).map_err(|e| e.to_string())?;
            there.iter().chain(back).try_for_each(|frame| encoder.write_frame(frame)).map_err(|e| e.to_string())
        })
    }
}

fn frame(image: &RgbImage) -> Frame<'static> {
    // Two panels have at most 2048 px, and neither is taller than twice its width, so the sides fit.
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
