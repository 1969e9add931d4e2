//! Pictures at another size.

use image::RgbImage;
use image::imageops::{self, FilterType};

/// A picture at another size: averaged where it shrinks, smooth where it grows.
pub(crate) fn resized(picture: &RgbImage, (width, height): (u32, u32)) -> RgbImage {
    if picture.dimensions() == (width, height) {
        return picture.clone();
    }
    imageops::resize(picture, width.max(1), height.max(1), FilterType::Triangle)
}
