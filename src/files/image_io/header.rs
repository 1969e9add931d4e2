//! What all formats share: the header, its limits, and advice in messages.

use crate::base::{Channels, Depth};

/// Greatest number of pixels that are decoded, 2^28. Common camera sensors have at most 150 million. A float channel of
/// this size takes 1 GiB.
pub const MAX_PIXELS: u64 = 1 << 28;

/// The header of a photograph.
#[derive(Clone, Debug)]
pub(super) struct Header {
    /// The format's name.
    pub(super) format: &'static str,
    /// Width and height after the rotation that the camera recorded, px.
    pub(super) size: (u32, u32),
    /// Sample type after decoding.
    pub(super) depth: Depth,
    /// Bits of a stored sample.
    pub(super) bits: u32,
    /// Colour channels, without alpha.
    pub(super) channels: Channels,
    /// Whether the file has an alpha channel.
    pub(super) alpha: bool,
    /// Pages of the file.
    pub(super) pages: usize,
}

/// Advice for a damaged file.
pub(super) const DAMAGED: &str = "the file is damaged or incomplete; copy or save it again";

/// Advice for an unsupported format.
pub(super) const CONVERT: &str = "convert it to PNG, TIFF, JPEG, BMP, WebP, PNM, PFM or EXR; of a frame without a header state format and size (--raw)";

/// Refuses images without pixels and images larger than [`MAX_PIXELS`].
pub(super) fn check_size((width, height): (u32, u32)) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 {
        return Err(format!("is {width}x{height} and holds no pixels"));
    }
    if pixels > MAX_PIXELS {
        return Err(format!(
            "is {width}x{height}, {pixels} pixels, and the most that is read is {MAX_PIXELS}; crop or reduce it"
        ));
    }
    Ok(())
}
