use crate::GpuError;

/// Memory on the device. Cloning shares it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Buffer(pub(crate) wgpu::Buffer);

impl Buffer {
    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        self.0.size()
    }
}

/// Bindings and copies come in whole words, and an empty binding is not allowed.
const LEAST_BYTES: u64 = 16;

/// The size to allocate for `bytes`, or why not.
pub(crate) fn checked_size(what: &str, bytes: u64, limit: u64) -> Result<u64, GpuError> {
    let size = bytes.max(LEAST_BYTES).next_multiple_of(4);
    if size <= limit {
        return Ok(size);
    }
    Err(GpuError::TooLarge { what: what.to_owned(), bytes, limit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_whole_words_and_bounded() {
        assert_eq!(checked_size("a", 0, 100), Ok(16));
        assert_eq!(checked_size("a", 97, 100), Ok(100));
        let refused = checked_size("splats", 101, 100).unwrap_err();
        assert!(refused.to_string().contains("splats needs 101 bytes"), "{refused}");
    }
}
