//! One run over the frames of a capture: what is asked for, what it is made from, and the loop over its frames.

pub mod device;
pub mod frame;
pub mod lock;
pub mod manifest;
pub(crate) mod memory;
pub(crate) mod memory_need;
pub(crate) mod provenance;
pub(crate) mod read_ahead;
pub mod request;
pub mod run;
