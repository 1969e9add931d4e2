//! ZIP archives (PKWARE's APPNOTE 6.3.3) of stored files, with less than 4 GiB in total.

use std::io::Write;

/// An archive that is written sequentially.
pub(super) struct Zip<'a> {
    writer: &'a mut dyn Write,
    /// Bytes written.
    at: u64,
    /// Central directory so far.
    directory: Vec<u8>,
    files: u64,
}

/// 1980-01-01, the first date of the format. A fixed date makes archives reproducible.
const DATE: u16 = 1 << 5 | 1;

impl<'a> Zip<'a> {
    pub(super) fn new(writer: &'a mut dyn Write) -> Self {
        Self { writer, at: 0, directory: Vec::new(), files: 0 }
    }

    /// Adds a file.
    pub(super) fn add(&mut self, name: &str, bytes: &[u8]) -> Result<(), String> {
        let (length, start) = (narrow::<u32>(bytes.len() as u64)?, narrow::<u32>(self.at)?);
        let mut entry = Vec::new();
        // Version 2.0, no flags, stored, time, date, checksum, both sizes, name, no extra field.
        for word in [20, 0, 0, 0, DATE] {
            entry.extend(word.to_le_bytes());
        }
        entry.extend([crc32fast::hash(bytes), length, length].iter().flat_map(|n| n.to_le_bytes()));
        entry.extend([narrow::<u16>(name.len() as u64)?, 0].iter().flat_map(|n| n.to_le_bytes()));
        for part in [&b"PK\x03\x04"[..], &entry, name.as_bytes(), bytes] {
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
