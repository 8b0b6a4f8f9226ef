/// Text of a file below `shaders/`, taken at build time: a missing file does not build, and an old one cannot be shipped.
#[macro_export]
macro_rules! wgsl {
    ($path:expr) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shaders/", $path, ".wgsl"))
    };
}

/// A compute shader: one entry point, its bindings numbered from 0 in group 0 in the order in which
/// [`crate::Commands::run`] takes the buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel {
    /// Name of the entry point, of the file and in a profiler.
    pub name: &'static str,
    /// WGSL: shared pieces first, then the file with the entry point.
    pub source: &'static [&'static str],
    /// Whether it needs subgroup operations.
    pub subgroups: bool,
}

impl Kernel {
    /// The whole module.
    pub fn text(&self) -> String {
        self.source.join("\n")
    }
}
