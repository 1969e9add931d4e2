//! One page of a TIFF of several, as a file of its own: the header says where the first page begins, and is read as if
//! it said where another one does.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use tiff::decoder::Decoder;
use tiff::tags::Tag;

/// The most pages that are looked for.
const MAX_PAGES: usize = 1 << 16;

/// The file and the page, from 1, of `FILE#N`; the path as it is where it names no page or there is a file of that name.
pub fn split_page(path: &Path) -> (PathBuf, Option<usize>) {
    let whole = || (path.to_path_buf(), None);
    let Some((file, page)) = path.to_str().and_then(|text| text.rsplit_once('#')) else { return whole() };
    match page.parse() {
        Ok(page) if page > 0 && !file.is_empty() && !path.exists() => (file.into(), Some(page)),
        _ => whole(),
    }
}

/// A file, some of whose bytes are read as others.
pub(super) struct Paged {
    file: File,
    at: u64,
    /// Where, and what stands there instead.
    patch: (u64, Vec<u8>),
}

impl Paged {
    /// The file as it is.
    pub(super) fn whole(file: File) -> Self {
        Self { file, at: 0, patch: (0, Vec::new()) }
    }

    /// A TIFF whose first page is the one that begins at `offset`.
    pub(super) fn at_page(file: File, magic: &[u8], offset: u64) -> Self {
        let (little, big_tiff) = (magic[0] == b'I', magic[2..4].contains(&b'+'));
        let patch = match (big_tiff, little) {
            (true, true) => (8, offset.to_le_bytes().to_vec()),
            (true, false) => (8, offset.to_be_bytes().to_vec()),
            // The offsets of a classic TIFF have 32 bits.
            (false, true) => (4, (offset as u32).to_le_bytes().to_vec()),
            (false, false) => (4, (offset as u32).to_be_bytes().to_vec()),
        };
        Self { file, at: 0, patch }
    }
}

impl Read for Paged {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        let (start, bytes) = &self.patch;
        for (at, byte) in (*start..).zip(bytes) {
            if let Some(i) = at.checked_sub(self.at).filter(|i| *i < count as u64) {
                buffer[i as usize] = *byte;
            }
        }
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Paged {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.at = self.file.seek(position)?;
        Ok(self.at)
    }
}

/// Where the pages of a TIFF begin, without the reduced copies that some programs keep beside a picture. Empty where
/// the file is damaged, which whoever decodes it finds again.
pub(super) fn offsets(file: File) -> Vec<u64> {
    let Ok(mut decoder) = Decoder::new(BufReader::new(file)) else { return Vec::new() };
    let mut offsets = Vec::new();
    while offsets.len() < MAX_PAGES {
        let kind = decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType).ok().flatten().unwrap_or(0);
        if kind & 1 == 0 {
            offsets.extend(decoder.ifd_pointer().map(|pointer| pointer.0));
        }
        if !decoder.more_images() || decoder.next_image().is_err() {
            break;
        }
    }
    offsets
}
