//! The pictures of cameras in time, and which of them belong to one frame.

/// What is known of one camera's pictures in time.
#[derive(Clone, Debug)]
pub(crate) struct Sequence {
    pub name: String,
    pub pictures: usize,
    /// Pictures a second; `None` for files.
    pub rate: Option<f64>,
    /// When each was taken, where it is known, ascending: seconds after the first one of a video, the numbers of files.
    pub moments: Option<Vec<f64>>,
}

/// Picture indices `[frame][camera]`, and what was found out on the way.
#[derive(Clone, Debug, Default)]
pub(crate) struct Schedule {
    pub frames: Vec<Vec<usize>>,
    pub assumed: Vec<String>,
    pub skipped: Vec<String>,
    /// Largest difference of the cameras' times within a frame (s), where there are timestamps.
    pub spread: Option<f64>,
}
