//! A photograph file in memory. Hash, description and pixels come from the same bytes.

use std::cell::Cell;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Once, OnceLock};

use image::metadata::Orientation;
use sha2::{Digest, Sha256};

use super::foreign::foreign_problem;
use super::header::{DAMAGED, Header, check_size};
use super::input::Input;
use super::metadata::Metadata;
use super::raster::check_end;
use super::similar_file::similar_file;
use super::source::{Selected, Source};
use super::tiff_page::{PageRun, is_tiff, turned};
use crate::base::{Depth, Error, Format, Frame, workers};
use crate::files::bounded_read;

/// A photograph file in memory. Its description and its pixels come from the same bytes, even if the file changes. The
/// photograph and its clones share these bytes until they are decoded or dropped.
#[derive(Clone)]
pub struct Photograph {
    /// The path as passed.
    path: PathBuf,
    selected: Selected,
    shared: Shared,
    header: Header,
    /// How the pixels are turned, if the format states it.
    orientation: Option<Orientation>,
    /// Whether the file states another orientation than that.
    is_turned_otherwise: bool,
}

/// What pages of one file share.
#[derive(Clone, Default)]
struct Shared {
    bytes: Arc<Vec<u8>>,
    /// The metadata of the page that was opened first.
    metadata: Arc<OnceLock<Metadata>>,
    sha256: Arc<OnceLock<String>>,
}

impl Shared {
    fn sha256(&self) -> String {
        let digest = || Sha256::digest(self.bytes.as_slice()).iter().map(|byte| format!("{byte:02x}")).collect();
        self.sha256.get_or_init(digest).clone()
    }
}

impl Photograph {
    /// Reads a whole file and parses its header, without decoding pixels. `FILE#N` is a page of a TIFF,
    /// `FILE#FORMAT:WxH` a frame without a header.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        let mut selected = Selected::of(path).map_err(wrap)?;
        let bytes = read_bytes(&mut selected).map_err(wrap)?;
        Self::of(path, selected, Shared { bytes: Arc::new(bytes), ..Shared::default() })
    }

    /// Opens the next photograph. Another page of the same file uses the same bytes. For another file, these bytes are
    /// freed first.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn open_next(self, path: &Path) -> Result<Self, Error> {
        let selected = Selected::of(path).map_err(|problem| Error::file(path, problem))?;
        if selected.file == self.selected.file && !self.selected.is_cut {
            return Self::of(path, selected, self.shared);
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

    fn of(path: &Path, selected: Selected, shared: Shared) -> Result<Self, Error> {
        let wrap = |problem| Error::file(path, problem);
        let bytes = &shared.bytes;
        if selected.raw.is_none() {
            foreign_problem(&selected.file, Some(bytes)).map_or(Ok(()), |problem| Err(wrap(problem)))?;
            check_end(bytes).map_err(wrap)?;
        }
        let parse = || {
            let mut source = Source::open(bytes, &selected)?;
            check_size(source.header().size)?;
            shared.metadata.get_or_init(|| source.metadata(bytes));
            Ok((source.header().clone(), source.orientation().copied()))
        };
        let (header, orientation) = guarded(parse).map_err(wrap)?;
        let path = path.to_path_buf();
        Ok(Self { path, selected, shared, header, orientation, is_turned_otherwise: false })
    }

    /// Turns the pixels as those of another photograph of the same camera, if as many are stored.
    fn turned_as(mut self, size: (u32, u32), orientation: Option<Orientation>) -> Self {
        if let (Some(own), Some(other)) = (self.orientation, orientation)
            && own != other
            && turned(self.header.size, own) == turned(size, other)
        {
            (self.header.size, self.orientation, self.is_turned_otherwise) = (size, orientation, true);
        }
        self
    }

    /// The path as passed.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Width and height, px, after the rotation that the camera recorded.
    pub fn size(&self) -> (u32, u32) {
        self.header.size
    }

    /// Sample type after decoding.
    pub fn depth(&self) -> Depth {
        self.header.depth
    }

    /// Channels and sample type after decoding.
    pub fn format(&self) -> Format {
        Format { channels: self.header.channels, depth: self.header.depth }
    }

    /// Number of pages of the file.
    pub(super) fn pages(&self) -> usize {
        self.header.pages
    }

    /// The description of the first page of a TIFF, and its pixels per unit of length.
    pub(super) fn description(&self) -> (Option<String>, Option<f64>) {
        match self.source() {
            Ok(Source::Tiff(page)) => (page.description.clone(), page.resolution),
            _ => (None, None),
        }
    }

    /// Describes the file for the report: hash, header and metadata.
    pub fn describe(&self) -> Input {
        let Header { format, bits, channels, alpha, pages, .. } = self.header;
        let Metadata { encoding, exif, carried } = self.shared.metadata.get().cloned().unwrap_or_default();
        Input {
            file: self.path.display().to_string(),
            bytes: self.shared.bytes.len() as u64,
            sha256: self.shared.sha256(),
            bits,
            channels: channels.count(),
            alpha,
            format: format.to_string(),
            pages,
            page: self.selected.page,
            encoding,
            exif,
            carried: Arc::new(carried),
            is_turned_otherwise: self.is_turned_otherwise,
        }
    }

    /// Decodes the pixels, as described for [`read`](super::read), and frees the bytes.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn decode(self) -> Result<Frame, Error> {
        let source = self.source()?;
        self.check_memory().map_err(|problem| Error::file(&self.path, problem))?;
        guarded(|| source.decode()).map_err(|problem| Error::file(&self.path, problem))
    }

    /// Decodes two photographs of one size. If the sizes differ, no pixel is decoded.
    ///
    /// # Errors
    /// [`Error::File`], and [`Error::Mismatch`] with both files and both sizes.
    pub fn decode_pair([i1, i2]: [Self; 2]) -> Result<[Frame; 2], Error> {
        let ((w1, h1), (w2, h2)) = (i1.header.size, i2.header.size);
        if (w1, h1) != (w2, h2) {
            return Err(Error::Mismatch(format!(
                "{} is {w1}x{h1} and {} is {w2}x{h2}: both images must have one size; crop or resize one of them",
                i1.path.display(),
                i2.path.display()
            )));
        }
        let mut frames = [const { None }; 2];
        workers::for_each([i1, i2].into_iter().zip(&mut frames), |(photograph, frame)| {
            *frame = Some(photograph.decode())
        });
        let [Some(first), Some(second)] = frames else { unreachable!("each photograph is decoded") };
        Ok([first?, second?])
    }

    /// Decodes an EXR of one channel, including NaN and infinity. Returns width, height, and the values, row-major.
    pub(super) fn decode_field(self) -> Result<(u32, u32, Vec<f32>), Error> {
        let wrap = |problem| Error::file(&self.path, problem);
        let Source::Exr(exr) = self.source()? else {
            return Err(wrap("is no EXR; give the file that parfocal wrote".to_string()));
        };
        let (width, height) = self.header.size;
        Ok((width, height, guarded(|| exr.decode_field()).map_err(wrap)?))
    }

    /// Decodes an EXR with these channels, including NaN and infinity, and its comments.
    pub(super) fn decode_channels(self, names: &[&str]) -> Result<NamedChannels, Error> {
        let wrap = |problem| Error::file(&self.path, problem);
        let Source::Exr(exr) = self.source()? else {
            return Err(wrap("is no EXR; give the file that parfocal wrote".to_string()));
        };
        self.check_memory().map_err(wrap)?;
        let comments = exr.comments().unwrap_or_default();
        let fields = guarded(|| exr.planes(names)).map_err(wrap)?;
        let (width, height) = self.header.size;
        Ok(NamedChannels { size: [width, height], comments, fields })
    }

    /// Refuses pixels for which the system refuses memory. The decoders would abort the program.
    fn check_memory(&self) -> Result<(), String> {
        let (width, height) = self.header.size;
        // The decoder's pixels, with alpha, and those of the frame.
        let pixel = 2 * 4 * self.header.depth.bytes();
        let needed = usize::try_from(u64::from(width) * u64::from(height) * u64::from(pixel)).unwrap_or(usize::MAX);
        let mut taken = Vec::<u8>::new();
        let refused = taken.try_reserve_exact(needed);
        // Otherwise memory that nothing uses need not be asked for.
        std::hint::black_box(&taken);
        refused.map_err(|_| format!("is {width}x{height}, for which there is no memory; crop or reduce it"))
    }

    fn source(&self) -> Result<Source<'_>, Error> {
        let open = || {
            let mut source = Source::open(&self.shared.bytes, &self.selected)?;
            source.orientation().zip(self.orientation).into_iter().for_each(|(stated, used)| *stated = used);
            Ok(source)
        };
        guarded(open).map_err(|problem| Error::file(&self.path, problem))
    }
}

/// Channels of an EXR, of one size.
pub(crate) struct NamedChannels {
    /// Width and height, px.
    pub(crate) size: [u32; 2],
    /// The comments of the file.
    pub(crate) comments: String,
    /// The channels, row-major.
    pub(crate) fields: Vec<Vec<f32>>,
}

/// Greatest number of bytes of a file that are read, 4 GiB: the limit of classic TIFF, and the size of the largest
/// picture with four floats per pixel.
const MAX_BYTES: u64 = 1 << 32;

/// Length of a file, 64 MiB, above which its header must state a picture of this length. Metadata may take as much.
const UNCHECKED_BYTES: u64 = 1 << 26;

/// Greatest number of bytes that a file without pages has for each pixel: 16-bit RGB as text, with white space.
const MOST_BYTES_PER_PIXEL: u64 = 32;

/// Reads the whole of a regular file that is not empty, if its length fits its header.
fn read_bytes(selected: &mut Selected) -> Result<Vec<u8>, String> {
    let path = selected.file.as_path();
    let file = bounded_read::open(path).map_err(|e| match e.kind() {
        ErrorKind::NotFound => missing(path),
        ErrorKind::PermissionDenied => "may not be read; check its permissions".to_string(),
        ErrorKind::InvalidInput if path.is_dir() => "is a folder; give the image file in it".to_string(),
        ErrorKind::InvalidInput => "is not a regular file; copy the image to a file on disk".to_string(),
        _ => format!("cannot be opened ({e})"),
    })?;
    let unreadable = |e: std::io::Error| match e.kind() {
        ErrorKind::FileTooLarge => format!("is too long ({e}); save its pages as files"),
        ErrorKind::OutOfMemory => format!("is too long ({e}); reduce it"),
        _ => format!("cannot be read ({e})"),
    };
    if let Some(page) = read_page(&file, selected).map_err(unreadable)? {
        selected.is_cut = true;
        return Ok(page);
    }
    check_length(&file, selected, unreadable)?;
    let bytes = bounded_read::read_open(&file, MAX_BYTES).map_err(unreadable)?;
    if bytes.is_empty() {
        return Err("is empty; copy or save it again".to_string());
    }
    Ok(bytes)
}

/// Why there is no file of this name.
fn missing(path: &Path) -> String {
    let text = path.to_string_lossy();
    if let Some(problem) = bounded_read::not_a_path(path) {
        return problem.to_string();
    }
    if let Ok(target) = path.read_link() {
        return format!("is a link to '{}', which does not exist; restore it, or remove the link", target.display());
    }
    if text.contains(['*', '?']) {
        return "is a pattern that no file matches, or that is quoted; check it, and leave out the quotes".to_string();
    }
    let what = if path.extension().is_some() { "file" } else { "file or folder" };
    match similar_file(path) {
        Some(other) => format!("there is no such {what}; did you mean '{}'?", other.display()),
        None => format!("there is no such {what}; check the path"),
    }
}

/// Reads a page, and what is before the first one, of a file that is too long and has one directory for all pages.
fn read_page(file: &File, selected: &Selected) -> std::io::Result<Option<Vec<u8>>> {
    if file.metadata()?.len() <= MAX_BYTES || selected.raw.is_some() {
        return Ok(None);
    }
    let mut start = bounded_read::read_start(file, UNCHECKED_BYTES)?;
    let run = if is_tiff(&start) { guarded(|| Ok(PageRun::of_start(&start))).ok().flatten() } else { None };
    let page = selected.page.unwrap_or(1) as u64 - 1;
    let is_near = |run: &PageRun| run.position <= start.len() as u64 && run.size <= MAX_BYTES;
    let Some(run) = run.filter(|run| page < run.count as u64 && is_near(run)) else { return Ok(None) };
    start.truncate(run.position as usize);
    start.extend(bounded_read::read_from(file, run.page(page), run.size)?);
    Ok(Some(start))
}

/// Refuses a file that is longer than the picture of its header, before it is read. A TIFF may have its header at its
/// end, and is limited by [`MAX_BYTES`] alone.
fn check_length(file: &File, selected: &Selected, unreadable: impl Fn(std::io::Error) -> String) -> Result<(), String> {
    let length = file.metadata().map_err(&unreadable)?.len();
    if let Some(raw) = selected.raw {
        return raw.check_length(length);
    }
    if length <= UNCHECKED_BYTES || length > MAX_BYTES {
        return Ok(());
    }
    let start = bounded_read::read_start(file, UNCHECKED_BYTES).map_err(unreadable)?;
    if is_tiff(&start) {
        return Ok(());
    }
    let (header, of_layers) = guarded(|| Source::open(&start, selected).map(|source| source.header_and_length()))?;
    let (width, height) = header.size;
    let of_pixels = (u64::from(width) * u64::from(height)).saturating_mul(MOST_BYTES_PER_PIXEL);
    let most = of_layers.unwrap_or(of_pixels).saturating_add(UNCHECKED_BYTES);
    if length > most {
        let format = header.format;
        return Err(format!(
            "is of {length} bytes, and {width}x{height} pixels in {format} have at most {most}; copy or save it again"
        ));
    }
    Ok(())
}

thread_local! {
    /// Whether a decoder runs on this thread.
    static IS_GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Converts a panic of a decoder into an error of the file. The panic is not printed, and the data of the decoder is not
/// used again.
fn guarded<T>(of: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    static SILENT: Once = Once::new();
    SILENT.call_once(|| {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !IS_GUARDED.get() {
                hook(panic);
            }
        }));
    });
    let before = IS_GUARDED.replace(true);
    let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(of));
    IS_GUARDED.set(before);
    ended.unwrap_or_else(|_| Err(format!("cannot be decoded (the decoder fails over it); {DAMAGED}")))
}

/// Decodes frames in parallel and describes their files. The first one is already open. In addition to the frames,
/// memory holds as many files as there are processors. Pages of one file share its bytes.
///
/// All are turned as the first file states ([`Input::is_turned_otherwise`]): a camera that looks down does not know which
/// way is up, and its statement may change from frame to frame.
///
/// # Errors
/// [`Error::File`] of the first file that fails.
pub fn read_frames(first: Photograph, others: &[PathBuf]) -> Result<Vec<(Frame, Input)>, Error> {
    let mut read: Vec<Option<Result<_, Error>>> = (0..=others.len()).map(|_| None).collect();
    let mut last = Some(first.clone());
    let (size, orientation) = (first.header.size, first.orientation);
    let opened = others.iter().map(|path| {
        let photograph = last.take().map_or_else(|| Photograph::open(path), |last| last.open_next(path));
        last = photograph.as_ref().ok().cloned();
        photograph.map(|photograph| photograph.turned_as(size, orientation))
    });
    workers::for_each([Ok(first)].into_iter().chain(opened).zip(&mut read), |(photograph, read)| {
        *read = Some(photograph.and_then(|photograph| {
            let input = photograph.describe();
            Ok((photograph.decode()?, input))
        }));
    });
    read.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;
    use tiff::encoder::{TiffEncoder, colortype};

    use super::*;
    use crate::base::Samples;

    #[test]
    fn a_file_longer_than_its_header_allows_is_refused_before_it_is_read() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("long");
        // Files of these lengths take almost no space on the disk.
        let problem = |start: &[u8], length: u64, after: &str| {
            fs::write(&path, start).unwrap();
            fs::File::options().write(true).open(&path).unwrap().set_len(length).unwrap();
            let named = PathBuf::from(format!("{}{after}", path.display()));
            Photograph::open(&named).err().map(|e| e.to_string()).unwrap_or_default()
        };
        let mut png = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        image::ImageEncoder::write_image(encoder, &[7; 4], 2, 2, image::ExtendedColorType::L8).unwrap();
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&[7; 4], 2, 2, image::ExtendedColorType::L8).unwrap();
        let exr = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hostile/b44_overflow.exr")).unwrap();
        let long = UNCHECKED_BYTES + (1 << 20);
        for (format, start) in [
            ("PNG", png.as_slice()),
            ("JPEG", &jpeg),
            ("PNM", b"P5 2 2 255 abcd"),
            ("PFM", b"Pf 2 2 -1 abcdefghijklmnop"),
            ("EXR", &exr),
        ] {
            let problem = problem(start, long, "");
            let [begins, ends] = [format!("is of {long} bytes, and "), format!(" pixels in {format} have at most")];
            assert!(problem.contains(&begins) && problem.contains(&ends), "{format}: {problem}");
        }
        assert!(problem(&[], long, "").contains("no image format"));
        assert!(problem(b"P5 2 2 255 abcd", UNCHECKED_BYTES, "").is_empty(), "what follows a short picture is ignored");
        for start in [&b""[..], b"II*\0", b"P5 2 2 255 abcd"] {
            assert!(
                problem(start, 1 << 40, "").contains("is too long (1099511627776 bytes, and the most is 4294967296)")
            );
        }
        assert!(problem(&[], 1 << 40, "#Mono8:16x16").contains("is of 1099511627776 bytes, and Mono8:16x16 takes 256"));
    }

    #[test]
    fn pages_of_one_file_share_the_bytes_that_were_read() {
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
        assert_eq!(opened.describe().sha256, next.describe().sha256);
        assert_eq!(next.decode().unwrap().samples(), &Samples::U8(vec![11; 2]));
        let other = folder.path().join("other.pgm");
        fs::write(&other, b"P5 3 1 255 abc").unwrap();
        assert_eq!(opened.open_next(&other).unwrap().size(), (3, 1));
    }
}
