//! The pipeline cache on disk, under the user's cache folder.
//!
//! A file from another device or driver, or a damaged one, is ignored: drivers are known to crash on cache data they did
//! not write.

use std::path::PathBuf;

use super::instance::PhysicalDevice;

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
    Some(folder()?.join(format!("pipelines-{}.bin", device.info.uuid)))
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
    unwrap_file(&std::fs::read(path(device)?).ok()?, &device.cache_uuid, device.driver_version)
}

/// Replaces the file, unless it holds the same already; a cache that cannot be written is only slower.
pub(super) fn write(device: &PhysicalDevice, data: &[u8]) {
    if read(device).is_some_and(|old| old == data) {
        return;
    }
    let write = || -> std::io::Result<()> {
        let path = path(device).ok_or(std::io::ErrorKind::NotFound)?;
        let folder = path.parent().ok_or(std::io::ErrorKind::NotFound)?;
        std::fs::create_dir_all(folder)?;
        // Another process may write at the same time; what two threads of this one mix up fails the checksum.
        let unfinished = path.with_extension(std::process::id().to_string());
        std::fs::write(&unfinished, [&header(&device.cache_uuid, device.driver_version, data), data].concat())?;
        std::fs::rename(&unfinished, &path)
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
}
