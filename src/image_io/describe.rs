//! What a report says of the photographs: which files, told apart by their contents, and what they hold.

use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::Pending;
use crate::{Decode, Error};

/// The file of a photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// The name as given.
    pub file: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// SHA-256 of the file, as `sha256sum` prints it.
    pub sha256: String,
    /// Bits of a stored sample.
    pub bits: u32,
    /// 1 for grey, 3 for colour; alpha is not counted.
    pub channels: u32,
}

/// Describes a photograph without decoding its pixels.
///
/// # Errors
/// [`Error::File`].
pub fn describe(path: &Path) -> Result<Input, Error> {
    let pending = Pending::open(path)?;
    let (bits, channels) = pending.bits_and_channels();
    let mut hasher = Hasher(Sha256::new());
    let bytes = File::open(path)
        .and_then(|mut file| io::copy(&mut file, &mut hasher))
        .map_err(|e| Error::file(path, format!("cannot be read ({e})")))?;
    let sha256 = hasher.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Input { file: path.display().to_string(), bytes, sha256, bits, channels })
}

/// What two photographs of a pair give to warn of; a sentence each.
pub fn pair_warnings(inputs: &[Input], _decode: Decode) -> Vec<String> {
    let [i1, i2] = inputs else { return Vec::new() };
    let mut warnings = Vec::new();
    if i1.sha256 == i2.sha256 {
        warnings.push(format!(
            "{} and {} hold the same picture, so that V is 0 everywhere: give two photographs, focused at two distances",
            i1.file, i2.file
        ));
    }
    if i1.channels != i2.channels {
        let (gray, color) = if i1.channels < i2.channels { (i1, i2) } else { (i2, i1) };
        warnings.push(format!(
            "{} is grey and {} is coloured, so that a colour that reads otherwise in grey looks like a change of \
             exposure: take both in one way",
            gray.file, color.file
        ));
    }
    warnings
}

/// A digest as something that bytes are written to.
struct Hasher(Sha256);

impl io::Write for Hasher {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
