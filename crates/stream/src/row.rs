//! A Gaussian as integers.

/// SH values above degree 0: 15 coefficients of three channels.
pub(crate) const MAX_HARMONICS: usize = 45;
/// Bits of a group's number.
pub(crate) const GROUP_BITS: u32 = 4;
/// Groups that move together.
pub(crate) const MAX_GROUPS: usize = 1 << GROUP_BITS;

/// A Gaussian in steps of its layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Row {
    pub(crate) position: [i32; 3],
    /// Which component of the quaternion is not stored.
    pub(crate) largest: u8,
    pub(crate) rotation: [i32; 3],
    pub(crate) scales: [i32; 3],
    pub(crate) opacity: i32,
    pub(crate) colour: [i32; 3],
    pub(crate) harmonics: [i16; MAX_HARMONICS],
    /// Which group it moves with.
    pub(crate) group: u8,
}

impl Default for Row {
    fn default() -> Self {
        Self {
            position: [0; 3],
            largest: 0,
            rotation: [0; 3],
            scales: [0; 3],
            opacity: 0,
            colour: [0; 3],
            harmonics: [0; MAX_HARMONICS],
            group: 0,
        }
    }
}

impl Row {
    /// All of a row, little-endian, with so many harmonics.
    pub(crate) fn bytes(&self, harmonics: usize) -> Vec<u8> {
        let numbers = [self.position, self.rotation, self.scales, self.colour].into_iter().flatten();
        let mut out: Vec<u8> = numbers.chain([self.opacity]).flat_map(i32::to_le_bytes).collect();
        out.extend([self.largest, self.group]);
        out.extend(self.harmonics[..harmonics].iter().flat_map(|v| v.to_le_bytes()));
        out
    }
}
