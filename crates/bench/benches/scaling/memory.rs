//! Peak memory of this process, where Linux tells it.

/// Sets the peak back to what is held now.
pub(crate) fn restart_peak() {
    // 5 = the peak of resident memory, see proc_pid_clear_refs(5). Without it the peak is that of the whole process.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Most memory held since [`restart_peak`] (bytes); NaN where the system does not say.
pub(crate) fn peak() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap_or("");
    line.trim().trim_end_matches("kB").trim().parse().map_or(f64::NAN, |kib: f64| kib * 1024.0)
}
