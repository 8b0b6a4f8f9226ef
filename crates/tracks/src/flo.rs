//! Middlebury optical flow.

use crate::error::TracksError;
use crate::flow::{FlowFormat, RawFlow};
use ffgs_core::{ImageSize, open_input};
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

/// "PIEH", the f32 202021.25 in little-endian order.
const MAGIC: [u8; 4] = *b"PIEH";
const HEADER_BYTES: usize = 12;

/// Middlebury flow files.
pub(crate) const FLO: FlowFormat = FlowFormat { name: "flo", summary: "Middlebury optical flow", read };

/// Reads a Middlebury flow file: magic, width, height (i32), then (u, v) f32 per pixel, little-endian, row-major.
/// Another size than `expected` is refused from the header.
fn read(file: &Path, expected: ImageSize) -> Result<RawFlow, TracksError> {
    let io = |source| TracksError::Io { file: file.to_owned(), source };
    let fail = |reason: String| TracksError::Flow { file: file.to_owned(), reason };
    let mut reader = BufReader::new(open_input(file).map_err(io)?);
    let mut header = [0; HEADER_BYTES];
    reader.read_exact(&mut header).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => fail("shorter than its header".into()),
        _ => io(error),
    })?;
    if header[..4] != MAGIC {
        return Err(fail("the magic bytes 'PIEH' are missing".into()));
    }
    let size = size(&header).ok_or_else(|| fail("width or height is not plausible".into()))?;
    if size != expected {
        return Err(TracksError::Size { file: file.to_owned(), expected, found: size });
    }
    let needed = size.pixels() * 8;
    let mut bytes = Vec::new();
    let found = reader.take(needed as u64).read_to_end(&mut bytes).map_err(io)?;
    if found < needed {
        let ImageSize { width, height } = size;
        return Err(fail(format!("{width} x {height} needs {needed} bytes, found {found}")));
    }
    let flow = bytes.as_chunks::<8>().0.iter().map(|b| [float(*b, 0), float(*b, 4)]).collect();
    Ok(RawFlow { size, flow })
}

fn size(header: &[u8; HEADER_BYTES]) -> Option<ImageSize> {
    let int = |i: usize| i32::from_le_bytes([header[i], header[i + 1], header[i + 2], header[i + 3]]);
    let side = |v: i32| usize::try_from(v).ok().filter(|v| (1..=1 << 16).contains(v));
    Some(ImageSize { width: side(int(4))?, height: side(int(8))? })
}

fn float(bytes: [u8; 8], at: usize) -> f32 {
    f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}
