//! What stands behind the name of a file: a page, or the format of what has no header.

use std::path::{Path, PathBuf};

use super::RawFormat;

/// A file, and what of it is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Selected {
    pub(super) file: PathBuf,
    /// Of a TIFF, from 1.
    pub(super) page: Option<usize>,
    pub(super) raw: Option<RawFormat>,
}

impl Selected {
    /// Of `FILE`, `FILE#N` or `FILE#FORMAT:WxH`; the path as it is where it names neither or there is a file of that name.
    ///
    /// # Errors
    /// A phrase, where what follows the # begins as a format and is none.
    pub(super) fn of(path: &Path) -> Result<Self, String> {
        let whole = Self { file: path.to_path_buf(), page: None, raw: None };
        let Some((file, after)) = path.to_str().and_then(|text| text.rsplit_once('#')) else { return Ok(whole) };
        if file.is_empty() || path.exists() {
            return Ok(whole);
        }
        let file = PathBuf::from(file);
        match (after.parse(), after.parse::<RawFormat>()) {
            (Ok(page), _) if page > 0 => Ok(Self { file, page: Some(page), raw: None }),
            (_, Ok(raw)) => Ok(Self { file, page: None, raw: Some(raw) }),
            (_, Err(problem)) if after.to_lowercase().starts_with("mono") => Err(format!("#{after}: {problem}")),
            _ => Ok(whole),
        }
    }
}

/// The file and the page, from 1, of `FILE#N`; the file of `FILE#FORMAT:WxH`; the path as it is where it names neither or there is a
/// file of that name.
pub fn split_page(path: &Path) -> (PathBuf, Option<usize>) {
    Selected::of(path).map_or_else(|_| (path.to_path_buf(), None), |selected| (selected.file, selected.page))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_may_end_with_a_page_or_a_format() {
        let of = |text: &str| Selected::of(Path::new(text)).map(|s| (s.file.display().to_string(), s.page, s.raw));
        assert_eq!(of("a.tif#2").unwrap(), ("a.tif".to_string(), Some(2), None));
        let raw = "Mono12p:4x2".parse().unwrap();
        assert_eq!(of("a.raw#Mono12p:4x2").unwrap(), ("a.raw".to_string(), None, Some(raw)));
        for other in ["a.png", "#2", "a#b", "a#0"] {
            assert_eq!(of(other).unwrap().0, other);
        }
        assert!(of("a.raw#Mono13:4x2").unwrap_err().contains("'Mono13' is no format"));
    }
}
