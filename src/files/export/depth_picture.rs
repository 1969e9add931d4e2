//! `depth.png`: depth, V or focus as a map in colour, with its key to the right.

use std::io::Write;

use image::RgbImage;
use png::ColorType;
use serde::Serialize;

use super::description::Description;
use super::extra::Drawing;
use super::png_file::{self, Pixels};
use super::results::Results;
use super::scale::{Nearer, Quantity, Scale};

/// Stripes over pixels that are not measured: light and dark grey.
const HATCH: [[u8; 4]; 2] = [[205, 205, 205, 255], [165, 165, 165, 255]];
/// Width of a stripe along x, px.
const HATCH_WIDTH: usize = 4;

/// Colours of near and far in every picture and on the page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Palette {
    /// Near yellow, far purple; perceptually uniform
    ///
    /// Viridis (van der Walt and Smith 2015), also for colour-blind viewers and in grey print.
    #[default]
    Viridis,
    /// Near red, far blue, as in the paper
    ///
    /// Turbo (Mikhailov 2019).
    RedBlue,
    /// Near white, far black
    Grey,
}

impl Palette {
    /// RGB of a nearness, clamped to 0 (far) to 1 (near).
    pub fn color(self, nearness: f64) -> [u8; 3] {
        let t = nearness.clamp(0.0, 1.0);
        match self {
            Self::Viridis => colorous::VIRIDIS.eval_continuous(t).as_array(),
            // Leaves out the last tenth at either end, which darkens towards violet and maroon.
            Self::RedBlue => colorous::TURBO.eval_continuous(0.1 + 0.8 * t).as_array(),
            Self::Grey => [(255.0 * t).round() as u8; 3],
        }
    }

    /// Names of the colours of near and far.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Viridis => ["yellow", "purple"],
            Self::RedBlue => ["red", "blue"],
            Self::Grey => ["white", "black"],
        }
    }
}

/// A quantity with the options of its picture.
struct Map<'a> {
    size: (u32, u32),
    quantity: Quantity<'a>,
    scale: Scale,
    palette: Palette,
    /// Pixels to hatch, since they are not measured; none if empty.
    marked: &'a [bool],
    /// -1 or 1 where no frame of a sweep is in focus, by side; none if empty.
    beyond: &'a [i8],
    /// Whether the first frame of a sweep is focused nearest.
    first_is_near: bool,
}

impl<'a> Map<'a> {
    fn new(size: (u32, u32), quantity: Quantity<'a>, palette: Palette) -> Self {
        let scale = quantity.scale();
        Self { size, quantity, scale, palette, marked: &[], beyond: &[], first_is_near: true }
    }

    /// RGBA of a pixel: the colour of its value, transparent where not valid, hatched where marked. Where no frame of a
    /// sweep is in focus, it is hatched the other way, in the colour of the end beyond which the focus lies.
    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let i = y * self.size.0 as usize + x;
        if let Some(side) = self.beyond.get(i).filter(|side| **side != 0) {
            let is_near = (*side < 0) == self.first_is_near;
            let [r, g, b] = self.palette.color(f64::from(u8::from(is_near)));
            let stripe = (x + self.size.1 as usize - y) / HATCH_WIDTH % 2;
            return if stripe == 0 { [r, g, b, 255] } else { HATCH[0] };
        }
        if self.marked.get(i).is_some_and(|&marked| marked) {
            return HATCH[(x + y) / HATCH_WIDTH % 2];
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
        let (name, units) = match self.title() {
            ["V", _] => ("relative blur V", "px^2"),
            [name, unit] => (name, unit),
        };
        let comments = format!(
            "Map of {name} in {units}, {near_color} near ({near}) to {far_color} far ({far}), transparent where not \
             valid, hatched in grey where not measured, the other way in the colour of an end where the focus lies beyond \
             it; its key is to the right of column {}",
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
            |plotter| (plotter.key)(&title, &self.scale, self.palette, self.size),
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
        png_file::write(writer, size, ColorType::Rgba, &Pixels::Bytes(&pixels), &self.description())
    }
}

/// Writes `depth.png`.
pub(super) fn write(writer: impl Write, results: &Results<'_>, drawing: &Drawing) -> Result<(), String> {
    let map = Map::new(results.size(), results.best(), drawing.palette);
    let first_is_near = results.report.nearer() == Nearer::First;
    Map { marked: &results.marked, beyond: &results.beyond, first_is_near, ..map }.write(writer, drawing)
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
    fn the_image_focused_nearer_decides_which_end_is_near() {
        let ramp: Vec<f32> = (0..101).map(|i| i as f32 - 50.0).collect();
        let (first, second) = (row(&ramp, Nearer::First), row(&ramp, Nearer::Second));
        assert_eq!((first[100], second[100], first[0]), (opaque(1.0), opaque(0.0), second[100]));
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
    fn near_is_bright_yellow_red_or_white() {
        let [near, far] = [1.0, 0.0].map(|t| Palette::Viridis.color(t));
        assert!(near[0] > 200 && near[1] > 200 && near[2] < 80, "{near:?}");
        assert!(far.iter().all(|c| *c < 100) && far[2] > far[1], "{far:?}");
        assert_eq!((Palette::Grey.color(2.0), Palette::Grey.color(-1.0)), ([255; 3], [0; 3]));
        let [[r, g, b], far] = [1.0, 0.0].map(|t| Palette::RedBlue.color(t));
        assert!(r > 150 && g < 100 && b < 50, "{r} {g} {b}");
        assert!(far[2] > 200 && far[0] < 100 && far[1] < 150, "{far:?}");
    }

    #[test]
    fn viridis_brightens_monotonically() {
        let luminance = |t: f64| {
            let [r, g, b] = Palette::Viridis.color(t).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f64> = (0..=50).map(|i| luminance(f64::from(i) / 50.0)).collect();
        assert!(steps.is_sorted(), "{steps:?}");
    }
}
