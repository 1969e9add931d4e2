//! `depth.png`: depth, or what stands for it, as a map in colour with its key to the right.

use std::io::Write;

use image::RgbImage;
use png::ColorType;

use super::meaning::Meaning;
use super::picture::{self, Stored};
use super::{Nearer, Palette, Pen, Scale};
use crate::metric::MetricDepth;
use crate::solve::sweep::Sweep;

/// The least span of a scale in mm or in settings, as a part of the distance between the focus settings: less than that is
/// noise, and must not look like relief.
const LEAST_PART: f64 = 0.01;
/// Stripes of pixels of which nothing tells: light and dark grey.
const HATCH: [[u8; 4]; 2] = [[205, 205, 205, 255], [165, 165, 165, 255]];
/// Width of a stripe along x, px.
const HATCH_WIDTH: usize = 4;

/// A field that tells near from far, and how it is drawn.
pub(super) struct Map<'a> {
    size: (u32, u32),
    /// Row-major; NaN where not valid.
    values: &'a [f32],
    /// `nearer` says whether its high end is near (`First`) or its low one.
    scale: Scale,
    quantity: &'static str,
    unit: &'static str,
    palette: Palette,
    /// Which pixels nothing tells of; none if empty.
    marked: &'a [bool],
    /// -1 or 1 where no frame of a sweep is in focus, by side; none if empty.
    beyond: &'a [i8],
    /// Whether what lies before the first frame is near.
    before_is_near: bool,
}

impl<'a> Map<'a> {
    /// V, px².
    pub(super) fn of_relative_blur(size: (u32, u32), values: &'a [f32], nearer: Nearer, palette: Palette) -> Self {
        Self {
            size,
            values,
            scale: Scale::of(values, nearer),
            quantity: "V",
            unit: "px²",
            palette,
            marked: &[],
            beyond: &[],
            before_is_near: true,
        }
    }

    /// Depth in mm through a lens.
    pub(super) fn of_depth(metric: &'a MetricDepth, palette: Palette) -> Self {
        let [first, second] = metric.lens.focus;
        let (size, apart) = ((metric.width, metric.height), (second - first).abs());
        Self::in_mm(size, &metric.depth, apart, Nearer::Second, palette)
    }

    /// Depth in mm of a sweep, or where it is in focus if that is not known.
    pub(super) fn of_sweep(sweep: &'a Sweep, nearer: Nearer, palette: Palette) -> Self {
        let size = (sweep.width, sweep.height);
        let Some(found) = &sweep.depth else {
            return Self::of_focus(size, &sweep.focus, &sweep.positions, nearer, palette);
        };
        let stated = sweep.stated.millimetres().unwrap_or_default();
        let apart = stated.first().zip(stated.last()).map_or(0.0, |(first, last)| (last - first).abs());
        Self::in_mm(size, &found.depth, apart, larger_is(stated, nearer), palette)
    }

    /// Depth in mm; the planes of focus are so many mm apart. `near` says whether the greatest is near (`First`) or the
    /// least.
    fn in_mm(size: (u32, u32), values: &'a [f32], apart: f64, near: Nearer, palette: Palette) -> Self {
        let scale = Scale::spanning([values], near, (LEAST_PART * apart).max(1e-6) as f32);
        Self {
            size,
            values,
            scale,
            quantity: "depth",
            unit: "mm",
            palette,
            marked: &[],
            beyond: &[],
            before_is_near: true,
        }
    }

    /// Focus settings from the first to the last of `positions`, the nearest of which is at the end that `nearer` names.
    fn of_focus(size: (u32, u32), values: &'a [f32], positions: &[f64], nearer: Nearer, palette: Palette) -> Self {
        let (first, last) = (positions.first().copied().unwrap_or(0.0), positions.last().copied().unwrap_or(0.0));
        let near = larger_is(positions, nearer);
        let scale = Scale::spanning([values], near, (LEAST_PART * (last - first).abs()).max(1e-6) as f32);
        Self {
            size,
            values,
            scale,
            quantity: "focus",
            unit: "setting",
            palette,
            marked: &[],
            beyond: &[],
            before_is_near: true,
        }
    }

    /// The same with pixels hatched that nothing tells of, for want of texture or otherwise.
    pub(super) fn marking(self, marked: &'a [bool]) -> Self {
        Self { marked, ..self }
    }

    /// The same with pixels that no frame has in focus striped the other way, in the colour of the end that they lie beyond.
    pub(super) fn never_in_focus(self, beyond: &'a [i8], before_is_near: bool) -> Self {
        Self { beyond, before_is_near, ..self }
    }

    /// What is drawn, and on which scale.
    pub(super) fn surface(&self) -> (&'a [f32], Scale) {
        (self.values, self.scale)
    }

    /// RGBA of a pixel: in colour, transparent where not valid, hatched where marked.
    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let i = y * self.size.0 as usize + x;
        if let Some(side) = self.beyond.get(i).filter(|side| **side != 0) {
            let is_near = (*side < 0) == self.before_is_near;
            let [r, g, b] = self.palette.color(f64::from(u8::from(is_near)));
            let stripe = (x + self.size.1 as usize - y) / HATCH_WIDTH % 2;
            return if stripe == 0 { [r, g, b, 255] } else { HATCH[0] };
        }
        if self.marked.get(i).is_some_and(|&marked| marked) {
            HATCH[(x + y) / HATCH_WIDTH % 2]
        } else {
            self.rgba(self.values[i])
        }
    }

    /// RGBA; transparent where not valid.
    fn rgba(&self, v: f32) -> [u8; 4] {
        if !v.is_finite() {
            return [0; 4];
        }
        let [r, g, b] = self.palette.color(self.scale.nearness(v));
        [r, g, b, 255]
    }

    fn meaning(&self) -> Meaning {
        let [near, far] = [1.0, 0.0].map(|nearness| self.scale.value(nearness) as f32);
        let [near_color, far_color] = self.palette.ends();
        // The text of a PNG is ASCII.
        let (name, units) = match self.unit {
            "px²" => ("relative blur V", "px^2"),
            unit => (self.quantity, unit),
        };
        let comments = format!(
            "Map of {name} in {units}, {near_color} near ({near}) to {far_color} far ({far}), transparent where not \
             valid, hatched in grey where nothing tells, the other way in the colour of an end where the focus lies beyond \
             it; its key is to the right of column {}",
            self.size.0
        );
        Meaning { units, comments: comments.into() }
    }
}

/// Writes `depth.png`: RGBA, the map at its own pixels, widened to the right by the key on white.
pub(super) fn write(writer: impl Write, map: &Map<'_>, pen: Option<Pen>) -> Result<(), String> {
    let (width, height) = map.size;
    let title = format!("{}, {}", map.quantity, map.unit);
    let key = pen.map_or_else(|| RgbImage::new(0, height), |pen| (pen.key)(&title, &map.scale, map.palette, map.size));
    let mut pixels = Vec::with_capacity(4 * (width + key.width()) as usize * height as usize);
    for y in 0..height {
        pixels.extend((0..width as usize).flat_map(|x| map.pixel(x, y as usize)));
        // Beyond the paper, of which there is so much and no more, nothing.
        let beside =
            (0..key.width()).flat_map(|x| key.get_pixel_checked(x, y).map_or([0; 4], |p| [p[0], p[1], p[2], 255]));
        pixels.extend(beside);
    }
    let size = (width + key.width(), height);
    picture::write(writer, size, ColorType::Rgba, &Stored::Bytes(&pixels), &map.meaning())
}

/// The scale of a sweep's focus settings.
pub(crate) fn focus_scale(sweep: &Sweep, nearer: Nearer) -> Scale {
    Map::of_focus((sweep.width, sweep.height), &sweep.focus, &sweep.positions, nearer, Palette::default()).scale
}

/// The sense of a scale of focus settings: [`Nearer::First`] where a larger one is near.
pub(crate) fn larger_is(positions: &[f64], nearer: Nearer) -> Nearer {
    let descending = positions.first() > positions.last();
    if descending == (nearer == Nearer::First) { Nearer::First } else { Nearer::Second }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Lens;

    /// The pixels of the map alone.
    fn pixels(map: &Map) -> Vec<[u8; 4]> {
        let mut bytes = Vec::new();
        write(&mut bytes, map, Some(crate::page::figure::PEN)).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgba8();
        assert!(picture.width() > map.size.0 && picture.height() == map.size.1, "the key stands to the right");
        let places = (0..map.size.1).flat_map(|y| (0..map.size.0).map(move |x| (x, y)));
        places.map(|(x, y)| picture.get_pixel(x, y).0).collect()
    }

    fn of_row(values: &[f32], nearer: Nearer) -> Vec<[u8; 4]> {
        pixels(&Map::of_relative_blur((values.len() as u32, 1), values, nearer, Palette::Viridis))
    }

    fn opaque(nearness: f64) -> [u8; 4] {
        let [r, g, b] = Palette::Viridis.color(nearness);
        [r, g, b, 255]
    }

    #[test]
    fn the_image_focused_nearer_decides_which_end_is_near() {
        let ramp: Vec<f32> = (0..101).map(|i| i as f32 - 50.0).collect();
        let (first, second) = (of_row(&ramp, Nearer::First), of_row(&ramp, Nearer::Second));
        assert_eq!((first[100], second[100], first[0]), (opaque(1.0), opaque(0.0), second[100]));
    }

    #[test]
    fn what_is_not_valid_is_transparent_and_one_value_is_drawn() {
        assert_eq!(of_row(&[f32::NAN, 2.0], Nearer::First), [[0; 4], opaque(0.5)]);
        assert_eq!(of_row(&[f32::NAN], Nearer::First), [[0; 4]]);
    }

    #[test]
    fn rounding_does_not_look_like_relief() {
        let noise: Vec<f32> = (0..100).map(|i| 1e-3 * (i % 7) as f32).collect();
        let greens: Vec<u8> = of_row(&noise, Nearer::First).iter().map(|p| p[1]).collect();
        let (least, most) = (greens.iter().min().unwrap(), greens.iter().max().unwrap());
        assert!(most - least < 10, "{least} to {most}");
    }

    #[test]
    fn a_wild_pixel_does_not_move_the_scale() {
        let mut ramp: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        let before = of_row(&ramp, Nearer::First);
        ramp[999] = 1e9;
        assert_eq!(of_row(&ramp, Nearer::First), before);
    }

    #[test]
    fn of_depth_the_least_is_near_and_of_settings_the_end_that_is_named() {
        let lens = Lens {
            focal_length: 25.0,
            f_number: 8.3,
            pixel_pitch: 0.013,
            focus: [869.0, 529.0],
            kappa: Lens::DISK,
            telecentric: true,
        };
        let depth = vec![600.0, f32::NAN, 700.0];
        let deviation = vec![1.0, f32::NAN, 1.0];
        let metric = MetricDepth { width: 3, height: 1, depth, deviation, out_of_range: 1, lens };
        assert_eq!(pixels(&Map::of_depth(&metric, Palette::Grey)), [[255; 4], [0; 4], [0, 0, 0, 255]]);
        let focus = [0.0, 4.0];
        for (positions, nearer, first_pixel) in [
            ([0.0, 4.0], Nearer::First, 255),
            ([0.0, 4.0], Nearer::Second, 0),
            ([4.0, 0.0], Nearer::First, 0),
            ([4.0, 0.0], Nearer::Second, 255),
        ] {
            let map = Map::of_focus((2, 1), &focus, &positions, nearer, Palette::Grey);
            assert_eq!(pixels(&map)[0][0], first_pixel, "{positions:?} {nearer:?}");
        }
    }
}
