//! A photograph whose file is open: hash, description and pixels of the same bytes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest, Sha256};

use super::page::Selected;
use super::source::Source;
use super::{Input, camera_raw, check};
use crate::base::{Channels, Depth, Error, Format, Frame};

/// A photograph whose file has been read, once: what is said of it and its pixels come from the same bytes, whatever
/// becomes of the file meanwhile. It and its clones share these bytes and hold them until they are decoded or dropped.
#[derive(Clone)]
pub struct Photograph {
    /// As given.
    path: PathBuf,
    selected: Selected,
    bytes: Arc<Vec<u8>>,
    size: (u32, u32),
    format: Format,
}

impl Photograph {
    /// Reads a file, or a page of a TIFF as `FILE#N`, or what has no header as `FILE#FORMAT:WxH`, and looks at its header; no pixel is decoded.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        let selected = Selected::of(path).map_err(wrap)?;
        let bytes = check::read(&selected.file).map_err(wrap)?;
        Self::of(path, selected, Arc::new(bytes))
    }

    /// As [`open`](Self::open), after this one: from its bytes, if it is another page of its file, else once it is dropped.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn open_next(self, path: &Path) -> Result<Self, Error> {
        let selected = Selected::of(path).map_err(|problem| Error::file(path, problem))?;
        if selected.file == self.selected.file {
            return Self::of(path, selected, self.bytes);
        }
        drop(self);
        Self::open(path)
    }

    /// Opens two photographs; pages of one file share its bytes.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn open_pair(first: &Path, second: &Path) -> Result<[Self; 2], Error> {
        let i1 = Self::open(first)?;
        let i2 = i1.clone().open_next(second)?;
        Ok([i1, i2])
    }

    fn of(path: &Path, selected: Selected, bytes: Arc<Vec<u8>>) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        if selected.raw.is_none() {
            camera_raw::problem(&selected.file, &bytes).map_or(Ok(()), |problem| Err(wrap(problem)))?;
        }
        let source = guarded(|| Source::open(&bytes, &selected)).map_err(wrap)?;
        let channels = if source.bits_and_channels().1 == 1 { Channels::Gray } else { Channels::Rgb };
        let (size, format) = (source.size(), Format { channels, depth: source.depth() });
        check::size(size).map_err(wrap)?;
        drop(source);
        Ok(Self { path: path.to_path_buf(), selected, bytes, size, format })
    }

    /// As it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Width and height, px, once a rotation that the camera recorded is applied.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// How its samples are stored once it is decoded.
    pub fn depth(&self) -> Depth {
        self.format.depth
    }

    /// What a solver is told of it before it is decoded.
    pub fn format(&self) -> Format {
        self.format
    }

    /// What a report says of it: hash, header and metadata; no pixel is decoded.
    ///
    /// # Errors
    /// [`Error::File`]; none is known where it could be opened.
    pub fn describe(&self) -> Result<Input, Error> {
        let mut source = self.source()?;
        let said = guarded(|| Ok(source.said(&self.bytes)));
        let (encoding, exif) = said.map_err(|problem| Error::file(&self.path, problem))?;
        let (bits, channels) = source.bits_and_channels();
        Ok(Input {
            file: self.path.display().to_string(),
            bytes: self.bytes.len() as u64,
            sha256: Sha256::digest(self.bytes.as_slice()).iter().map(|byte| format!("{byte:02x}")).collect(),
            bits,
            channels,
            alpha: source.has_alpha(),
            format: source.format().to_string(),
            pages: source.pages(),
            page: self.selected.page,
            encoding,
            exif,
        })
    }

    /// Decodes the pixels, as [`read`](super::read) says, and lets go of the bytes.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn decode(self) -> Result<Frame, Error> {
        let source = self.source()?;
        guarded(|| source.decode()).map_err(|problem| Error::file(&self.path, problem))
    }

    /// Decodes two photographs of one size. Where the sizes differ, no pixel is decoded.
    ///
    /// # Errors
    /// [`Error::File`], and [`Error::Mismatch`] with both files and both sizes.
    pub fn decode_pair([i1, i2]: [Self; 2]) -> Result<[Frame; 2], Error> {
        if i1.size != i2.size {
            let ((w1, h1), (w2, h2)) = (i1.size, i2.size);
            return Err(Error::Mismatch(format!(
                "{} is {w1}x{h1} and {} is {w2}x{h2}: both images must have one size; crop or resize one of them",
                i1.path.display(),
                i2.path.display()
            )));
        }
        Ok([i1.decode()?, i2.decode()?])
    }

    /// Decodes an EXR of one channel, whatever its values: width, height, and the values, row-major.
    pub(super) fn decode_field(self) -> Result<(u32, u32, Vec<f32>), Error> {
        let wrap = |problem| Error::file(&self.path, problem);
        let Source::Exr(exr) = self.source()? else {
            return Err(wrap("is no EXR; give the file that parfocal wrote".to_string()));
        };
        let (width, height) = self.size;
        Ok((width, height, guarded(|| exr.decode_field()).map_err(wrap)?))
    }

    fn source(&self) -> Result<Source<'_>, Error> {
        guarded(|| Source::open(&self.bytes, &self.selected)).map_err(|problem| Error::file(&self.path, problem))
    }
}

/// A decoder that goes wrong over a file fails as the file does, and not the program: nothing that it worked on is used again.
fn guarded<T>(of: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(of))
        .unwrap_or_else(|_| Err(format!("cannot be decoded (the decoder fails over it); {}", check::DAMAGED)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;
    use tiff::encoder::{TiffEncoder, colortype};

    use super::*;
    use crate::base::Samples;

    #[test]
    fn pages_of_one_file_are_of_the_bytes_that_were_opened() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("stack.tif");
        let [first, second] = [1, 2].map(|n| PathBuf::from(format!("{}#{n}", path.display())));
        let write = |value: u8| {
            let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
            encoder.write_image::<colortype::Gray8>(2, 1, &[value; 2]).unwrap();
            encoder.write_image::<colortype::Gray8>(2, 1, &[value + 1; 2]).unwrap();
        };
        write(10);
        let opened = Photograph::open(&first).unwrap();
        write(20);
        let next = opened.clone().open_next(&second).unwrap();
        assert_eq!(opened.describe().unwrap().sha256, next.describe().unwrap().sha256);
        assert_eq!(next.decode().unwrap().samples(), &Samples::U8(vec![11; 2]));
        let other = folder.path().join("other.pgm");
        fs::write(&other, b"P5 3 1 255 abc").unwrap();
        assert_eq!(opened.open_next(&other).unwrap().size(), (3, 1));
    }
}
