//! How the module is linked.

fn main() {
    // On macOS the names of Python's interface are found when the module is loaded; elsewhere this says nothing.
    pyo3_build_config::add_extension_module_link_args();
}
