//! Text as outlines of the embedded font.

use std::sync::LazyLock;

use tiny_skia::{Path, PathBuilder};
use ttf_parser::{Face, OutlineBuilder};

/// Ubuntu Light, Ubuntu font licence 1.0: Latin, Greek, ², ° and ±.
static FACE: LazyLock<Face<'static>> = LazyLock::new(|| {
    Face::parse(epaint_default_fonts::UBUNTU_LIGHT, 0).expect("the embedded font is sound: a test draws with it")
});

/// Width of a line of text, px, at `size` px for the em square.
pub(crate) fn width(text: &str, size: f32) -> f32 {
    text.chars().map(|c| advance(c, size)).sum()
}

/// The outline of a line of text whose baseline starts at (0, 0), y down; `None` if there is nothing to draw.
pub(super) fn outline(text: &str, size: f32) -> Option<Path> {
    let mut pen = Pen { path: PathBuilder::new(), scale: scale(size), x: 0.0 };
    for c in text.chars() {
        if let Some(glyph) = FACE.glyph_index(c) {
            FACE.outline_glyph(glyph, &mut pen);
        }
        pen.x += advance(c, size);
    }
    pen.path.finish()
}

/// Text as lines of at most `limit` px, broken between words; a single word may be longer.
pub(crate) fn wrap(text: &str, size: f32, limit: f32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(line, size) + width(" ", size) + width(word, size) <= limit => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_string()),
        }
    }
    lines
}

fn scale(size: f32) -> f32 {
    size / f32::from(FACE.units_per_em())
}

fn advance(c: char, size: f32) -> f32 {
    let units = FACE.glyph_index(c).and_then(|glyph| FACE.glyph_hor_advance(glyph));
    units.map_or(0.5 * size, |units| f32::from(units) * scale(size))
}

/// Puts the outlines of glyphs, in font units and y up, side by side.
struct Pen {
    path: PathBuilder,
    scale: f32,
    x: f32,
}

impl Pen {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + x * self.scale, -y * self.scale)
    }
}

impl OutlineBuilder for Pen {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_font_has_what_figures_write() {
        for c in "Ag09.,:;±×²°−–αησθε|<>≤%()".chars() {
            assert!(FACE.glyph_index(c).is_some(), "{c}");
        }
    }

    #[test]
    fn width_is_where_the_outline_ends() {
        let size = 20.0;
        let bounds = outline("HHH", size).unwrap().bounds();
        assert!(bounds.right() <= width("HHH", size) && bounds.right() > 0.8 * width("HHH", size), "{bounds:?}");
        assert!(bounds.top() < -0.5 * size && bounds.bottom().abs() < 0.5, "{bounds:?}");
        assert!(outline("", size).is_none() && outline("  ", size).is_none());
    }

    #[test]
    fn lines_break_between_words() {
        let limit = width("too few", 12.0) + 0.1;
        assert_eq!(wrap("too few key-points", 12.0, limit), ["too few", "key-points"]);
        assert_eq!(wrap("registration", 12.0, 1.0), ["registration"]);
        assert!(wrap("  ", 12.0, 100.0).is_empty());
    }
}
