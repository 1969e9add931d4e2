//! Pictures of the surface: two panels with a key, still or as an animated GIF.

use std::f64::consts::TAU;

use gif::{AnyExtension, Encoder, Extension, Frame, Repeat};
use image::{Rgb, RgbImage};

use super::mesh::Heights;
use super::mesh::Mesh;
use super::raster::{self, Fragment};
use super::raster::{Camera, Fit};
use super::{Surface, View};
use crate::base::Error;
use crate::files::export::{self, Destination, FileKind, Palette, SOFTWARE};
use crate::page::figure::{Align, Area, BLACK, Canvas, GRAY, bar_width, color_bar, resized};

/// Number of samples per pixel along each axis.
const SAMPLES: u32 = 2;

/// Brightness of unlit areas, of the textured and of the colour-coded panel. The textured panel is brighter, since a
/// photograph has its own shading.
const AMBIENT: [f32; 2] = [0.5, 0.35];

/// Greatest brightness of lit areas.
const BRIGHTEST: f32 = 1.25;

/// Size of text, px.
const TEXT: f32 = 15.0;
const MARGIN: f32 = 12.0;

/// A mesh and its texture, at the resolution of the panels of a view.
pub(super) struct Model {
    pub mesh: Mesh,
    texture: RgbImage,
    palette: Palette,
}

impl Model {
    pub(super) fn new(surface: &Surface, view: &View) -> Self {
        let heights = Heights::of(surface, view.width as usize, view.smoothing as usize);
        let (width, height) = surface.texture.dimensions();
        let factor = f64::from(SAMPLES * view.width) / f64::from(width.max(height));
        let size = [width, height].map(|side| (f64::from(side) * factor.min(1.0)).round() as u32);
        let texture = resized(&surface.texture, (size[0], size[1]));
        Self { mesh: Mesh::new(&heights, view.relief as f32), texture, palette: view.palette }
    }

    /// The textured and the colour-coded panel.
    pub(super) fn panels(&self, camera: &Camera, fit: &Fit) -> [RgbImage; 2] {
        let fragments = raster::draw(&self.mesh, camera, &fit.enlarged(SAMPLES));
        [0, 1].map(|panel| {
            average(&fragments, fit.size, |fragment| {
                let color = if panel == 0 {
                    self.texel(fragment.uv)
                } else {
                    self.palette.color(f64::from(fragment.nearness)).map(f32::from)
                };
                let light = (AMBIENT[panel] + (1.0 - AMBIENT[panel]) * fragment.light).min(BRIGHTEST);
                color.map(|c| c * light)
            })
        })
    }

    /// The texture at a position, interpolated bilinearly.
    fn texel(&self, [u, v]: [f32; 2]) -> [f32; 3] {
        let (width, height) = self.texture.dimensions();
        let along = |t: f32, size: u32| {
            let at = (t * size as f32 - 0.5).clamp(0.0, size as f32 - 1.0);
            (at as u32, (at as u32 + 1).min(size - 1), at.fract())
        };
        let ((x0, x1, fx), (y0, y1, fy)) = (along(u, width), along(v, height));
        let get = |x: u32, y: u32| self.texture.get_pixel(x, y).0.map(f32::from);
        let (a, b, c, d) = (get(x0, y0), get(x1, y0), get(x0, y1), get(x1, y1));
        [0, 1, 2].map(|i| (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy)
    }
}

/// The mean of the samples of each pixel, white where they are empty.
fn average(fragments: &[Fragment], (width, height): (u32, u32), color: impl Fn(&Fragment) -> [f32; 3]) -> RgbImage {
    let row = (width * SAMPLES) as usize;
    RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = ((x * SAMPLES) as usize, (y * SAMPLES) as usize);
        let mut sum = [0.0; 3];
        for fragment in (0..SAMPLES as usize).flat_map(|dy| &fragments[(y + dy) * row + x..][..SAMPLES as usize]) {
            let sample = if fragment.is_empty() { [255.0; 3] } else { color(fragment) };
            sum.iter_mut().zip(sample).for_each(|(sum, c)| *sum += c.min(255.0));
        }
        Rgb(sum.map(|c| (c / (SAMPLES * SAMPLES) as f32).round() as u8))
    })
}

/// Draws both panels side by side with their names and the key.
pub(super) fn draw(surface: &Surface, view: &View) -> RgbImage {
    let model = Model::new(surface, view);
    let camera = Camera::new(view.elevation, view.azimuth);
    let fit = Fit::new(&[camera], &model.mesh, view.width, MARGIN);
    let [textured, coded] = model.panels(&camera, &fit);
    let (width, height) = fit.size;
    let top = (3.0 * TEXT) as u32;
    let key = bar_width(TEXT) + 2.0 * MARGIN;
    let mut canvas = Canvas::new(2 * width + key.ceil() as u32, height + top);
    canvas.image(&textured, (0, top));
    canvas.image(&coded, (width, top));
    let [near, far] = view.palette.ends();
    let [quantity, unit] = surface.names;
    let coded = format!("{quantity}: {near} near, {far} far");
    for (name, left) in [("Best focus", 0.0), (coded.as_str(), width as f32)] {
        canvas.text(name, (left + width as f32 / 2.0, 2.0 * TEXT), TEXT, Align::Middle, BLACK);
    }
    let x = 2.0 * width as f32 + MARGIN;
    canvas.text(unit, (x, 2.0 * TEXT), TEXT, Align::Left, GRAY);
    let long = (height as f32 * 0.7).min(320.0);
    let y = top as f32 + (height as f32 - long) / 2.0;
    color_bar(&mut canvas, Area { x, y, width: bar_width(TEXT), height: long }, &surface.scale, view.palette, TEXT);
    canvas.into_image()
}

/// Number of frames of one swing to the far end and back, a multiple of 4.
const FRAMES: usize = 48;

/// Greatest angle of the camera to either side, degrees. Beyond it, near parts of the surface hide the far ones.
const SWING: f64 = 40.0;

/// Duration of a frame, hundredths of a second.
const DELAY: u16 = 7;

/// Speed of the choice of each frame's colours, from 1 (slow, accurate) to 30.
const SPEED: i32 = 10;

/// Writes the animation.
pub(super) fn write_turntable(surface: &Surface, view: &View, file: Destination<'_>) -> Result<(), Error> {
    let model = Model::new(surface, view);
    // From one end to the other. The way back repeats these frames.
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
