//! One frame's file: a head, sections, and a checksum of everything before it; little-endian.

use crate::error::Problem;

const MAGIC: &[u8; 4] = b"FF4D";
/// Of the format that is written.
pub(crate) const VERSION: u32 = 3;
/// Those before are read as well: the first has no changed static rows, the second has harmonics as red, green and blue.
pub(crate) const READABLE: std::ops::RangeInclusive<u32> = 1..=VERSION;
const HEAD: usize = 8;
const CHECKSUM: usize = 4;
/// CRC-32 of any bytes with their own CRC-32 behind them.
const RESIDUE: u32 = 0x2144_DF1C;

/// What a section holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tag {
    /// All of the static layer.
    StaticKey,
    /// Static Gaussians whose shape has changed.
    StaticRows,
    /// Changes of the static layer's colours.
    StaticColours,
    /// All of the dynamic layer.
    DynamicKey,
    /// Motion of groups, deaths, changes and births.
    DynamicChange,
    /// How well each dynamic position is known.
    Uncertainty,
    /// The sky, an equirectangular JPEG.
    Sky,
}

impl Tag {
    const ALL: [(Self, [u8; 4]); 7] = [
        (Self::StaticKey, *b"STAT"),
        (Self::StaticRows, *b"SROW"),
        (Self::StaticColours, *b"SCOL"),
        (Self::DynamicKey, *b"DKEY"),
        (Self::DynamicChange, *b"DMOV"),
        (Self::Uncertainty, *b"DUNC"),
        (Self::Sky, *b"SKYE"),
    ];

    /// In the list of frames.
    pub(crate) fn name(self) -> String {
        format!("{self:?}")
    }

    fn bytes(self) -> [u8; 4] {
        Self::ALL.iter().find(|(tag, _)| *tag == self).map_or([0; 4], |(_, bytes)| *bytes)
    }
}

/// Head, sections and checksum.
pub(crate) fn encode(sections: &[(Tag, Vec<u8>)]) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    for (tag, payload) in sections {
        out.extend(tag.bytes());
        out.extend((payload.len() as u32).to_le_bytes());
        out.extend(payload);
    }
    out.extend(crc32fast::hash(&out).to_le_bytes());
    out
}

/// The checksum at a file's end.
pub(crate) fn checksum(bytes: &[u8]) -> u32 {
    bytes.last_chunk::<CHECKSUM>().map_or(0, |checksum| u32::from_le_bytes(*checksum))
}

/// Whether a list that names a file of checksum `listed` means this one. The first lists held the CRC-32 of all bytes, the
/// checksum among them, which is the same for every file.
pub(crate) fn is_listed(bytes: &[u8], listed: u32) -> bool {
    [checksum(bytes), RESIDUE].contains(&listed)
}

/// The sections of a file whose checksum is right. Those with unknown names are passed over.
pub(crate) fn decode(bytes: &[u8]) -> Result<Vec<(Tag, &[u8])>, Problem> {
    let short = || Problem::Corrupt("cut off".into());
    let (body, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or_else(short)?;
    let (head, mut rest) = body.split_first_chunk::<HEAD>().ok_or_else(short)?;
    if !head.starts_with(MAGIC) {
        return Err(Problem::Corrupt("not a frame of a stream".into()));
    }
    let found = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
    if !READABLE.contains(&found) {
        return Err(Problem::Version { found, known: VERSION });
    }
    if crc32fast::hash(body).to_le_bytes() != *checksum {
        return Err(Problem::Corrupt("the checksum differs".into()));
    }
    let mut out = Vec::new();
    while let Some((head, tail)) = rest.split_first_chunk::<8>() {
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let (payload, tail) = tail.split_at_checked(length).ok_or_else(short)?;
        let known = Tag::ALL.iter().find(|(_, bytes)| bytes == &head[..4]);
        out.extend(known.map(|(tag, _)| (*tag, payload)));
        rest = tail;
    }
    if rest.is_empty() { Ok(out) } else { Err(short()) }
}

/// Splits a number of four bytes off.
pub(crate) fn take_u32(bytes: &mut &[u8]) -> Result<u32, Problem> {
    let (head, rest) =
        bytes.split_first_chunk::<4>().ok_or_else(|| Problem::Corrupt("a section ends early".into()))?;
    *bytes = rest;
    Ok(u32::from_le_bytes(*head))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_come_back_and_a_changed_byte_is_seen() {
        let bytes = encode(&[(Tag::Sky, vec![1, 2, 3]), (Tag::DynamicKey, Vec::new())]);
        assert_eq!(decode(&bytes).unwrap(), [(Tag::Sky, &[1, 2, 3][..]), (Tag::DynamicKey, &[])]);
        for i in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[i] ^= 1;
            assert!(decode(&bad).is_err(), "byte {i}");
            assert!(decode(&bytes[..i]).is_err(), "{i} bytes");
        }
    }
}
