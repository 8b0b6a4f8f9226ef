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

    /// Texels along the edge of a face.
    pub fn face_size(&self) -> usize {
        self.face_size
    }
}
