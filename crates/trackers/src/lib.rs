//! Trackers that need no network: corners, descriptors matched between two pictures (sparse), and pyramidal
//! Lucas-Kanade with a forward-backward check (medium).
//!
//! All positions are continuous pixel coordinates with the centre of the first pixel at (0.5, 0.5).

mod agreement;
mod corners;
mod descriptors;
mod lucas_kanade;
mod matching;
mod pyramid;
mod tracker;

pub use descriptors::Descriptor;
pub use matching::{Neighbours, nearest_two};
pub use pyramid::Pyramid;
pub use tracker::{Frame, TrackerConfig, lucas_kanade, matches};
