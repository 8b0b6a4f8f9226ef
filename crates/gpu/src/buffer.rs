//! Memory on the device, counted, and given back when its last owner is dropped.

use crate::GpuError;
use std::hash::{Hash, Hasher};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Memory on the device. Cloning shares it.
#[derive(Clone, Debug)]
pub struct Buffer(pub(crate) wgpu::Buffer, Arc<Share>);

impl Buffer {
    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        self.1.bytes
    }
}

impl PartialEq for Buffer {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl Eq for Buffer {}

impl Hash for Buffer {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash(state);
    }
}

/// What the buffers of a device hold.
#[derive(Debug)]
pub(crate) struct Memory {
    /// Bytes that may be held.
    pub limit: u64,
    held: Arc<AtomicU64>,
    peak: AtomicU64,
}

impl Memory {
    pub(crate) fn new(limit: u64) -> Self {
        Self { limit, held: Arc::default(), peak: AtomicU64::new(0) }
    }

    /// Sets `bytes` aside; they are free again when the share is dropped.
    pub(crate) fn take(&self, bytes: u64) -> Result<Share, GpuError> {
        let share = Share { bytes, held: self.held.clone() };
        let before = self.held.fetch_add(bytes, Ordering::Relaxed);
        let now = before.saturating_add(bytes);
        if now > self.limit {
            return Err(GpuError::OutOfMemory);
        }
        self.peak.fetch_max(now, Ordering::Relaxed);
        Ok(share)
    }

    pub(crate) fn held(&self) -> u64 {
        self.held.load(Ordering::Relaxed)
    }

    /// Most that was ever held.
    pub(crate) fn peak(&self) -> u64 {
        self.peak.load(Ordering::Relaxed)
    }
}

/// Bytes set aside for one buffer.
#[derive(Debug)]
pub(crate) struct Share {
    bytes: u64,
    held: Arc<AtomicU64>,
}

impl Share {
    pub(crate) fn of(self, buffer: wgpu::Buffer) -> Buffer {
        Buffer(buffer, Arc::new(self))
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.held.fetch_sub(self.bytes, Ordering::Relaxed);
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
    fn memory_is_refused_beyond_the_limit_and_free_when_dropped() {
        let memory = Memory::new(100);
        let most = memory.take(90).unwrap();
        assert_eq!(memory.take(11).err(), Some(GpuError::OutOfMemory));
        assert_eq!(memory.held(), 90);
        drop(most);
        assert_eq!(memory.held(), 0);
        assert_eq!(memory.peak(), 90, "what was refused was never held");
        assert!(memory.take(100).is_ok());
    }

    #[test]
    fn sizes_are_whole_words_and_bounded() {
        assert_eq!(checked_size("a", 0, 100), Ok(16));
        assert_eq!(checked_size("a", 97, 100), Ok(100));
        let refused = checked_size("splats", 101, 100).unwrap_err();
        assert!(refused.to_string().contains("splats needs 101 bytes"), "{refused}");
    }
}
