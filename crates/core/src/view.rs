use crate::{Camera, ImageRgb8, Mask};

/// One view of a frame: where the camera stood, and where its image shows what moves.
#[derive(Clone, Debug)]
pub struct View {
    /// Camera of this frame.
    pub camera: Camera,
    /// Foreground mask, of the camera's size.
    pub mask: Mask,
}

/// One view of a frame with its photograph.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Camera of this frame.
    pub camera: Camera,
    /// The photograph, of the camera's size.
    pub image: ImageRgb8,
    /// Foreground mask; all background where the capture has none.
    pub mask: Mask,
}
