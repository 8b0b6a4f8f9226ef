use crate::{Camera, ImageRgb8, Mask};

/// One view of a frame: its camera, photograph and foreground.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Camera of this frame.
    pub camera: Camera,
    /// The photograph, of the camera's size.
    pub image: ImageRgb8,
    /// Foreground mask; all background where the capture has none.
    pub mask: Mask,
}
