//! The pipeline cache on disk, under the user's cache folder.
//!
//! A file from another device or driver, or a damaged one, is ignored: drivers are known to crash on cache data they did
//! not write. What is in it is run, in the end: it is kept in a folder that only the user can write into or read, and taken
//! from nowhere else, since a checksum tells damage from intent no better than the one who forges it.

use std::fs::{self, DirBuilder, File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::instance::PhysicalDevice;

/// The most bytes of a cache that are read, 64 MiB: one of all passes takes three at most.
const MAX_BYTES: u64 = 64 << 20;

const MAGIC: &[u8; 8] = b"PARFOCL1";
const HEADER: usize = 8 + 16 + 4 + 8;

/// `PARFOCAL_CACHE_DIR`, or the user's cache folder.
fn folder() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    set("PARFOCAL_CACHE_DIR")
        .or_else(|| set("XDG_CACHE_HOME").map(|p| p.join("parfocal")))
        .or_else(|| set("HOME").map(|p| p.join(".cache").join("parfocal")))
}

fn path(device: &PhysicalDevice) -> Option<PathBuf> {
    Some(folder()?.join("pipelines").join(format!("{}.bin", device.info.uuid)))
}

/// FNV-1a, 64 bits: enough to notice damage.
fn checksum(data: &[u8]) -> u64 {
    data.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

fn header(uuid: &[u8; 16], driver_version: u32, data: &[u8]) -> Vec<u8> {
    [&MAGIC[..], uuid, &driver_version.to_le_bytes(), &checksum(data).to_le_bytes()].concat()
}

/// The data within a cache file, if the file is whole and was written for this device and driver.
fn unwrap_file(file: &[u8], uuid: &[u8; 16], driver_version: u32) -> Option<Vec<u8>> {
    let (head, data) = file.split_at_checked(HEADER)?;
    (head == header(uuid, driver_version, data)).then(|| data.to_vec())
}

/// The cache data for this device and driver, if there is any.
pub(super) fn read(device: &PhysicalDevice) -> Option<Vec<u8>> {
    unwrap_file(&read_own(&path(device)?)?, &device.cache_uuid, device.driver_version)
}

/// The bytes of a file that nobody else can have written.
fn read_own(path: &Path) -> Option<Vec<u8>> {
    let found = fs::symlink_metadata(path).ok()?;
    let is_ours = is_private(path.parent()?) && found.is_file() && is_own(&found) && found.len() <= MAX_BYTES;
    let mut bytes = Vec::new();
    is_ours.then(|| File::open(path).ok()?.take(MAX_BYTES).read_to_end(&mut bytes).ok()).flatten()?;
    Some(bytes)
}

/// Whether nobody else can put anything into a folder.
fn is_private(folder: &Path) -> bool {
    #[cfg(unix)]
    let is_closed = |found: &Metadata| std::os::unix::fs::MetadataExt::mode(found) & 0o077 == 0;
    #[cfg(not(unix))]
    let is_closed = |_: &Metadata| true;
    fs::symlink_metadata(folder).is_ok_and(|found| found.is_dir() && is_own(&found) && is_closed(&found))
}

#[cfg(unix)]
fn is_own(found: &Metadata) -> bool {
    // SAFETY: POSIX has it so, and it cannot fail; the standard library is linked with the library that has it.
    unsafe extern "C" {
        safe fn geteuid() -> u32;
    }
    std::os::unix::fs::MetadataExt::uid(found) == geteuid()
}

#[cfg(not(unix))]
fn is_own(_: &Metadata) -> bool {
    true
}

fn make_private(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder.parent().ok_or(io::ErrorKind::NotFound)?)?;
    let mut builder = DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    match builder.create(folder) {
        Err(_) if is_private(folder) => Ok(()),
        other => other,
    }
}

/// Replaces the file, unless it holds the same already; a cache that cannot be written is only slower.
pub(super) fn write(device: &PhysicalDevice, data: &[u8]) {
    if read(device).is_some_and(|old| old == data) {
        return;
    }
    let write = || -> io::Result<()> {
        let path = path(device).ok_or(io::ErrorKind::NotFound)?;
        make_private(path.parent().ok_or(io::ErrorKind::NotFound)?)?;
        // Another process may write at the same time; what two threads of this one mix up fails the checksum.
        let unfinished = path.with_extension(std::process::id().to_string());
        fs::write(&unfinished, [&header(&device.cache_uuid, device.driver_version, data), data].concat())?;
        fs::rename(&unfinished, &path)
    };
    let _ = write();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_file_of_the_same_driver_is_taken() {
        let (uuid, data) = ([7; 16], b"pipelines".to_vec());
        let file = [header(&uuid, 3, &data), data.clone()].concat();
        assert_eq!(unwrap_file(&file, &uuid, 3), Some(data));
        assert_eq!(unwrap_file(&file, &uuid, 4), None, "another driver");
        assert_eq!(unwrap_file(&file, &[8; 16], 3), None, "another device");
        for cut in 0..file.len() {
            assert_eq!(unwrap_file(&file[..cut], &uuid, 3), None, "cut at {cut}");
        }
        let mut damaged = file;
        damaged[HEADER + 2] ^= 1;
        assert_eq!(unwrap_file(&damaged, &uuid, 3), None, "damaged");
    }

    #[cfg(unix)]
    #[test]
    fn only_what_nobody_else_can_write_is_read() {
        use std::os::unix::fs::{PermissionsExt, symlink};

        let base = std::env::temp_dir().join(format!("parfocal-cache-{}", std::process::id()));
        let folder = base.join("pipelines");
        make_private(&folder).unwrap();
        make_private(&folder).unwrap();
        let file = folder.join("device.bin");
        assert_eq!(read_own(&file), None, "there is none");
        fs::write(&file, "pipelines").unwrap();
        assert_eq!(read_own(&file).as_deref(), Some(&b"pipelines"[..]));
        symlink("device.bin", folder.join("link.bin")).unwrap();
        assert_eq!(read_own(&folder.join("link.bin")), None, "a link");
        assert!(std::process::Command::new("mkfifo").arg(folder.join("pipe.bin")).status().unwrap().success());
        assert_eq!(read_own(&folder.join("pipe.bin")), None, "a pipe");
        File::create(folder.join("large.bin")).unwrap().set_len(MAX_BYTES + 1).unwrap();
        assert_eq!(read_own(&folder.join("large.bin")), None, "too large");
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(read_own(&file), None, "the folder is open to others");
        assert!(make_private(&folder).is_err());
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn what_was_changed_anywhere_is_not_taken() {
        let (uuid, data) = ([7; 16], (0..200).collect::<Vec<u8>>());
        let file = [header(&uuid, 3, &data), data].concat();
        // Each byte in each way, and each two in one: a checksum of 64 bits lets none of so few pass.
        for at in 0..file.len() {
            for by in 1..=255 {
                let mut changed = file.clone();
                changed[at] ^= by;
                assert_eq!(unwrap_file(&changed, &uuid, 3), None, "{at} by {by}");
                changed[(at + usize::from(by)) % file.len()] ^= by;
                assert!(changed == file || unwrap_file(&changed, &uuid, 3).is_none(), "{at} and another by {by}");
            }
        }
    }
}
