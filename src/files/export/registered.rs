//! A photograph that was brought onto the pixels of another, as a file of its own depth.

use std::io::{Seek, Write};

use super::fused::color_type;
use super::meaning::{INTENSITY, PHOTOGRAPH};
use super::picture::{self, Stored};
use super::staging::Staging;
use super::{Destination, FileKind, field};
use crate::base::{Depth, Error, Frame, Samples};

/// The ending of the file that holds a frame of such samples: PNG for integers, EXR for floats.
pub fn registered_ending(depth: Depth) -> &'static str {
    if depth == Depth::F32 { "exr" } else { "png" }
}

/// The kind of that file.
pub fn registered_kind(depth: Depth) -> FileKind {
    if depth == Depth::F32 { FileKind::Exr } else { FileKind::Png }
}

/// Writes a frame into a file of this name in a folder, integers as PNG, floats as EXR; the folder is made if it is missing.
/// What parfocal wrote there alone is replaced, another file only where the [`Destination`] forces it; on failure it stays
/// as it was.
///
/// # Errors
/// [`Error::File`].
pub fn write_registered<'d>(folder: impl Into<Destination<'d>>, name: &str, frame: &Frame) -> Result<(), Error> {
    let mut staging = Staging::of_kind(folder.into(), registered_kind(frame.format().depth))?;
    staging.add(name, |w| write(w, frame))?;
    staging.place()
}

/// Writes frames as [`write_registered`] does, all of them or none; they are of one depth, each with the name of its file, and
/// one is in memory at a time.
///
/// # Errors
/// [`Error::File`]; those of the frames.
pub fn write_all_registered<'d, E: From<Error>>(
    folder: impl Into<Destination<'d>>,
    depth: Depth,
    frames: impl Iterator<Item = Result<(String, Frame), E>>,
) -> Result<(), E> {
    let mut staging = Staging::of_kind(folder.into(), registered_kind(depth))?;
    for frame in frames {
        let (name, frame) = frame?;
        staging.add(&name, |w| write(w, &frame))?;
    }
    Ok(staging.place()?)
}

fn write(writer: impl Write + Seek, frame: &Frame) -> Result<(), String> {
    let size = (frame.width(), frame.height());
    let channels = frame.format().channels;
    let color = color_type(channels);
    match frame.samples() {
        Samples::U8(bytes) => picture::write(writer, size, color, &Stored::Bytes(bytes), &PHOTOGRAPH),
        Samples::U16(words) => picture::write(writer, size, color, &Stored::Words(words), &PHOTOGRAPH),
        Samples::F32(values) => field::write_image(writer, size, channels, values, &INTENSITY),
    }
}
