//! What this process has used so far and what it may still take, as Linux tells; `None` on other systems.

/// Most memory held (MiB): `VmHWM`.
pub(crate) fn peak_mib() -> Option<f64> {
    peak_kib(&std::fs::read_to_string("/proc/self/status").ok()?).map(|kib| kib / 1024.0)
}

fn peak_kib(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

/// Memory that is free (MiB): of the machine, or of the control group that this process is in, whichever is less.
pub(crate) fn free_mib() -> Option<f64> {
    let machine = field(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")? / 1024.0;
    Some(group_free_mib().map_or(machine, |group| group.min(machine)))
}

/// `None` without a control group, and in one without a limit.
fn group_free_mib() -> Option<f64> {
    let read = |name: &str| std::fs::read_to_string(format!("/sys/fs/cgroup/memory.{name}")).ok();
    let [max, current] = [read("max")?, read("current")?].map(|text| text.trim().parse::<f64>().ok());
    // What files leave in memory is given up when it is needed.
    let files = read("stat").and_then(|text| field(&text, "inactive_file")).unwrap_or(0.0);
    Some((max? - current? + files) / f64::from(1 << 20))
}

/// The number behind a name at the beginning of a line.
fn field(text: &str, name: &str) -> Option<f64> {
    let line = text.lines().find_map(|l| l.strip_prefix(name))?;
    line.split_ascii_whitespace().next()?.parse().ok()
}

/// Bytes read from files, pipes and sockets (MiB), those that the system had in memory with them.
pub(crate) fn read_mib() -> Option<f64> {
    read_bytes(&std::fs::read_to_string("/proc/self/io").ok()?).map(|bytes| bytes / f64::from(1 << 20))
}

fn read_bytes(io: &str) -> Option<f64> {
    io.lines().find_map(|l| l.strip_prefix("rchar:"))?.trim().parse().ok()
}

/// Time of all threads on processors (s).
pub(crate) fn processor_seconds() -> Option<f64> {
    processor_ticks(&std::fs::read_to_string("/proc/self/stat").ok()?).map(|ticks| ticks / TICKS_PER_SECOND)
}

/// What Linux shows to programs, whatever its timer does.
const TICKS_PER_SECOND: f64 = 100.0;

/// Fields 14 and 15 of `proc(5)`'s stat; the second, a name in brackets, may hold blanks.
fn processor_ticks(stat: &str) -> Option<f64> {
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(11);
    let mut next = || fields.next()?.parse::<f64>().ok();
    Some(next()? + next()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_is_found_and_anything_else_is_none() {
        assert_eq!(peak_kib("Name:\tffgs\nVmHWM:\t  204800 kB\nVmRSS:\t 1 kB\n"), Some(204_800.0));
        assert_eq!(peak_kib("VmRSS:\t 1 kB\n"), None);
        assert_eq!(peak_kib("VmHWM:\t many kB\n"), None);
        assert_eq!(field("MemFree: 3 kB\nMemAvailable:   2048 kB\n", "MemAvailable:"), Some(2048.0));
        assert_eq!(field("MemAvailable: max\n", "MemAvailable:"), None);
        assert_eq!(read_bytes("rchar: 12\nwchar: 5\n"), Some(12.0));
        assert_eq!(read_bytes("wchar: 5\n"), None);
        let stat = "7 (a ) b) S 1 2 3 4 5 6 7 8 9 10 250 50 0 0";
        assert_eq!(processor_ticks(stat), Some(300.0));
        assert_eq!(processor_ticks("7 (a"), None);
    }
}
