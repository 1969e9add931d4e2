//! Reading results from their folder.

use std::borrow::Cow;
use std::path::Path;

use super::{Results, white_of};
use crate::base::{Decode, Depth, Error, Frame, Samples};
use crate::files::export::fused::{FUSED_FILE, FUSED_FLOAT_FILE};
use crate::files::export::report::{Kind, REPORT_FILE, Report, invalid, read_json};
use crate::files::image_io::{self, Photograph};

impl Results<'static> {
    /// Reads the folder of a pair or a focus sweep.
    ///
    /// # Errors
    /// [`Error::File`] if the folder has no results, or if a file is missing, damaged, or of another size than the
    /// report states.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::file(folder, "is no folder; give the one that parfocal solve or stack wrote"));
        }
        let path = folder.join(REPORT_FILE);
        if folder.join("batch.json").is_file() && !path.exists() {
            return Err(Error::file(
                folder,
                "holds the results of a batch; give the folder of one pair or sweep in it",
            ));
        }
        let report = read_json(&path)?;
        let Some(kind @ (Kind::Pair | Kind::Sweep)) = Kind::of(&report) else {
            return Err(invalid(&path, "it is not of a pair or a sweep"));
        };
        let report: Report = serde_json::from_value(report).map_err(|e| invalid(&path, e))?;
        report.check().map_err(|problem| invalid(&path, problem))?;
        let mut results = Self::empty(folder.to_path_buf(), report);
        results.values = results.field(kind.quantity())?.into_owned().into();
        results.uncertainty = results.field("uncertainty")?.into_owned().into();
        if kind == Kind::Sweep {
            let path = folder.join("beyond.png");
            let ([width, height], sides) = read_beyond(&path)?;
            results.check_size(&path, (width, height))?;
            results.beyond = sides.into();
        }
        results.mark();
        results.read_depth().map_err(|e| invalid(&path, e))?;
        Ok(results)
    }

    /// Reads the folder of a pair.
    ///
    /// # Errors
    /// As for [`read`](Self::read); [`Error::File`] if the folder holds a sweep.
    pub fn read_pair(folder: &Path) -> Result<Self, Error> {
        let results = Self::read(folder)?;
        if results.report.kind == Kind::Pair {
            return Ok(results);
        }
        Err(Error::file(folder, "holds a focus sweep; give the folder of a pair, from parfocal solve"))
    }
}

impl Results<'_> {
    /// A field by its name, from memory or from its file.
    ///
    /// # Errors
    /// [`Error::File`] if the file is missing, damaged, or of another size. [`Error::Mismatch`] if results of this kind
    /// have no field of this name in floats.
    pub fn field(&self, name: &str) -> Result<Cow<'_, [f32]>, Error> {
        let in_memory = self.in_memory(name);
        if !in_memory.is_empty() {
            return Ok(in_memory.into());
        }
        let files = self.report.kind.fields().iter();
        let file = files.clone().find(|(field, file, _)| *field == name && file.ends_with(".exr"));
        let Some((_, file, _)) = file else {
            let names: Vec<&str> = files.map(|(name, ..)| *name).collect();
            return Err(Error::Mismatch(format!("there is no field {name}; the fields are {}", names.join(", "))));
        };
        let path = self.folder.join(file);
        let (width, height, values) = image_io::read_field(&path)?;
        self.check_size(&path, (width, height)).map(|()| values.into())
    }

    /// The fused image in the values of the photographs. What the file stretches is undone, so that its ends are clipped.
    ///
    /// # Errors
    /// [`Error::File`] if the file is missing, damaged, or of another size.
    pub fn fused(&self) -> Result<Frame, Error> {
        if let Some(fused) = &self.fused {
            return fused.frame(fused.depth);
        }
        let path = self.folder.join(self.fused_file());
        let photograph = Photograph::open(&path)?;
        let input = photograph.describe();
        let mut image = [photograph.decode()?];
        self.report.values.convert(&[input], &mut image);
        let [image] = image;
        self.check_size(&path, (image.width(), image.height()))?;
        let depth = image.format().depth;
        let Some(tone) = self.report.tone.filter(|_| depth != Depth::F32) else { return Ok(image) };
        let tone = tone.times(1.0 / white_of(depth));
        let stored: Vec<f32> = image.intensities(Decode::None).iter().map(|shown| tone.stored(*shown)).collect();
        Ok(image.with_intensities(&stored))
    }

    /// The fused image in 8 bits.
    ///
    /// # Errors
    /// As for [`fused`](Self::fused); [`Error::Mismatch`] for results that were read from a folder.
    pub(crate) fn fused_in_8_bits(&self) -> Result<&Frame, Error> {
        let absent = || Error::Mismatch("the fused image was not read".to_string());
        self.fused.as_ref().ok_or_else(absent)?.in_8_bits()
    }

    /// Checks that the fields and the fused image in the folder are the files that the solve wrote.
    ///
    /// # Errors
    /// [`Error::File`] for the first file whose size or SHA-256 is not the one that the report states.
    pub fn check_hashes(&self) -> Result<(), Error> {
        let fields = self.report.kind.fields().iter().map(|(_, file, _)| *file);
        for file in fields.chain([self.fused_file()]) {
            let path = self.folder.join(file);
            let Some(hash) = self.report.hashes.get(file) else {
                return Err(Error::file(&path, format!("has no SHA-256 in {REPORT_FILE}; solve again")));
            };
            if !hash.matches(&path) {
                let problem = format!("has changed since the solve: its SHA-256 is not the one in {REPORT_FILE}");
                return Err(Error::file(&path, format!("{problem}; solve again")));
            }
        }
        Ok(())
    }

    /// The file of the fused image.
    fn fused_file(&self) -> &'static str {
        if self.report.has_file(FUSED_FLOAT_FILE) { FUSED_FLOAT_FILE } else { FUSED_FILE }
    }

    fn check_size(&self, path: &Path, (width, height): (u32, u32)) -> Result<(), Error> {
        let (w, h) = self.size();
        if (width, height) == (w, h) {
            return Ok(());
        }
        Err(Error::file(path, format!("is {width}x{height} and {REPORT_FILE} states {w}x{h}; solve again")))
    }
}

/// Reads `beyond.png`. Returns width and height, and the side of each pixel: -1, 0 or 1.
///
/// # Errors
/// [`Error::File`].
fn read_beyond(path: &Path) -> Result<([u32; 2], Vec<i8>), Error> {
    let picture = image_io::read(path)?;
    let Samples::U8(bytes) = picture.samples() else {
        return Err(Error::file(path, "does not have 8 bits per sample; solve the sweep again"));
    };
    let sides = bytes.iter().map(|byte| i8::from(*byte == 2) - i8::from(*byte == 1)).collect();
    Ok(([picture.width(), picture.height()], sides))
}
