//! Directories of TIFF that the crate `tiff` does not read as they are, written again in front of the file.
//!
//! A palette is read as grey, a plane as a picture of its own, and a page that has no directory by that of the first.

use std::io::{Read, Result, Seek, SeekFrom};

use tiff::TiffError;
use tiff::decoder::Decoder;
use tiff::tags::Tag;

/// A file behind bytes of our own.
pub(super) struct Joined<'a> {
    head: Vec<u8>,
    bytes: &'a [u8],
    at: u64,
}

impl<'a> Joined<'a> {
    /// The file alone.
    pub(super) fn file(bytes: &'a [u8]) -> Self {
        Self { head: Vec::new(), bytes, at: 0 }
    }

    /// The number of bytes of the file.
    pub(super) fn file_length(&self) -> usize {
        self.bytes.len()
    }

    fn length(&self) -> u64 {
        (self.head.len() + self.bytes.len()) as u64
    }
}

impl Read for Joined<'_> {
    fn read(&mut self, to: &mut [u8]) -> Result<usize> {
        let at = usize::try_from(self.at.min(self.length())).unwrap_or(usize::MAX);
        let rest = self.head.get(at..).filter(|rest| !rest.is_empty());
        let count = rest.unwrap_or_else(|| &self.bytes[at - self.head.len()..]).read(to)?;
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Joined<'_> {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(off) => self.at.checked_add_signed(off),
            SeekFrom::End(off) => self.length().checked_add_signed(off),
        };
        self.at = at.ok_or(std::io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// The tags that tell how the pixels of a page are stored.
const STORED: [Tag; 14] = [
    Tag::ImageWidth,
    Tag::ImageLength,
    Tag::BitsPerSample,
    Tag::Compression,
    Tag::PhotometricInterpretation,
    Tag::StripOffsets,
    Tag::SamplesPerPixel,
    Tag::RowsPerStrip,
    Tag::StripByteCounts,
    Tag::Predictor,
    Tag::TileWidth,
    Tag::TileLength,
    Tag::TileOffsets,
    Tag::TileByteCounts,
];

/// The values of a tag; `None` if it is absent or no list of unsigned integers.
pub(super) fn values(decoder: &mut Decoder<Joined<'_>>, tag: Tag) -> Option<Vec<u64>> {
    decoder.find_tag(tag).ok().flatten()?.into_u64_vec().ok()
}

/// A decoder of the current page with other values of these tags. `limits` as of the first decoder.
pub(super) fn redirected<'a>(
    decoder: &mut Decoder<Joined<'a>>,
    changed: &[(Tag, Vec<u64>)],
    limits: tiff::decoder::Limits,
) -> std::result::Result<Decoder<Joined<'a>>, TiffError> {
    let mut entries: Vec<(Tag, Vec<u64>)> = Vec::new();
    // Behind the others, since the number of a tag orders them.
    for tag in STORED.into_iter().chain([Tag::SampleFormat, Tag::JPEGTables]) {
        let other = changed.iter().find(|(other, _)| *other == tag).map(|(_, values)| values.clone());
        entries.extend(other.or_else(|| values(decoder, tag)).map(|values| (tag, values)));
    }
    entries.sort_by_key(|(tag, _)| tag.to_u16());
    let bytes = decoder.inner().bytes;
    let head = directory(bytes[0] == b'I', &entries);
    Ok(Decoder::new(Joined { head, bytes, at: 0 })?.with_limits(limits))
}

/// The header of a BigTIFF and its directory. Positions are moved behind it.
fn directory(is_little: bool, entries: &[(Tag, Vec<u64>)]) -> Vec<u8> {
    let number = |value: u64, size: usize| {
        let bytes = value.to_le_bytes().into_iter().take(size);
        if is_little { bytes.collect::<Vec<u8>>() } else { bytes.rev().collect() }
    };
    // Bytes of a value: all are positions or long if one is.
    let size = |(tag, values): &(Tag, Vec<u64>)| match tag {
        Tag::JPEGTables => 1,
        Tag::StripOffsets | Tag::TileOffsets => 8,
        _ if values.iter().any(|value| *value > u16::MAX.into()) => 8,
        _ => 2,
    };
    // A value of up to 8 bytes is in its entry, a longer one behind the directory.
    let outside = |entry| {
        let bytes = size(entry) * entry.1.len();
        if bytes > 8 { bytes.next_multiple_of(8) } else { 0 }
    };
    let values_at = 16 + 8 + 20 * entries.len() + 8;
    let length = values_at + entries.iter().map(outside).sum::<usize>();
    let mark: &[u8] = if is_little { b"II" } else { b"MM" };
    let mut head = [mark, &number(43, 2), &number(8, 2), &number(0, 2), &number(16, 8)].concat();
    head.extend(number(entries.len() as u64, 8));
    let mut behind = Vec::new();
    for entry in entries {
        let ((tag, values), size) = (entry, size(entry));
        let kind = match size {
            1 => 7,
            2 => 3,
            _ => 16,
        };
        let moved = if matches!(tag, Tag::StripOffsets | Tag::TileOffsets) { length as u64 } else { 0 };
        let mut bytes: Vec<u8> = values.iter().flat_map(|value| number(value.saturating_add(moved), size)).collect();
        head.extend([number(tag.to_u16().into(), 2), number(kind, 2), number(values.len() as u64, 8)].concat());
        bytes.resize(bytes.len().next_multiple_of(8).max(8), 0);
        if outside(entry) == 0 {
            head.extend(&bytes);
        } else {
            head.extend(number((values_at + behind.len()) as u64, 8));
            behind.extend(&bytes);
        }
    }
    head.extend(number(0, 8));
    head.extend(&behind);
    head
}
