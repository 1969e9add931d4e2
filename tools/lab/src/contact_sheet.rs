//! Contact sheets: labelled panels in rows and columns, like the paper's Figures 4 and 6.
//!
//! V is red where near and blue where far, as in the paper, and grey where not valid. A panel that cannot be drawn
//! shows the reason.

use image::RgbImage;
use image::imageops::{self, FilterType};
use parfocal::export::{Palette, Scale};
use parfocal::internals::canvas::{Align, Area, BLACK, Canvas, Color, GRAY, LIGHT, text_width};
use parfocal::page::figure::PLOTTER;

/// The palette of the paper's figures.
pub(crate) const PALETTE: Palette = Palette::RedBlue;

/// Margin around the sheet, px.
const MARGIN: f32 = 16.0;
/// Gap between panels, px.
const GAP: f32 = 8.0;
/// Sizes of the title, of the names of columns and rows, and of captions, px.
const TITLE: f32 = 22.0;
const NAME: f32 = 16.0;
const CAPTION: f32 = 13.0;
/// Height of a line of text divided by its size.
const LINE: f32 = 1.3;
/// Greatest ratio of height to width of a panel. One tall picture must not stretch its row.
const TALLEST: f32 = 1.6;
/// Width of the key of a scale, px.
const KEY: f32 = 80.0;
/// Ratio of height to width of the panels of a row without a picture.
const NO_PICTURE: f32 = 0.3;

/// One panel of a [`Sheet`].
pub(crate) struct Panel {
    /// The picture, not empty, or the reason why there is none.
    pub picture: Result<RgbImage, String>,
    /// The text below the panel.
    pub caption: String,
}

impl Panel {
    pub(crate) fn new(picture: RgbImage) -> Self {
        Self { picture: Ok(picture), caption: String::new() }
    }

    pub(crate) fn missing(reason: &str) -> Self {
        Self { picture: Err(reason.to_string()), caption: String::new() }
    }

    /// V, px², in the colours of a scale; grey where not valid. Panels that are compared share a scale.
    pub(crate) fn relative_blur(width: u32, height: u32, values: &[f32], scale: &Scale) -> Self {
        let color = |v: f32| -> Color { if v.is_finite() { PALETTE.color(scale.nearness(v)) } else { LIGHT } };
        let picture = RgbImage::from_raw(width, height, values.iter().flat_map(|&v| color(v)).collect());
        picture.map_or_else(|| Self::missing("too few values"), Self::new)
    }

    /// Ratio of height to width; `None` without a picture.
    fn aspect(&self) -> Option<f32> {
        self.picture.as_ref().ok().map(|picture| picture.height() as f32 / picture.width() as f32)
    }
}

/// A grid of panels.
#[derive(Default)]
pub(crate) struct Sheet {
    pub title: String,
    /// The names above the columns.
    pub columns: Vec<&'static str>,
    pub rows: Vec<Row>,
    /// The text below the rows.
    pub footer: &'static str,
    /// Width of all panels, px.
    pub panel_width: u32,
}

/// One row of a [`Sheet`].
#[derive(Default)]
pub(crate) struct Row {
    /// The name to its left.
    pub name: String,
    pub panels: Vec<Panel>,
    /// The scale of V, drawn at the right.
    pub scale: Option<Scale>,
}

/// The positions of the parts of a sheet, px.
struct Layout {
    width: u32,
    height: u32,
    left: f32,
    top: f32,
    /// The top of each row, and the height of its panels without their captions.
    rows: Vec<[f32; 2]>,
}

impl Sheet {
    /// Draws the sheet. Pictures are scaled to the width of the panel.
    pub(crate) fn draw(&self) -> RgbImage {
        let layout = self.layout();
        let mut canvas = Canvas::new(layout.width, layout.height);
        canvas.text(&self.title, (MARGIN, MARGIN + TITLE), TITLE, Align::Left, BLACK);
        for (i, name) in self.columns.iter().enumerate() {
            let middle = self.column(&layout, i) + self.panel_width as f32 / 2.0;
            canvas.text(name, (middle, layout.top - 0.5 * NAME), NAME, Align::Middle, BLACK);
        }
        for (row, [y, height]) in self.rows.iter().zip(&layout.rows) {
            self.draw_row(&mut canvas, &layout, row, *y, *height);
        }
        let lines = self.footer_lines(layout.width as f32);
        for (i, line) in lines.iter().enumerate() {
            let y = layout.height as f32 - MARGIN - (lines.len() - 1 - i) as f32 * LINE * CAPTION;
            canvas.text(line, (MARGIN, y), CAPTION, Align::Left, GRAY);
        }
        canvas.into_image()
    }

    fn draw_row(&self, canvas: &mut Canvas, layout: &Layout, row: &Row, y: f32, height: f32) {
        let middle = y + height / 2.0;
        canvas.text_up(&row.name, (MARGIN + NAME, middle), NAME, Align::Middle, BLACK);
        for (i, panel) in row.panels.iter().enumerate() {
            let cell = Area { x: self.column(layout, i), y, width: self.panel_width as f32, height };
            draw_panel(canvas, cell, panel);
            for (k, line) in wrap_text(&panel.caption, CAPTION, cell.width).iter().enumerate() {
                let y = cell.bottom() + (k as f32 + 1.0) * LINE * CAPTION;
                canvas.text(line, (cell.middle().0, y), CAPTION, Align::Middle, GRAY);
            }
        }
        if let Some(scale) = &row.scale {
            let key = (PLOTTER.key)(["V, px²", "near", "far"], scale, PALETTE, (self.panel_width, height as u32));
            canvas.image(&key, (self.column(layout, self.column_count()) as u32, y as u32));
        }
    }

    fn column(&self, layout: &Layout, index: usize) -> f32 {
        layout.left + index as f32 * (self.panel_width as f32 + GAP)
    }

    fn column_count(&self) -> usize {
        self.rows.iter().map(|row| row.panels.len()).max().unwrap_or(0).max(self.columns.len())
    }

    fn layout(&self) -> Layout {
        let named = self.rows.iter().any(|row| !row.name.is_empty());
        let left = MARGIN + if named { NAME + GAP } else { 0.0 };
        let columns = self.column_count() as f32 * (self.panel_width as f32 + GAP) - GAP;
        let keys = if self.rows.iter().any(|row| row.scale.is_some()) { GAP + KEY } else { 0.0 };
        let title = 2.0 * MARGIN + text_width(&self.title, TITLE);
        let width = (left + columns.max(0.0) + keys + MARGIN).max(title).ceil();
        let top = MARGIN
            + if self.title.is_empty() { 0.0 } else { LINE * TITLE + GAP }
            + if self.columns.is_empty() { 0.0 } else { LINE * NAME + GAP / 2.0 };
        let mut y = top.ceil();
        let mut rows = Vec::with_capacity(self.rows.len());
        for row in &self.rows {
            let height = self.panel_height(row);
            rows.push([y, height]);
            let lines =
                row.panels.iter().map(|panel| wrap_text(&panel.caption, CAPTION, self.panel_width as f32).len());
            y += (height + lines.max().unwrap_or(0) as f32 * LINE * CAPTION + 1.5 * GAP).ceil();
        }
        let footer = match self.footer_lines(width).len() {
            0 => 0.0,
            lines => GAP + lines as f32 * LINE * CAPTION,
        };
        Layout {
            width: width as u32,
            height: (y - 1.5 * GAP + footer + MARGIN).ceil() as u32,
            left,
            top: top.ceil(),
            rows,
        }
    }

    fn panel_height(&self, row: &Row) -> f32 {
        let tallest = row.panels.iter().filter_map(Panel::aspect).reduce(f32::max);
        (self.panel_width as f32 * tallest.unwrap_or(NO_PICTURE).min(TALLEST)).round().max(1.0)
    }

    fn footer_lines(&self, width: f32) -> Vec<String> {
        wrap_text(self.footer, CAPTION, width - 2.0 * MARGIN)
    }
}

/// Splits text into lines of at most `limit` px, between words. A single word may be longer.
fn wrap_text(text: &str, size: f32, limit: f32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(line, size) + text_width(" ", size) + text_width(word, size) <= limit => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_string()),
        }
    }
    lines
}

fn draw_panel(canvas: &mut Canvas, cell: Area, panel: &Panel) {
    let picture = match &panel.picture {
        Ok(picture) => picture,
        Err(reason) => return draw_missing(canvas, cell, reason),
    };
    let (width, height) = (picture.width() as f32, picture.height() as f32);
    let scale = (cell.width / width).min(cell.height / height);
    let size = ((width * scale).round().max(1.0) as u32, (height * scale).round().max(1.0) as u32);
    let x = (cell.x + (cell.width - size.0 as f32) / 2.0).round();
    let y = (cell.y + (cell.height - size.1 as f32) / 2.0).round();
    canvas.image(&imageops::resize(picture, size.0, size.1, FilterType::Triangle), (x as u32, y as u32));
}

fn draw_missing(canvas: &mut Canvas, cell: Area, reason: &str) {
    canvas.outline(
        Area { x: cell.x + 0.5, y: cell.y + 0.5, width: cell.width - 1.0, height: cell.height - 1.0 },
        LIGHT,
        1.0,
    );
    let (x, y) = cell.middle();
    canvas.line(&[(x - 12.0, y - 8.0), (x + 12.0, y - 8.0)], GRAY, 2.0, None);
    for (i, line) in wrap_text(reason, CAPTION, cell.width - 2.0 * GAP).iter().enumerate() {
        canvas.text(line, (x, y + 14.0 + i as f32 * LINE * CAPTION), CAPTION, Align::Middle, GRAY);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use parfocal::export::Nearer;

    fn plain(width: u32, height: u32, color: [u8; 3]) -> Panel {
        Panel::new(RgbImage::from_pixel(width, height, Rgb(color)))
    }

    fn row(panels: Vec<Panel>) -> Row {
        Row { panels, ..Row::default() }
    }

    /// The least and greatest x and y of the pixels of a colour.
    fn extent(image: &RgbImage, color: [u8; 3]) -> Option<[u32; 4]> {
        let found = image.enumerate_pixels().filter(|(_, _, p)| p.0 == color).map(|(x, y, _)| [x, y, x, y]);
        found.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])])
    }

    #[test]
    fn panels_are_in_rows_and_columns_of_one_width() {
        let (red, blue, green) = ([250, 0, 0], [0, 0, 250], [0, 250, 0]);
        let first = row(vec![plain(200, 100, red), plain(50, 25, blue)]);
        let second = row(vec![Panel::missing("none"), plain(100, 100, green)]);
        let sheet = Sheet { rows: vec![first, second], panel_width: 100, ..Sheet::default() }.draw();
        assert_eq!(extent(&sheet, red), Some([16, 16, 115, 65]));
        assert_eq!(extent(&sheet, blue), Some([124, 16, 223, 65]));
        assert_eq!(extent(&sheet, green), Some([124, 78, 223, 177]));
        assert_eq!(sheet.dimensions(), (240, 194));
    }

    #[test]
    fn names_captions_and_keys_do_not_cover_panels() {
        let red = [250, 0, 0];
        let scale = Some(Scale { low: -4.0, high: 4.0, nearer: Nearer::First });
        let panel = Panel { caption: "a caption of several words".to_string(), ..plain(80, 80, red) };
        let rows = vec![Row { name: "Cup".to_string(), panels: vec![panel], scale }];
        let (title, columns) = ("Title".to_string(), vec!["ours"]);
        let sheet = Sheet { title, columns, rows, footer: "a footer", panel_width: 80 }.draw();
        let [left, top, right, bottom] = extent(&sheet, red).unwrap();
        assert_eq!((right - left, bottom - top), (79, 79));
        assert!(top > 60 && left > 30 && sheet.width() > right + 50 && sheet.height() > bottom + 40);
    }

    #[test]
    fn a_tall_picture_does_not_stretch_its_row() {
        let rows = vec![row(vec![plain(2, 400, [9, 9, 9])])];
        assert_eq!(Sheet { rows, panel_width: 50, ..Sheet::default() }.draw().height(), 80 + 32);
    }

    #[test]
    fn v_has_the_colours_of_its_scale_and_is_grey_where_not_valid() {
        let scale = Scale { low: -1.0, high: 1.0, nearer: Nearer::Second };
        let picture = Panel::relative_blur(3, 1, &[-1.0, f32::NAN, 1.0], &scale).picture.unwrap();
        let pixels: Vec<Color> = picture.pixels().map(|p| p.0).collect();
        assert_eq!(pixels, [PALETTE.color(1.0), LIGHT, PALETTE.color(0.0)]);
    }

    #[test]
    fn lines_break_between_words() {
        let limit = text_width("too few", 12.0) + 0.1;
        assert_eq!(wrap_text("too few key-points", 12.0, limit), ["too few", "key-points"]);
        assert_eq!(wrap_text("registration", 12.0, 1.0), ["registration"]);
        assert!(wrap_text("  ", 12.0, 100.0).is_empty());
    }
}
