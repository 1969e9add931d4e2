//! Maps in colour: `depth.png`, which is depth, V or focus with its key to the right, and `labels.png`.

use std::io::Write;

use image::RgbImage;
use png::ColorType;

use super::image_files::{Description, LABELS, Pixels, SWEEP_LABELS, finish_png, png_encoder, write_png};
use super::results::{Drawing, Extra, Results};
use super::scale::{Nearer, Palette, Quantity, Scale};
use crate::engine::Solution;

/// Stripes over pixels that are not measured: light and dark grey.
const HATCH: [[u8; 4]; 2] = [[205, 205, 205, 255], [165, 165, 165, 255]];
/// Width of a stripe along x, px.
const HATCH_WIDTH: usize = 4;

/// The share of its colour that a pixel keeps that is filled in; the rest is white.
const PALE: f64 = 0.45;

/// A quantity with the options of its picture.
struct Map<'a> {
    size: (u32, u32),
    quantity: Quantity<'a>,
    scale: Scale,
    palette: Palette,
    /// Pixels that are not measured, and what is filled in there; none if empty.
    marked: &'a [bool],
    filled: &'a [f32],
    /// -1 or 1 where no frame of a sweep is in focus, by side; none if empty.
    beyond: &'a [i8],
    /// Whether the first frame of a sweep is focused nearest.
    first_is_near: bool,
    /// The names of the near and the far end.
    ends: [&'static str; 2],
}

impl<'a> Map<'a> {
    fn new(size: (u32, u32), quantity: Quantity<'a>, palette: Palette) -> Self {
        let scale = quantity.scale();
        let ends = ["near", "far"];
        Self { size, quantity, scale, palette, marked: &[], filled: &[], beyond: &[], first_is_near: true, ends }
    }

    /// RGBA of a pixel: the colour of its value, transparent where not valid, paler where it is filled in, hatched where
    /// it cannot be. Where no frame of a sweep is in focus, it is hatched the other way, in the colour of the end beyond which the focus lies.
    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let i = y * self.size.0 as usize + x;
        if let Some(side) = self.beyond.get(i).filter(|side| **side != 0) {
            let is_near = (*side < 0) == self.first_is_near;
            let [r, g, b] = self.palette.color(f64::from(u8::from(is_near)));
            let stripe = (x + self.size.1 as usize - y) / HATCH_WIDTH % 2;
            return if stripe == 0 { [r, g, b, 255] } else { HATCH[0] };
        }
        if self.marked.get(i).is_some_and(|&marked| marked) {
            let Some(value) = self.filled.get(i).filter(|value| value.is_finite()) else {
                return HATCH[(x + y) / HATCH_WIDTH % 2];
            };
            let pale = |c: u8| (255.0 - PALE * (255.0 - f64::from(c))).round() as u8;
            let [r, g, b] = self.palette.color(self.scale.nearness(*value)).map(pale);
            return [r, g, b, 255];
        }
        let value = self.quantity.values[i];
        if !value.is_finite() {
            return [0; 4];
        }
        let [r, g, b] = self.palette.color(self.scale.nearness(value));
        [r, g, b, 255]
    }

    /// Short name and unit.
    fn title(&self) -> [&'static str; 2] {
        match self.quantity.name {
            "relative_blur" => ["V", "px²"],
            "focus" => ["focus", "setting"],
            _ => ["depth", "mm"],
        }
    }

    fn description(&self) -> Description {
        let [near, far] = [1.0, 0.0].map(|nearness| self.scale.value(nearness) as f32);
        let [near_color, far_color] = self.palette.ends();
        // This text is ASCII, for PNG.
        let [near_end, far_end] = self.ends;
        let (name, units) = match self.title() {
            ["V", _] => ("relative blur V", "px^2"),
            [name, unit] => (name, unit),
        };
        let comments = format!(
            "Map of {name} in {units}, {near_color} {near_end} ({near}) to {far_color} {far_end} ({far}), transparent where \
             not valid, paler where not measured but filled in from around, hatched in the colour of an end where the focus \
             lies beyond it; its key is to the right of column {}",
            self.size.0
        );
        Description { units: units.into(), comments: comments.into() }
    }

    /// Writes RGBA: the map at full resolution, and to its right the key on white.
    fn write(&self, writer: impl Write, drawing: &Drawing) -> Result<(), String> {
        let (width, height) = self.size;
        let title = self.title().join(", ");
        let key = drawing.plotter.map_or_else(
            || RgbImage::new(0, height),
            |plotter| (plotter.key)([&title, self.ends[0], self.ends[1]], &self.scale, self.palette, self.size),
        );
        let mut pixels = Vec::with_capacity(4 * (width + key.width()) as usize * height as usize);
        for y in 0..height {
            pixels.extend((0..width as usize).flat_map(|x| self.pixel(x, y as usize)));
            // Below the key it is transparent; the key may be taller than the map.
            let beside =
                (0..key.width()).flat_map(|x| key.get_pixel_checked(x, y).map_or([0; 4], |p| [p[0], p[1], p[2], 255]));
            pixels.extend(beside);
        }
        let size = (width + key.width(), height);
        write_png(writer, size, ColorType::Rgba, &Pixels::Bytes(&pixels), &self.description())
    }
}

/// Writes `depth.png`.
pub(super) fn write(writer: impl Write, results: &Results<'_>, drawing: &Drawing) -> Result<(), String> {
    let map = Map::new(results.size(), results.best(), drawing.palette);
    let (first_is_near, ends) = (results.report.nearer() == Nearer::First, results.report.end_names());
    let (marked, filled, beyond) = (&results.marked[..], results.filled(), &results.beyond[..]);
    Map { marked, filled, beyond, first_is_near, ends, ..map }.write(writer, drawing)
}

/// The picture of labels.
const LABELS_FILE: &str = "labels.png";

/// Greatest number of frames of a sweep that `labels.png` can label. 0 means that the focus is not known.
pub const MOST_LABELS: usize = 255;

/// RGBA of the labels of a pair. Colour-blind viewers can tell orange and blue apart (Okabe and Ito 2008).
const LABEL_COLORS: [[u8; 4]; 4] = [[0, 0, 0, 0], [230, 159, 0, 255], [0, 114, 178, 255], [210, 210, 210, 255]];

/// `labels.png` of a pair, indexed colour of 8 bits:
///
/// | value | meaning |
/// | --- | --- |
/// | 0 | V is not valid |
/// | 1 | I1 is sharper: V > σ |
/// | 2 | I2 is sharper: V < -σ |
/// | 3 | undecided, \|V\| ≤ σ |
///
/// with σ the standard deviation of V.
pub fn labels(solution: &Solution) -> Extra<'_> {
    Extra::new(LABELS_FILE, |_, writer| {
        let values = solution.relative_blur.iter().zip(&solution.uncertainty);
        let bytes: Vec<u8> = values.map(|(&v, &sigma)| label(v, sigma)).collect();
        write_labels(writer, (solution.width, solution.height), &bytes, &LABEL_COLORS, &LABELS)
    })
}

/// `labels.png` of a sweep: the frame with its setting nearest to the pixel's focus, counted from 1; 0 where the focus
/// is not known. The colours run from the nearest to the farthest frame.
pub fn sweep_labels<'a>(palette: Palette) -> Extra<'a> {
    Extra::new(LABELS_FILE, move |results, writer| {
        let (positions, nearer) = (results.positions(), results.report.nearer());
        let count = positions.len();
        if count > MOST_LABELS {
            return Err(format!("there are {count} frames, and 8 bits can label {MOST_LABELS}"));
        }
        let color = |n: usize| {
            let t = n as f64 / (count - 1).max(1) as f64;
            let [r, g, b] = palette.color(if nearer == Nearer::First { 1.0 - t } else { t });
            [r, g, b, 255]
        };
        let colors: Vec<[u8; 4]> = LABEL_COLORS[..1].iter().copied().chain((0..count).map(color)).collect();
        let bytes: Vec<u8> = results.values().iter().map(|&u| nearest(u, &positions)).collect();
        write_labels(writer, results.size(), &bytes, &colors, &SWEEP_LABELS)
    })
}

/// The number, from 1, of the position that is nearest to a setting; 0 for NaN.
fn nearest(u: f32, positions: &[f64]) -> u8 {
    let off = |n: &usize| (positions[*n] - f64::from(u)).abs();
    let next = (0..positions.len()).filter(|n| off(n).is_finite()).min_by(|a, b| off(a).total_cmp(&off(b)));
    next.map_or(0, |n| n as u8 + 1)
}

fn write_labels(
    writer: &mut dyn Write,
    size: (u32, u32),
    labels: &[u8],
    colors: &[[u8; 4]],
    description: &Description,
) -> Result<(), String> {
    let mut encoder = png_encoder(writer, size, description, None)?;
    encoder.set_palette(colors.iter().flat_map(|c| &c[..3]).copied().collect::<Vec<u8>>());
    encoder.set_trns(colors.iter().map(|c| c[3]).collect::<Vec<u8>>());
    finish_png(encoder, ColorType::Indexed, &Pixels::Bytes(labels))
}

fn label(v: f32, sigma: f32) -> u8 {
    match v {
        v if v.is_nan() => 0,
        v if v > sigma => 1,
        v if v < -sigma => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Crops the map without the key.
    fn pixels(map: &Map) -> Vec<[u8; 4]> {
        let mut bytes = Vec::new();
        let plotter = Some(crate::page::figure::PLOTTER);
        map.write(&mut bytes, &Drawing { palette: map.palette, plotter }).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgba8();
        assert!(picture.width() > map.size.0 && picture.height() == map.size.1, "the key is to the right");
        let places = (0..map.size.1).flat_map(|y| (0..map.size.0).map(move |x| (x, y)));
        places.map(|(x, y)| picture.get_pixel(x, y).0).collect()
    }

    fn row(values: &[f32], nearer: Nearer) -> Vec<[u8; 4]> {
        let quantity = Quantity::relative_blur(values, &[], nearer);
        pixels(&Map::new((values.len() as u32, 1), quantity, Palette::Viridis))
    }

    fn opaque(nearness: f64) -> [u8; 4] {
        let [r, g, b] = Palette::Viridis.color(nearness);
        [r, g, b, 255]
    }

    #[test]
    fn invalid_pixels_are_transparent_and_a_single_value_is_drawn() {
        assert_eq!(row(&[f32::NAN, 2.0], Nearer::First), [[0; 4], opaque(0.5)]);
        assert_eq!(row(&[f32::NAN], Nearer::First), [[0; 4]]);
    }

    #[test]
    fn rounding_does_not_look_like_relief() {
        let noise: Vec<f32> = (0..100).map(|i| 1e-3 * (i % 7) as f32).collect();
        let greens: Vec<u8> = row(&noise, Nearer::First).iter().map(|p| p[1]).collect();
        let (least, most) = (greens.iter().min().unwrap(), greens.iter().max().unwrap());
        assert!(most - least < 10, "{least} to {most}");
    }

    #[test]
    fn an_outlier_does_not_move_the_scale() {
        let mut ramp: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        let before = row(&ramp, Nearer::First);
        ramp[999] = 1e9;
        assert_eq!(row(&ramp, Nearer::First), before);
    }

    #[test]
    fn the_least_depth_is_near_and_so_is_the_stated_end_of_the_focus() {
        let depth = Quantity::depth(&[600.0, f32::NAN, 700.0], &[], &[869.0, 529.0], Nearer::Second);
        assert_eq!(pixels(&Map::new((3, 1), depth, Palette::Grey)), [[255; 4], [0; 4], [0, 0, 0, 255]]);
        for (positions, nearer, first_pixel) in [
            ([0.0, 4.0], Nearer::First, 255),
            ([0.0, 4.0], Nearer::Second, 0),
            ([4.0, 0.0], Nearer::First, 0),
            ([4.0, 0.0], Nearer::Second, 255),
        ] {
            let focus = Quantity::focus(&[0.0, 4.0], &[], "settings", &positions, nearer);
            let map = Map::new((2, 1), focus, Palette::Grey);
            assert_eq!(pixels(&map)[0][0], first_pixel, "{positions:?} {nearer:?}");
        }
    }

    #[test]
    fn a_label_needs_more_than_a_standard_deviation() {
        let found = [(f32::NAN, f32::NAN), (2.0, 1.0), (-2.0, 1.0), (1.0, 1.0), (-0.5, 1.0), (100.0, 1000.0)];
        assert_eq!(found.map(|(v, sigma)| label(v, sigma)), [0, 1, 2, 3, 3, 3]);
    }

    #[test]
    fn a_pixel_of_a_sweep_has_the_label_of_the_nearest_frame() {
        let positions = [4.0, 3.0, 1.0];
        assert_eq!([9.0, 3.4, 2.1, 1.9, f32::NAN, f32::INFINITY].map(|u| nearest(u, &positions)), [1, 2, 2, 3, 0, 0]);
    }
}
