//! One picture of a sheet, or the reason why there is none.

use image::{RgbImage, imageops};

use super::PALETTE;
use crate::base::{Frame, Region};
use crate::files::export::Scale;
use crate::files::preview::{byte, photograph};
use crate::page::figure::{Color, LIGHT};

/// One place of a [`Sheet`](super::Sheet): a picture or a reason, and a caption.
#[derive(Clone, Debug)]
pub struct Panel {
    pub(super) content: Content,
    pub(super) caption: String,
    pub(super) marks: Vec<(Region, Color)>,
}

#[derive(Clone, Debug)]
pub(super) enum Content {
    Picture(RgbImage),
    Missing(String),
}

impl Panel {
    /// A dash and a reason, such as "too few key-points".
    pub fn missing(reason: impl Into<String>) -> Self {
        Self { content: Content::Missing(reason.into()), caption: String::new(), marks: Vec::new() }
    }

    /// A picture as it is.
    pub fn image(picture: RgbImage) -> Self {
        if picture.is_empty() {
            return Self::missing("no pixels");
        }
        Self { content: Content::Picture(picture), caption: String::new(), marks: Vec::new() }
    }

    /// A photograph, grey or colour, as stored.
    pub fn photograph(frame: &Frame) -> Self {
        Self::image(photograph(frame))
    }

    /// Grey values, 0 black and 1 white, `height` rows of `width`; light grey where NaN.
    pub fn gray(width: u32, height: u32, values: &[f32]) -> Self {
        Self::field(width, height, values, |v| [byte(v); 3])
    }

    /// V, px², `height` rows of `width`, in the colours of a scale, which panels that are to be compared share; grey
    /// where not valid.
    pub fn relative_blur(width: u32, height: u32, values: &[f32], scale: &Scale) -> Self {
        Self::field(width, height, values, |v| PALETTE.color(scale.nearness(v)))
    }

    fn field(width: u32, height: u32, values: &[f32], color: impl Fn(f32) -> Color) -> Self {
        let bytes = values.iter().flat_map(|&v| if v.is_finite() { color(v) } else { LIGHT }).collect();
        match RgbImage::from_raw(width, height, bytes) {
            Some(picture) if values.len() == width as usize * height as usize => Self::image(picture),
            _ => Self::missing(format!("{} values for {width}x{height} pixels", values.len())),
        }
    }

    /// Text below the panel.
    pub fn caption(mut self, text: impl Into<String>) -> Self {
        self.caption = text.into();
        self
    }

    /// A close-up: only this part, as large as the panel. What lies outside the picture is cut off; marks are dropped.
    pub fn crop(mut self, region: Region) -> Self {
        if let Content::Picture(picture) = &self.content {
            // Clamps the region to the picture.
            let part = imageops::crop_imm(picture, region.x, region.y, region.width, region.height).to_image();
            let caption = std::mem::take(&mut self.caption);
            self = if part.is_empty() { Self::missing("outside the picture") } else { Self::image(part) };
            self.caption = caption;
        }
        self
    }

    /// Outlines a part in a colour, to show where a close-up is from.
    pub fn mark(mut self, region: Region, color: [u8; 3]) -> Self {
        self.marks.push((region, color));
        self
    }

    /// Height over width; `None` if there is no picture.
    pub(super) fn aspect(&self) -> Option<f32> {
        match &self.content {
            Content::Picture(picture) => Some(picture.height() as f32 / picture.width() as f32),
            Content::Missing(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::export::Nearer;

    fn picture(panel: &Panel) -> &RgbImage {
        match &panel.content {
            Content::Picture(picture) => picture,
            Content::Missing(why) => panic!("{why}"),
        }
    }

    fn reason(panel: &Panel) -> &str {
        match &panel.content {
            Content::Missing(why) => why,
            Content::Picture(_) => panic!("a picture"),
        }
    }

    #[test]
    fn v_has_the_colours_of_its_scale_and_grey_where_not_valid() {
        let scale = Scale { low: -1.0, high: 1.0, nearer: Nearer::Second };
        let panel = Panel::relative_blur(3, 1, &[-1.0, f32::NAN, 1.0], &scale);
        let pixels: Vec<Color> = picture(&panel).pixels().map(|p| p.0).collect();
        assert_eq!(pixels, [PALETTE.color(1.0), LIGHT, PALETTE.color(0.0)]);
    }

    #[test]
    fn a_close_up_is_the_part_that_there_is() {
        let ramp: Vec<f32> = (0..12).map(|i| i as f32 / 255.0).collect();
        let close = Panel::gray(4, 3, &ramp).caption("c").crop(Region { x: 2, y: 1, width: 9, height: 1 });
        assert_eq!(picture(&close).pixels().map(|p| p[0]).collect::<Vec<_>>(), [6, 7]);
        assert_eq!(close.caption, "c");
        let outside = Panel::gray(4, 3, &ramp).crop(Region { x: 4, y: 0, width: 1, height: 1 });
        assert_eq!(reason(&outside), "outside the picture");
    }

    #[test]
    fn what_cannot_be_a_picture_says_why() {
        assert_eq!(reason(&Panel::gray(2, 2, &[0.0])), "1 values for 2x2 pixels");
        assert_eq!(reason(&Panel::gray(2, 2, &[0.0; 5])), "5 values for 2x2 pixels");
        assert_eq!(reason(&Panel::gray(0, 0, &[])), "no pixels");
        assert_eq!(reason(&Panel::gray(u32::MAX, u32::MAX, &[])), "0 values for 4294967295x4294967295 pixels");
    }
}
