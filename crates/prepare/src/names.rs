//! Names of cameras as the capture spells them, where they are those of files.

/// The name with everything replaced that a file's name should not have.
pub(crate) fn plain_name(name: &str) -> String {
    name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect()
}

pub(crate) fn is_plain(c: char) -> bool {
    c.is_alphanumeric() || matches!(c, '-' | '_' | '.')
}
