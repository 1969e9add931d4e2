//! How stored values become intensities: as is asked, as the files say, or by what their kind implies.

use serde::{Deserialize, Serialize};

use super::{Input, encoding};
use crate::base::{Decode, Depth, Error};

/// How the values of photographs became intensities, and on whose word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Values {
    /// What was done to them.
    pub decode: Decode,
    /// On whose word.
    pub by: Basis,
}

/// Who says how values became intensities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// It was asked for.
    Stated,
    /// All the files.
    Files,
    /// Nobody, of one file at least: it was assumed by the bits of a sample.
    Assumed,
}

impl Values {
    /// As was asked for, whatever the files say.
    pub fn stated(decode: Decode) -> Self {
        Self { decode, by: Basis::Stated }
    }

    /// Resolves [`Decode::Auto`] by what the files of one scene state, and without a statement by their bits
    /// ([`Decode::resolved`]).
    ///
    /// A file without a statement is read as the others state. A file that names a curve or colour space other than linear
    /// (Adobe RGB, gamma 1.8) is decoded by the sRGB curve, the nearer of the two.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if two files contradict each other.
    pub fn of(decode: Decode, files: &[Input]) -> Result<Self, Error> {
        if decode != Decode::Auto {
            return Ok(Self::stated(decode));
        }
        let said: Vec<(&Input, Decode)> = files.iter().filter_map(|file| Some((file, said(file)?))).collect();
        let by = if said.len() == files.len() { Basis::Files } else { Basis::Assumed };
        let Some(&(first, decode)) = said.first() else {
            let depths = files.iter().map(|file| if file.bits <= 8 { Depth::U8 } else { Depth::U16 });
            return Ok(Self { decode: decode.resolved(depths), by });
        };
        match said.iter().find(|(_, other)| *other != decode) {
            None => Ok(Self { decode, by }),
            Some((other, _)) => Err(Error::Mismatch(format!(
                "{} says that its values are {}, and {} that its are {}: save both in one way, or give --decode none or srgb",
                first.file,
                first.encoding.as_deref().unwrap_or_default(),
                other.file,
                other.encoding.as_deref().unwrap_or_default()
            ))),
        }
    }
}

/// What to do by what a file says, if it says anything.
fn said(file: &Input) -> Option<Decode> {
    match file.encoding.as_deref()? {
        encoding::UNREADABLE => None,
        encoding::LINEAR => Some(Decode::None),
        _ => Some(Decode::Srgb),
    }
}

/// What two photographs say of their values that does not go together, or not with what was done to them.
pub(super) fn warning([i1, i2]: [&Input; 2], decode: Decode) -> Option<String> {
    let [first, second] = [i1, i2].map(|input| input.encoding.as_deref());
    if let (Some(a), Some(b)) = (first, second)
        && a != b
    {
        let (f1, f2) = (&i1.file, &i2.file);
        return Some(format!("{f1} says that its values are {a}, and {f2} that its are {b}: save both in one way"));
    }
    let linear = [i1, i2].into_iter().find(|input| input.encoding.as_deref() == Some(encoding::LINEAR))?;
    (decode == Decode::Srgb)
        .then(|| format!("{} says that its values are linear, and --decode srgb bends them: leave it out", linear.file))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(file: &str, bits: u32, encoding: Option<&str>) -> Input {
        let encoding = encoding.map(String::from);
        let (sha256, format) = (String::new(), "PNG".to_string());
        Input {
            file: file.into(),
            bytes: 1,
            sha256,
            bits,
            channels: 1,
            alpha: false,
            format,
            pages: 1,
            page: None,
            encoding,
            exif: None,
        }
    }

    #[test]
    fn values_are_what_the_files_say_or_else_what_their_bits_imply() {
        let of = |files: &[Input]| {
            Values::of(Decode::Auto, files).map(|Values { decode, by }| (decode, by)).map_err(|e| e.to_string())
        };
        let (plain, deep) = (input("a", 8, None), input("d", 16, None));
        assert_eq!(of(std::slice::from_ref(&plain)), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(std::slice::from_ref(&deep)), Ok((Decode::None, Basis::Assumed)));
        assert_eq!(of(&[deep.clone(), plain.clone()]), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(&[deep, input("b", 8, Some("sRGB"))]), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(&[plain, input("e", 32, Some("linear"))]), Ok((Decode::None, Basis::Assumed)));
        for curve in ["sRGB", "Adobe RGB (1998)", "gamma 1.80"] {
            assert_eq!(of(&[input("s", 16, Some(curve))]), Ok((Decode::Srgb, Basis::Files)));
        }
        assert_eq!(of(&[input("u", 16, Some(encoding::UNREADABLE))]), Ok((Decode::None, Basis::Assumed)));
        let problem = of(&[input("s", 8, Some("sRGB")), input("l", 8, Some("linear"))]).unwrap_err();
        assert!(problem.starts_with("s says that its values are sRGB, and l that its are linear: "), "{problem}");
        assert!(problem.contains("--decode"), "{problem}");
    }
}
