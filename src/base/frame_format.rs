//! The format of a photograph: colour channels and the storage of samples.

use std::fmt;

/// The storage of a sample of a [`Frame`](crate::Frame).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Depth {
    /// 8 bits, white at 255.
    U8,
    /// 16 bits, white at 65535.
    U16,
    /// 32-bit float, white at 1.
    F32,
}

/// The colour channels of a [`Frame`](crate::Frame), without alpha.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Channels {
    /// One luminance channel.
    #[default]
    Gray,
    /// Red, green, blue, interleaved.
    Rgb,
}

impl Channels {
    /// Returns the number of channels, 1 or 3.
    pub fn count(self) -> u32 {
        match self {
            Channels::Gray => 1,
            Channels::Rgb => 3,
        }
    }
}

impl Depth {
    /// Returns the bytes per sample.
    pub fn bytes(self) -> u32 {
        match self {
            Depth::U8 => 1,
            Depth::U16 => 2,
            Depth::F32 => 4,
        }
    }
}

/// Channels and sample storage of a frame, for which a solver is prepared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Format {
    /// Colour channels.
    pub channels: Channels,
    /// The storage of a sample.
    pub depth: Depth,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let channels = if self.channels == Channels::Gray { "grey" } else { "colour" };
        let depth = match self.depth {
            Depth::U8 => "8 bits",
            Depth::U16 => "16 bits",
            Depth::F32 => "floats",
        };
        write!(f, "{channels}, {depth}")
    }
}
