//! Raw files of cameras: not read, but recognised, with the command that converts them.

use std::path::Path;

use super::tiff_page::is_tiff;

/// Beginnings of files: at which byte, what, and what it is.
const BEGINNINGS: [(usize, &[u8], &str); 9] = [
    (8, b"CR", "Canon CR2"),
    (4, b"ftypcrx", "Canon CR3"),
    (0, b"FUJIFILMCCD-RAW", "Fujifilm RAF"),
    (0, b"IIRO", "Olympus ORF"),
    (0, b"IIRS", "Olympus ORF"),
    (0, b"MMOR", "Olympus ORF"),
    (0, b"IIU\0", "Panasonic RW2"),
    (0, b"FOVb", "Sigma X3F"),
    (0, b"\0MRM", "Minolta MRW"),
];

/// Raw files that begin as TIFF, by the ending of their name.
const TIFF_ENDINGS: [(&str, &str); 10] = [
    ("nef", "Nikon NEF"),
    ("nrw", "Nikon NRW"),
    ("arw", "Sony ARW"),
    ("sr2", "Sony SR2"),
    ("dng", "DNG"),
    ("pef", "Pentax PEF"),
    ("srw", "Samsung SRW"),
    ("3fr", "Hasselblad 3FR"),
    ("iiq", "Phase One IIQ"),
    ("erf", "Epson ERF"),
];

/// What to say of a raw file; `None` if it is none.
pub(super) fn problem(path: &Path, start: &[u8]) -> Option<String> {
    let is_tiff = is_tiff(start);
    let begins = |(at, what, _): &&(usize, &[u8], &str)| {
        // "CR" at byte 8 means something only in a TIFF.
        start.get(*at..).is_some_and(|rest| rest.starts_with(what)) && (*what != b"CR" || is_tiff)
    };
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    let by_ending = || TIFF_ENDINGS.iter().find(|(e, _)| is_tiff && *e == ending).map(|(_, name)| *name);
    let name = BEGINNINGS.iter().find(begins).map(|(_, _, name)| *name).or_else(by_ending)?;
    let file = path.display();
    let tiff = path.with_extension("tiff");
    Some(format!(
        "is a raw file ({name}), which is not read: convert both photographs alike and linearly, as `dcraw -4 -T -w -o 0 \
         '{file}'` does, which writes '{}' (newer cameras: `dcraw_emu` of LibRaw, with the same options)",
        tiff.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_files_are_told_apart_from_pictures() {
        for (name, start, expected) in [
            ("a.CR2", &b"II*\0\x10\0\0\0CR\x02\0"[..], Some("Canon CR2")),
            ("a.cr3", b"\0\0\0\x18ftypcrx \0\0\0\0", Some("Canon CR3")),
            ("a.RAF", b"FUJIFILMCCD-RAW 0201", Some("Fujifilm RAF")),
            ("a.NEF", b"MM\0*\0\0\0\x08", Some("Nikon NEF")),
            ("a.dng", b"II*\0\x08\0\0\0", Some("DNG")),
            ("noending", b"IIU\0\x08\0\0\0", Some("Panasonic RW2")),
            ("a.tif", b"II*\0\x08\0\0\0", None),
            ("a.nef", b"\x89PNG\r\n\x1a\n", None),
            ("a.png", b"\x89PNG\r\n\x1a\nCR", None),
        ] {
            let problem = problem(Path::new(name), start);
            assert_eq!(problem.is_some(), expected.is_some(), "{name}: {problem:?}");
            let problem = problem.unwrap_or_default();
            assert!(problem.contains(expected.unwrap_or_default()), "{problem}");
            assert!(problem.is_empty() || problem.contains(&format!("dcraw -4 -T -w -o 0 '{name}'")), "{problem}");
        }
    }
}
