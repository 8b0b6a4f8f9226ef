use crate::DatasetError;
use ffgs_arrays::NpzFile;
use std::path::Path;

/// Coloured points of frame 0, columns of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions in the world (m), finite.
    pub positions: Vec<[f32; 3]>,
    /// sRGB in 0..=1.
    pub colours: Vec<[f32; 3]>,
    /// Whether the point lies on the dynamic foreground.
    pub foreground: Vec<bool>,
    /// Points left out because a value was NaN or infinite.
    pub dropped: usize,
}

impl PointCloud {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Number of foreground points.
    pub fn foreground_count(&self) -> usize {
        self.foreground.iter().filter(|f| **f).count()
    }

    fn push(&mut self, [x, y, z, r, g, b, foreground]: [f32; 7]) {
        self.positions.push([x, y, z]);
        self.colours.push([r, g, b].map(|c| c.clamp(0.0, 1.0)));
        self.foreground.push(foreground > 0.5);
    }
}

/// Reads `data` (N, 7) of the file.
pub(crate) fn read(file: &Path) -> Result<PointCloud, DatasetError> {
    let data = NpzFile::open(file)?.f32("data")?.expect_shape(&[None, Some(7)])?;
    let mut cloud = PointCloud::default();
    for row in data.rows::<7>().unwrap_or_default() {
        if row.iter().all(|v| v.is_finite()) {
            cloud.push(*row);
        } else {
            cloud.dropped += 1;
        }
    }
    Ok(cloud)
}
