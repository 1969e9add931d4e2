//! ZIP archives, written sequentially.

use std::io::Write;

use flate2::Compression;
use flate2::write::DeflateEncoder;

/// A ZIP archive (PKWARE's APPNOTE 6.3.3) of files, with less than 4 GiB in total. It is written sequentially.
pub(super) struct Zip<'a> {
    writer: &'a mut dyn Write,
    /// Bytes written.
    at: u64,
    /// Central directory so far.
    directory: Vec<u8>,
    files: u64,
}

/// The methods of compression.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// 1980-01-01, the first date of the format. A fixed date makes archives reproducible.
const DATE: u16 = 1 << 5 | 1;

impl<'a> Zip<'a> {
    pub(super) fn new(writer: &'a mut dyn Write) -> Self {
        Self { writer, at: 0, directory: Vec::new(), files: 0 }
    }

    /// Adds a file as it is.
    pub(super) fn add(&mut self, name: &str, bytes: &[u8]) -> Result<(), String> {
        self.entry(name, bytes, bytes, STORED)
    }

    /// Adds a file, compressed.
    pub(super) fn add_deflated(&mut self, name: &str, bytes: &[u8]) -> Result<(), String> {
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
        let packed = encoder.write_all(bytes).and_then(|()| encoder.finish()).map_err(|e| e.to_string())?;
        self.entry(name, bytes, &packed, DEFLATED)
    }

    fn entry(&mut self, name: &str, bytes: &[u8], packed: &[u8], method: u16) -> Result<(), String> {
        let [length, stored] = [narrow::<u32>(bytes.len() as u64)?, narrow::<u32>(packed.len() as u64)?];
        let start = narrow::<u32>(self.at)?;
        let mut entry = Vec::new();
        // Version 2.0, no flags, method, time, date, checksum, both sizes, name, no extra field.
        for word in [20, 0, method, 0, DATE] {
            entry.extend(word.to_le_bytes());
        }
        entry.extend([crc32fast::hash(bytes), stored, length].iter().flat_map(|n| n.to_le_bytes()));
        entry.extend([narrow::<u16>(name.len() as u64)?, 0].iter().flat_map(|n| n.to_le_bytes()));
        for part in [&b"PK\x03\x04"[..], &entry, name.as_bytes(), packed] {
            self.out(part)?;
        }
        self.directory.extend(b"PK\x01\x02");
        self.directory.extend(20u16.to_le_bytes());
        self.directory.extend(&entry);
        // Comment, disk, internal and external attributes.
        self.directory.extend([0; 10]);
        self.directory.extend(start.to_le_bytes());
        self.directory.extend(name.as_bytes());
        self.files += 1;
        Ok(())
    }

    /// Writes the end of the archive.
    pub(super) fn finish(mut self) -> Result<(), String> {
        let (start, length) = (narrow::<u32>(self.at)?, narrow::<u32>(self.directory.len() as u64)?);
        let files = narrow::<u16>(self.files)?;
        let directory = std::mem::take(&mut self.directory);
        self.out(&directory)?;
        let mut end = b"PK\x05\x06\0\0\0\0".to_vec();
        end.extend([files, files].iter().flat_map(|n| n.to_le_bytes()));
        end.extend([length, start].iter().flat_map(|n| n.to_le_bytes()));
        end.extend([0, 0]);
        self.out(&end)
    }

    fn out(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.at += bytes.len() as u64;
        self.writer.write_all(bytes).map_err(|e| e.to_string())
    }
}

fn narrow<T: TryFrom<u64>>(number: u64) -> Result<T, String> {
    T::try_from(number)
        .map_err(|_| "there is more than an archive of this kind holds; export a part (--roi)".to_string())
}
