//! The page that a path names.

use std::path::{Path, PathBuf};

/// The file and the page, from 1, of `FILE#N`; the path as it is where it names no page or there is a file of that name.
pub fn split_page(path: &Path) -> (PathBuf, Option<usize>) {
    let whole = || (path.to_path_buf(), None);
    let Some((file, page)) = path.to_str().and_then(|text| text.rsplit_once('#')) else { return whole() };
    match page.parse() {
        Ok(page) if page > 0 && !file.is_empty() && !path.exists() => (file.into(), Some(page)),
        _ => whole(),
    }
}
