//! The machine that the program runs on.

use std::fs;

/// Memory of the machine, or of the container if that has less, bytes; 8 GiB where it is not known.
pub fn memory() -> u64 {
    const USUAL: u64 = 8 << 30;
    let machine = fs::read_to_string("/proc/meminfo").ok().and_then(|text| total(&text)).unwrap_or(USUAL);
    let containers = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits =
        containers.iter().filter_map(|path| fs::read_to_string(path).ok()?.trim().parse::<u64>().ok());
    limits.fold(machine, u64::min)
}

/// `MemTotal` of /proc/meminfo, bytes.
fn total(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_has_memory() {
        assert_eq!(total("MemFree: 1 kB\nMemTotal:       24012345 kB\n"), Some(1024 * 24_012_345));
        assert_eq!(total("MemTotal: much"), None);
        assert!(memory() > 1 << 20);
    }
}
