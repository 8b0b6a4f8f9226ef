/// Most memory that this process has held so far (MiB): `VmHWM` of Linux; `None` on other systems.
pub(crate) fn peak_mib() -> Option<f64> {
    peak_kib(&std::fs::read_to_string("/proc/self/status").ok()?).map(|kib| kib / 1024.0)
}

fn peak_kib(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_is_found_and_anything_else_is_none() {
        assert_eq!(peak_kib("Name:\tffgs\nVmHWM:\t  204800 kB\nVmRSS:\t 1 kB\n"), Some(204_800.0));
        assert_eq!(peak_kib("VmRSS:\t 1 kB\n"), None);
        assert_eq!(peak_kib("VmHWM:\t many kB\n"), None);
    }
}
