//! The sky as a cube map at infinity, behind all Gaussians.

/// The sky: a cube map at infinity. Faces in the order +x, -x, +y, -y, +z, -z of the world with OpenGL's orientation.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyCube {
    face_size: usize,
    /// RGB of the texels, face by face, row by row: (6 * face_size * face_size). Values are not clamped.
    pub texels: Vec<[f32; 3]>,
}

impl SkyCube {
    /// A cube of one colour.
    ///
    /// # Panics
    /// When `face_size` is 0.
    pub fn filled(face_size: usize, colour: [f32; 3]) -> Self {
        assert!(face_size >= 1, "empty sky faces");
        Self { face_size, texels: vec![colour; 6 * face_size * face_size] }
    }

    /// No sky: one colour in all directions, which no lane changes.
    pub fn none(colour: [f32; 3]) -> Self {
        Self::filled(1, colour)
    }

    /// Whether this is no sky.
    pub fn is_none(&self) -> bool {
        self.face_size == 1
    }

    /// Mean colour of all texels.
    pub fn mean(&self) -> [f32; 3] {
        let sum = |c: usize| self.texels.iter().map(|t| f64::from(t[c])).sum::<f64>();
        [0, 1, 2].map(|c| (sum(c) / self.texels.len() as f64) as f32)
    }

    /// Texels along the edge of a face.
    pub fn face_size(&self) -> usize {
        self.face_size
    }
}
