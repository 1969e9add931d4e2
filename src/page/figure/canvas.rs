//! The canvas for drawings: areas, lines, text and pictures.

use std::sync::LazyLock;

use image::RgbImage;
use image::imageops::{self, FilterType};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke, StrokeDash,
    Transform,
};
use ttf_parser::{Face, OutlineBuilder};

/// Greatest side of a canvas, px. A larger side is clamped to it.
pub(super) const MAX_SIDE: u32 = 1 << 14;

/// Red, green, blue.
pub type Color = [u8; 3];

pub const WHITE: Color = [255; 3];
pub const BLACK: Color = [20; 3];
pub const GRAY: Color = [96; 3];
pub const LIGHT: Color = [224; 3];

/// A rectangle in px; x right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    pub x: f32,
    pub y: f32,
    pub width: f32,
    pub height: f32,
}

impl Area {
    pub fn right(&self) -> f32 {
        self.x + self.width
    }

    pub fn bottom(&self) -> f32 {
        self.y + self.height
    }

    pub fn middle(&self) -> (f32, f32) {
        (self.x + self.width / 2.0, self.y + self.height / 2.0)
    }
}

/// Alignment of a line of text at its point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Align {
    Left,
    Middle,
    Right,
}

/// A canvas, initially white.
pub struct Canvas(Pixmap);

impl Canvas {
    /// Makes a white canvas. Its sides are clamped to 1 to [`MAX_SIDE`].
    pub fn new(width: u32, height: u32) -> Self {
        let side = |length: u32| length.clamp(1, MAX_SIDE);
        let mut pixmap = Pixmap::new(side(width), side(height)).expect("sides within limits");
        pixmap.fill(tiny_skia::Color::WHITE);
        Self(pixmap)
    }

    /// Fills a rectangle.
    pub fn fill(&mut self, area: Area, color: Color) {
        if let Some(rect) = rect(area) {
            self.0.fill_rect(rect, &paint(color), Transform::identity(), None);
        }
    }

    /// Draws the outline of a rectangle, centred on its edge.
    pub fn outline(&mut self, area: Area, color: Color, width: f32) {
        if let Some(rect) = rect(area) {
            self.stroke(&PathBuilder::from_rect(rect), color, width, None);
        }
    }

    /// Draws a line through points. It is dashed if a period is passed. Points that are not finite are left out.
    pub fn line(&mut self, points: &[(f32, f32)], color: Color, width: f32, dash: Option<f32>) {
        if let Some(path) = path(points).and_then(PathBuilder::finish) {
            self.stroke(&path, color, width, dash);
        }
    }

    /// Fills a polygon.
    pub fn polygon(&mut self, points: &[(f32, f32)], color: Color) {
        let path = path(points).and_then(|mut path| {
            path.close();
            path.finish()
        });
        if let Some(path) = path {
            self.0.fill_path(&path, &paint(color), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// Fills a circle.
    pub fn disc(&mut self, (x, y): (f32, f32), radius: f32, color: Color) {
        if let Some(path) = PathBuilder::from_circle(x, y, radius) {
            self.0.fill_path(&path, &paint(color), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// Draws a picture with its upper left corner at a pixel. The parts outside are cut off.
    pub fn image(&mut self, image: &RgbImage, (left, top): (u32, u32)) {
        let (width, height) = (self.0.width(), self.0.height());
        let pixels = self.0.pixels_mut();
        for (x, y, &image::Rgb([r, g, b])) in image.enumerate_pixels() {
            let (x, y) = (left.saturating_add(x), top.saturating_add(y));
            if x < width && y < height {
                pixels[(y * width + x) as usize] =
                    PremultipliedColorU8::from_rgba(r, g, b, 255).unwrap_or(PremultipliedColorU8::TRANSPARENT);
            }
        }
    }

    /// Writes a line of text whose baseline is at `y`.
    pub fn text(&mut self, text: &str, (x, y): (f32, f32), size: f32, align: Align, color: Color) {
        self.text_turned(text, (x, y), size, align, color, 0.0);
    }

    /// Writes a line of text upwards, with its baseline at `x`.
    pub fn text_up(&mut self, text: &str, (x, y): (f32, f32), size: f32, align: Align, color: Color) {
        self.text_turned(text, (x, y), size, align, color, -90.0);
    }

    fn text_turned(&mut self, text: &str, (x, y): (f32, f32), size: f32, align: Align, color: Color, turn: f32) {
        let Some(path) = text_outline(text, size) else { return };
        let start = match align {
            Align::Left => 0.0,
            Align::Middle => -text_width(text, size) / 2.0,
            Align::Right => -text_width(text, size),
        };
        let place = Transform::from_translate(start, 0.0).post_rotate(turn).post_translate(x, y);
        self.0.fill_path(&path, &paint(color), FillRule::Winding, place, None);
        // The font is light. A thin outline gives it the weight that small text needs.
        let stroke = Stroke { width: 0.022 * size, ..Stroke::default() };
        self.0.stroke_path(&path, &paint(color), &stroke, place, None);
    }

    fn stroke(&mut self, path: &Path, color: Color, width: f32, dash: Option<f32>) {
        let dash = dash.and_then(|period| StrokeDash::new(vec![0.6 * period, 0.4 * period], 0.0));
        let line_cap = if dash.is_some() { LineCap::Butt } else { LineCap::Square };
        let stroke = Stroke { width, dash, line_cap, line_join: LineJoin::Round, ..Stroke::default() };
        self.0.stroke_path(path, &paint(color), &stroke, Transform::identity(), None);
    }

    /// The picture.
    pub fn into_image(self) -> RgbImage {
        let mut image = RgbImage::new(self.0.width(), self.0.height());
        for (to, from) in image.pixels_mut().zip(self.0.pixels()) {
            to.0 = [from.red(), from.green(), from.blue()];
        }
        image
    }
}

fn rect(area: Area) -> Option<Rect> {
    Rect::from_xywh(area.x, area.y, area.width, area.height)
}

fn paint(color: Color) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(color[0], color[1], color[2], 255);
    paint
}

/// A path through points; `None` without points.
fn path(points: &[(f32, f32)]) -> Option<PathBuilder> {
    let (&(x, y), rest) = points.split_first()?;
    let mut path = PathBuilder::new();
    path.move_to(x, y);
    rest.iter().for_each(|&(x, y)| path.line_to(x, y));
    Some(path)
}

/// Ubuntu Light, Ubuntu font licence 1.0: Latin, Greek, ², ° and ±.
static FACE: LazyLock<Face<'static>> = LazyLock::new(|| {
    Face::parse(epaint_default_fonts::UBUNTU_LIGHT, 0).expect("the embedded font is sound: a test draws with it")
});

/// Width of a line of text, px, at `size` px for the em square.
pub fn text_width(text: &str, size: f32) -> f32 {
    text.chars().map(|c| advance(c, size)).sum()
}

/// The outline of a line of text whose baseline starts at (0, 0), y down; `None` if there is nothing to draw.
pub(super) fn text_outline(text: &str, size: f32) -> Option<Path> {
    let mut pen = GlyphPen { path: PathBuilder::new(), scale: scale(size), x: 0.0 };
    for c in text.chars() {
        if let Some(glyph) = FACE.glyph_index(c) {
            FACE.outline_glyph(glyph, &mut pen);
        }
        pen.x += advance(c, size);
    }
    pen.path.finish()
}

fn scale(size: f32) -> f32 {
    size / f32::from(FACE.units_per_em())
}

fn advance(c: char, size: f32) -> f32 {
    let units = FACE.glyph_index(c).and_then(|glyph| FACE.glyph_hor_advance(glyph));
    units.map_or(0.5 * size, |units| f32::from(units) * scale(size))
}

/// Builds the path of a line of text from the outlines of glyphs, in font units with y up.
struct GlyphPen {
    path: PathBuilder,
    scale: f32,
    x: f32,
}

impl GlyphPen {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + x * self.scale, -y * self.scale)
    }
}

impl OutlineBuilder for GlyphPen {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.path.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}

/// Resizes a picture by a triangle filter.
pub(crate) fn resized(picture: &RgbImage, (width, height): (u32, u32)) -> RgbImage {
    if picture.dimensions() == (width, height) {
        return picture.clone();
    }
    imageops::resize(picture, width.max(1), height.max(1), FilterType::Triangle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_drawn_at_their_positions() {
        let mut canvas = Canvas::new(40, 30);
        canvas.fill(Area { x: 10.0, y: 5.0, width: 10.0, height: 5.0 }, [255, 0, 0]);
        canvas.image(&RgbImage::from_pixel(2, 2, image::Rgb([0, 0, 255])), (30, 20));
        let image = canvas.into_image();
        assert_eq!(image.get_pixel(10, 5).0, [255, 0, 0]);
        assert_eq!(image.get_pixel(19, 9).0, [255, 0, 0]);
        assert_eq!((image.get_pixel(20, 9).0, image.get_pixel(9, 5).0), (WHITE, WHITE));
        assert_eq!((image.get_pixel(31, 21).0, image.get_pixel(32, 21).0), ([0, 0, 255], WHITE));
    }

    #[test]
    fn shapes_that_cannot_be_drawn_are_left_out() {
        let mut canvas = Canvas::new(0, 0);
        let nan = f32::NAN;
        canvas.line(&[(nan, 1.0), (2.0, 3.0)], BLACK, 1.0, Some(0.0));
        canvas.line(&[], BLACK, 1.0, None);
        canvas.disc((nan, 0.0), 3.0, BLACK);
        canvas.fill(Area { x: nan, y: 0.0, width: -1.0, height: 2.0 }, BLACK);
        canvas.text("x", (nan, 0.0), 12.0, Align::Middle, BLACK);
        canvas.image(&RgbImage::new(3, 3), (u32::MAX, 0));
        assert_eq!(canvas.into_image().dimensions(), (1, 1));
    }

    #[test]
    fn text_is_on_its_baseline() {
        let mut canvas = Canvas::new(60, 40);
        canvas.text("H", (10.0, 30.0), 20.0, Align::Left, BLACK);
        let image = canvas.into_image();
        let dark = |y: u32| (0..60).any(|x| image.get_pixel(x, y)[0] < 100);
        assert!(dark(29) && dark(20) && !dark(32) && !dark(10));
    }

    #[test]
    fn the_font_has_the_characters_of_figures() {
        for c in "Ag09.,:;±×²°−–αησθε|<>≤%()".chars() {
            assert!(FACE.glyph_index(c).is_some(), "{c}");
        }
    }

    #[test]
    fn the_width_is_the_end_of_the_outline() {
        let size = 20.0;
        let bounds = text_outline("HHH", size).unwrap().bounds();
        assert!(
            bounds.right() <= text_width("HHH", size) && bounds.right() > 0.8 * text_width("HHH", size),
            "{bounds:?}"
        );
        assert!(bounds.top() < -0.5 * size && bounds.bottom().abs() < 0.5, "{bounds:?}");
        assert!(text_outline("", size).is_none() && text_outline("  ", size).is_none());
    }
}
