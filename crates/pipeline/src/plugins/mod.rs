//! What can be exchanged, one list per kind, and how a method is chosen.

pub mod choice;
pub mod method;
pub(crate) mod methods;
pub mod registry;
