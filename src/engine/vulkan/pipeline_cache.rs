//! The pipeline cache on disk, in the user's cache folder.
//!
//! A damaged file, or one of another device or driver, is ignored: drivers can crash on data that they did not write.
//! The data end up as code that the driver runs, and a checksum does not protect against forgery. The file is therefore
//! read only from a folder that no other user can read or write.

use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::instance::PhysicalDevice;

/// The largest cache that is read, in bytes. The cache of all passes takes 3 MiB at most.
const MAX_BYTES: u64 = 64 << 20;

const MAGIC: &[u8; 8] = b"PARFOCL1";
/// Bytes before the data: magic number, cache UUID, driver version, checksum.
const HEADER_BYTES: usize = 8 + 16 + 4 + 8;

/// Returns `PARFOCAL_CACHE_DIR`, or the user's cache folder.
fn cache_folder() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    variable("PARFOCAL_CACHE_DIR")
        .or_else(|| variable(if cfg!(windows) { "LOCALAPPDATA" } else { "XDG_CACHE_HOME" }).map(|p| p.join("parfocal")))
        .or_else(|| variable("HOME").map(|p| p.join(".cache").join("parfocal")))
}

fn cache_path(device: &PhysicalDevice) -> Option<PathBuf> {
    Some(cache_folder()?.join("pipelines").join(format!("{}.bin", device.info.uuid)))
}

/// FNV-1a, 64 bits: detects damage.
fn checksum(data: &[u8]) -> u64 {
    data.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

fn header(uuid: &[u8; 16], driver_version: u32, data: &[u8]) -> Vec<u8> {
    [&MAGIC[..], uuid, &driver_version.to_le_bytes(), &checksum(data).to_le_bytes()].concat()
}

/// Returns the data of a cache file that is undamaged and belongs to this device and driver.
fn parse(file: &[u8], uuid: &[u8; 16], driver_version: u32) -> Option<Vec<u8>> {
    let (found, data) = file.split_at_checked(HEADER_BYTES)?;
    (found == header(uuid, driver_version, data)).then(|| data.to_vec())
}

/// Reads the cache data of this device and driver.
pub(super) fn read(device: &PhysicalDevice) -> Option<Vec<u8>> {
    parse(&read_private(&cache_path(device)?)?, &device.cache_uuid, device.driver_version)
}

/// Reads a regular file that no other user can have written.
fn read_private(path: &Path) -> Option<Vec<u8>> {
    let metadata = fs::symlink_metadata(path).ok()?;
    let is_trusted =
        is_private(path.parent()?) && metadata.is_file() && is_owned(&metadata) && metadata.len() <= MAX_BYTES;
    let mut bytes = Vec::new();
    is_trusted.then(|| File::open(path).ok()?.take(MAX_BYTES).read_to_end(&mut bytes).ok()).flatten()?;
    Some(bytes)
}

/// Whether no other user can read or write a folder.
fn is_private(folder: &Path) -> bool {
    #[cfg(unix)]
    let is_closed = |metadata: &Metadata| std::os::unix::fs::MetadataExt::mode(metadata) & 0o077 == 0;
    #[cfg(not(unix))]
    let is_closed = |_: &Metadata| true;
    fs::symlink_metadata(folder).is_ok_and(|metadata| metadata.is_dir() && is_owned(&metadata) && is_closed(&metadata))
}

#[cfg(unix)]
fn is_owned(metadata: &Metadata) -> bool {
    // SAFETY: POSIX declares the function so, and it cannot fail. The standard library links the C library.
    unsafe extern "C" {
        safe fn geteuid() -> u32;
    }
    std::os::unix::fs::MetadataExt::uid(metadata) == geteuid()
}

#[cfg(not(unix))]
fn is_owned(_: &Metadata) -> bool {
    true
}

/// Creates a folder that no other user can read or write.
fn create_private_folder(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder.parent().ok_or(io::ErrorKind::NotFound)?)?;
    #[cfg(unix)]
    let created = std::os::unix::fs::DirBuilderExt::mode(&mut fs::DirBuilder::new(), 0o700).create(folder);
    // On Windows the folder is within the user's profile, whose permissions it inherits.
    #[cfg(not(unix))]
    let created = fs::create_dir(folder);
    match created {
        Err(_) if is_private(folder) => Ok(()),
        other => other,
    }
}

/// Replaces the file if its data differ. Failures are ignored: the next engine then compiles again.
pub(super) fn write(device: &PhysicalDevice, data: &[u8]) {
    if read(device).is_some_and(|old| old == data) {
        return;
    }
    let write = || -> io::Result<()> {
        let path = cache_path(device).ok_or(io::ErrorKind::NotFound)?;
        create_private_folder(path.parent().ok_or(io::ErrorKind::NotFound)?)?;
        // Another process may write at the same time, hence the name. If two threads of this process do, the checksum
        // fails.
        let temporary = path.with_extension(std::process::id().to_string());
        fs::write(&temporary, [&header(&device.cache_uuid, device.driver_version, data), data].concat())?;
        fs::rename(&temporary, &path)
    };
    let _ = write();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_another_driver_or_device_and_truncated_files_are_ignored() {
        let (uuid, data) = ([7; 16], b"pipelines".to_vec());
        let file = [header(&uuid, 3, &data), data.clone()].concat();
        assert_eq!(parse(&file, &uuid, 3), Some(data));
        assert_eq!(parse(&file, &uuid, 4), None, "another driver");
        assert_eq!(parse(&file, &[8; 16], 3), None, "another device");
        for cut in 0..file.len() {
            assert_eq!(parse(&file[..cut], &uuid, 3), None, "cut at {cut}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn only_regular_files_in_a_private_folder_are_read() {
        use std::os::unix::fs::{PermissionsExt, symlink};

        let base = std::env::temp_dir().join(format!("parfocal-cache-{}", std::process::id()));
        let folder = base.join("pipelines");
        create_private_folder(&folder).unwrap();
        create_private_folder(&folder).unwrap();
        let file = folder.join("device.bin");
        assert_eq!(read_private(&file), None, "no file");
        fs::write(&file, "pipelines").unwrap();
        assert_eq!(read_private(&file).as_deref(), Some(&b"pipelines"[..]));
        symlink("device.bin", folder.join("link.bin")).unwrap();
        assert_eq!(read_private(&folder.join("link.bin")), None, "a link");
        assert!(std::process::Command::new("mkfifo").arg(folder.join("pipe.bin")).status().unwrap().success());
        assert_eq!(read_private(&folder.join("pipe.bin")), None, "a pipe");
        File::create(folder.join("large.bin")).unwrap().set_len(MAX_BYTES + 1).unwrap();
        assert_eq!(read_private(&folder.join("large.bin")), None, "too large");
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(read_private(&file), None, "the folder is open to others");
        assert!(create_private_folder(&folder).is_err());
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn a_file_with_a_changed_byte_is_ignored() {
        let (uuid, data) = ([7; 16], (0..200).collect::<Vec<u8>>());
        let file = [header(&uuid, 3, &data), data].concat();
        // Every change of one byte, and some of two: too few for a collision of a 64-bit checksum.
        for at in 0..file.len() {
            for by in 1..=255 {
                let mut changed = file.clone();
                changed[at] ^= by;
                assert_eq!(parse(&changed, &uuid, 3), None, "{at} by {by}");
                changed[(at + usize::from(by)) % file.len()] ^= by;
                assert!(changed == file || parse(&changed, &uuid, 3).is_none(), "{at} and another by {by}");
            }
        }
    }
}
