//! numpy files (.npz, .npy) to typed vectors and back.
//!
//! Every reader converts from whatever numeric dtype, byte order and memory order the file holds, refuses values
//! that the wanted type cannot hold, and allocates no more than the file really contains.

mod array;
mod element;
mod error;
mod header;
mod npy;
mod npz;
mod writer;

pub use array::Array;
pub use element::Element;
pub use error::{ArraysError, Cause};
pub use npy::read_npy;
pub use npz::NpzFile;
pub use writer::NpzWriter;
