//! What every plug-in owes, checked on any of them. A suite takes the contract's trait object and panics on the first
//! rule that is broken; the message begins with the plug-in's name.

mod captures;
mod methods;
mod splats;
mod tracks;
mod world;

pub use captures::capture_format;
pub use methods::motion_method;
pub use splats::splat_writer;
pub use tracks::{Sample, track_format};
pub use world::{World, WorldTracks};

use ffgs_method::Fault;
use std::path::Path;

/// The value of `work` in pools of 1 and of 8 threads.
fn in_1_and_8_threads<T: Send>(work: impl Fn() -> T + Sync) -> [T; 2] {
    [1, 8].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool of threads").install(&work)
    })
}

/// A fault must say which file it is about, and what to do.
fn assert_names(fault: &Fault, file: &Path, name: &str) {
    assert!(fault.file.starts_with(file), "{name}: the fault is about {}: {fault}", file.display());
    assert!(!fault.problem.is_empty() && !fault.fix.is_empty(), "{name}: a fault says what and how: {fault}");
}
