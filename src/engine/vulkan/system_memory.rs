//! The memory that the system has available.

/// Returns the bytes that the system can give this process without swapping. On Linux within the limits of its control
/// groups and of its address space (`ulimit -v`). `None` on systems other than Linux and Windows.
#[cfg(not(windows))]
pub fn available_memory() -> Option<u64> {
    /// Address space that threads and their allocators reserve once they run, at most half of what is left, bytes.
    const RESERVED: u64 = 512 << 20;
    /// Bytes of a page of memory on most processors. Larger pages only make the estimate of what is taken smaller.
    const PAGE: u64 = 4096;

    let read = |file: &str| std::fs::read_to_string(file).ok();
    let report = read("/proc/meminfo")?;
    let line = report.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let free = line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10;
    let number = |file: String| read(&file)?.trim().parse::<u64>().ok();
    let groups = read("/proc/self/cgroup").unwrap_or_default();
    let own = groups.lines().find_map(|line| line.strip_prefix("0::")).unwrap_or("/");
    let of_group = |group: &std::path::Path| {
        let folder = format!("/sys/fs/cgroup{}", group.display());
        let (limit, used) = (number(format!("{folder}/memory.max"))?, number(format!("{folder}/memory.current"))?);
        Some(limit.saturating_sub(used))
    };
    let by_groups = std::path::Path::new(own).ancestors().filter_map(of_group).min();
    let by_space = || {
        let limits = read("/proc/self/limits")?;
        let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
        let limit = line.split_whitespace().next()?.parse::<u64>().ok()?;
        let taken = read("/proc/self/statm")?.split_whitespace().next()?.parse::<u64>().ok()?;
        let (taken, rest) = (taken * PAGE, limit.saturating_sub(taken * PAGE));
        Some(rest - RESERVED.saturating_sub(taken).min(rest / 2))
    };
    [by_groups, by_space()].into_iter().flatten().chain([free]).min()
}

/// Returns the bytes that the system can give this process without swapping.
#[cfg(windows)]
pub fn available_memory() -> Option<u64> {
    /// `MEMORYSTATUSEX`.
    #[repr(C)]
    #[derive(Default)]
    struct Status {
        length: u32,
        load: u32,
        physical: [u64; 2],
        committed: [u64; 2],
        address_space: [u64; 2],
        extended: u64,
    }
    // SAFETY: Windows declares the function so, and fills a structure of the stated length. The standard library links
    // kernel32.
    unsafe extern "system" {
        safe fn GlobalMemoryStatusEx(status: &mut Status) -> i32;
    }
    let mut status = Status { length: size_of::<Status>() as u32, ..Status::default() };
    // Each has the total and what is available.
    let filled = GlobalMemoryStatusEx(&mut status) != 0;
    filled.then(|| status.physical[1].min(status.committed[1]).min(status.address_space[1]))
}

#[cfg(test)]
mod tests {
    #[test]
    fn some_memory_is_available_but_less_than_an_exabyte() {
        let known = cfg!(any(target_os = "linux", windows));
        assert!(super::available_memory().map_or(!known, |bytes| (1 << 20..1 << 60).contains(&bytes)));
    }
}
