//! Files that are not read: what they are, by their first bytes or their extension, and which command converts them.

use std::path::Path;

use super::tiff_page::is_tiff;

/// What to do about a kind of files.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Raw,
    Picture,
    Film,
    Archive,
    Microscope,
}

/// Magic bytes: their offset, the bytes, and the format.
const BEGINNINGS: [(usize, &[u8], &str, Kind); 19] = [
    (8, b"CR", "Canon CR2", Kind::Raw),
    (4, b"ftypcrx", "Canon CR3", Kind::Raw),
    (0, b"FUJIFILMCCD-RAW", "Fujifilm RAF", Kind::Raw),
    (0, b"IIRO", "Olympus ORF", Kind::Raw),
    (0, b"IIRS", "Olympus ORF", Kind::Raw),
    (0, b"MMOR", "Olympus ORF", Kind::Raw),
    (0, b"IIU\0", "Panasonic RW2", Kind::Raw),
    (0, b"FOVb", "Sigma X3F", Kind::Raw),
    (0, b"\0MRM", "Minolta MRW", Kind::Raw),
    (4, b"ftyphei", "HEIC", Kind::Picture),
    (4, b"ftypmif1", "HEIC", Kind::Picture),
    (4, b"ftypavif", "AVIF", Kind::Picture),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL", Kind::Picture),
    (0, b"\xff\x0a", "JPEG XL", Kind::Picture),
    (4, b"ftyp", "MP4", Kind::Film),
    (0, b"PK\x03\x04", "ZIP", Kind::Archive),
    (0, b"7z\xbc\xaf", "7z", Kind::Archive),
    (0, b"\x1f\x8b", "gzip", Kind::Archive),
    (0, b"ZISRAWFILE", "Zeiss CZI", Kind::Microscope),
];

/// Extensions of files that are not read. Some raw files begin like TIFF.
const EXTENSIONS: [(&[&str], Kind); 5] = [
    (
        &[
            "nef", "nrw", "arw", "sr2", "dng", "pef", "srw", "3fr", "iiq", "erf", "cr2", "cr3", "raf", "orf", "rw2",
            "x3f",
        ],
        Kind::Raw,
    ),
    (&["heic", "heif", "hif", "avif", "jxl"], Kind::Picture),
    (&["mp4", "mov", "avi", "mkv", "m4v"], Kind::Film),
    (&["zip", "7z", "rar", "tar", "gz", "tgz"], Kind::Archive),
    (&["czi", "lif", "nd2"], Kind::Microscope),
];

/// Advice for a file of a kind that is not read; `None` for another file. Without its first bytes the extension counts
/// alone.
pub fn foreign_problem(path: &Path, start: Option<&[u8]>) -> Option<String> {
    let bytes = start.unwrap_or_default();
    let is_tiff = is_tiff(bytes);
    let begins = |(at, what, ..): &&(usize, &[u8], &str, Kind)| {
        // "CR" at byte 8 has a meaning only in a TIFF.
        bytes.get(*at..).is_some_and(|rest| rest.starts_with(what)) && (*what != b"CR" || is_tiff)
    };
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    let by_ending = || {
        let (_, kind) = EXTENSIONS.iter().find(|(all, _)| all.contains(&ending.as_str()))?;
        (start.is_none() || is_tiff && *kind == Kind::Raw).then(|| (ending.to_uppercase(), *kind))
    };
    let by_bytes = BEGINNINGS.iter().find(begins).map(|(.., name, kind)| (name.to_string(), *kind));
    let (name, kind) = by_bytes.or_else(by_ending)?;
    let file = path.display();
    let to = |ending: &str| path.with_extension(ending).display().to_string();
    Some(match kind {
        Kind::Raw => format!(
            "is a raw file ({name}), which is not read: convert all photographs alike and linearly, as \
             `dcraw -4 -T -w -o 0 '{file}'` does, which writes '{}' (newer cameras: `dcraw_emu` of LibRaw, with the same \
             options)",
            to("tiff")
        ),
        Kind::Picture => {
            format!("is {name}, which is not read: convert it, as `magick '{file}' '{}'` does", to("png"))
        }
        Kind::Film => {
            format!("is a film, which is not read: save its frames, as `ffmpeg -i '{file}' '{}'` does", to("%04d.png"))
        }
        Kind::Archive => format!("is an archive ({name}): extract it, and give the folder of the photographs"),
        Kind::Microscope => format!(
            "is {name}, which is not read: export it as OME-TIFF, as `bfconvert '{file}' '{}'` of Bio-Formats does",
            to("ome.tif")
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_raw_files_are_distinguished_from_pictures() {
        for (name, start, expected) in [
            ("a.CR2", &b"II*\0\x10\0\0\0CR\x02\0"[..], Some("Canon CR2")),
            ("a.cr3", b"\0\0\0\x18ftypcrx \0\0\0\0", Some("Canon CR3")),
            ("a.RAF", b"FUJIFILMCCD-RAW 0201", Some("Fujifilm RAF")),
            ("a.NEF", b"MM\0*\0\0\0\x08", Some("NEF")),
            ("a.dng", b"II*\0\x08\0\0\0", Some("DNG")),
            ("noending", b"IIU\0\x08\0\0\0", Some("Panasonic RW2")),
            ("a.tif", b"II*\0\x08\0\0\0", None),
            ("a.nef", b"\x89PNG\r\n\x1a\n", None),
            ("a.png", b"\x89PNG\r\n\x1a\nCR", None),
        ] {
            let problem = foreign_problem(Path::new(name), Some(start));
            assert_eq!(problem.is_some(), expected.is_some(), "{name}: {problem:?}");
            let problem = problem.unwrap_or_default();
            assert!(problem.contains(expected.unwrap_or_default()), "{problem}");
            assert!(problem.is_empty() || problem.contains(&format!("dcraw -4 -T -w -o 0 '{name}'")), "{problem}");
        }
    }

    #[test]
    fn other_files_are_named_with_the_command_that_converts_them() {
        for (name, start, part) in [
            ("a.heic", Some(&b"\0\0\0\x18ftypheic"[..]), "`magick 'a.heic' 'a.png'`"),
            ("shots.zip", Some(b"PK\x03\x04\x14"), "is an archive (ZIP): extract it"),
            ("clip.mp4", Some(b"\0\0\0\x18ftypisom"), "`ffmpeg -i 'clip.mp4' 'clip.%04d.png'`"),
            ("cell.czi", None, "`bfconvert 'cell.czi' 'cell.ome.tif'`"),
            ("DSC_1.NEF", None, "(NEF)"),
        ] {
            let problem = foreign_problem(Path::new(name), start).unwrap();
            assert!(problem.contains(part), "{problem}");
        }
        assert_eq!(foreign_problem(Path::new("a.png"), None), None);
    }
}
