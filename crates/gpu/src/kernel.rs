//! Kernels by name: the text of a shader with its shared pieces, taken into the program when it is built.

/// Text of a file below a crate's `shaders/`, taken at build time: a missing file does not build, and an old one cannot be
/// shipped.
#[macro_export]
macro_rules! wgsl {
    ($path:expr) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $path, ".wgsl"))
    };
}

/// `linear_group`, which every kernel has: dispatches are split over two dimensions.
pub const GROUPS: &str = wgsl!("groups");

/// The kernels of a crate, one per file of its `shaders/`: `NAME = "file" of 256, [shared pieces];` with the invocations of
/// a workgroup, and `subgroups` at the end of those that need subgroup operations. Tests have all of them as `ALL`.
#[macro_export]
macro_rules! kernels {
    (@subgroups) => {
        true
    };
    ($($name:ident = $file:literal of $group:literal, [$($piece:expr),*] $(, $subgroups:ident)?;)*) => {
        $(pub(crate) const $name: $crate::Kernel = $crate::Kernel {
            name: $file,
            source: &[$($piece,)* $crate::GROUPS, $crate::wgsl!($file)],
            group: $group,
            subgroups: false $(|| $crate::kernels!(@$subgroups))?,
        };)*

        /// Every kernel of this crate.
        #[cfg(test)]
        pub(crate) const ALL: &[$crate::Kernel] = &[$($name),*];
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
    /// Invocations of a workgroup.
    pub group: usize,
    /// Whether it needs subgroup operations.
    pub subgroups: bool,
}

impl Kernel {
    /// The whole module.
    pub fn text(&self) -> String {
        self.source.join("\n")
    }
}
