//! The header of an npy file: version, dtype and shape. Shapes of damaged files are checked before they are multiplied.

use crate::Cause;
use std::io::{self, ErrorKind, Read};

/// numpy's own headers are below 64 KiB; longer ones are damaged or hostile.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// The header of an npy file. npyz's parser multiplies the declared shape unchecked, which a damaged file turns
/// into a panic; hence this one.
#[derive(Debug)]
pub(crate) struct Header {
    pub dtype: Dtype,
    pub fortran_order: bool,
    pub shape: Vec<usize>,
}

/// A plain numeric dtype such as `<f4`.
#[derive(Clone, Debug)]
pub(crate) struct Dtype {
    pub big_endian: bool,
    pub kind: char,
    pub size: usize,
    pub text: String,
}

impl Header {
    /// Reads magic, version, length and dictionary; leaves the reader at the data.
    pub(crate) fn read(reader: &mut impl Read) -> Result<Self, Cause> {
        let mut start = [0; 8];
        reader.read_exact(&mut start).map_err(|error| unread(error, "shorter than 8 bytes"))?;
        if &start[..6] != b"\x93NUMPY" {
            return Err(Cause::Header("the magic bytes are missing".into()));
        }
        let length = read_length(reader, start[6])?;
        if length > MAX_HEADER_BYTES {
            return Err(Cause::Header(format!("length {length} is not plausible")));
        }
        let mut text = vec![0; length];
        reader.read_exact(&mut text).map_err(|error| unread(error, "truncated"))?;
        Self::parse(&String::from_utf8_lossy(&text).replace('"', "'"))
    }

    fn parse(text: &str) -> Result<Self, Cause> {
        let bad = |what: &str| Cause::Header(format!("no {what} in {text:?}"));
        let descr = after(text, "'descr'").ok_or_else(|| bad("descr"))?;
        let quoted = descr.strip_prefix('\'').and_then(|d| d.split_once('\''));
        let dtype = Dtype::parse(quoted.ok_or_else(|| Cause::Dtype(descr.chars().take(40).collect()))?.0)?;
        let order = after(text, "'fortran_order'").ok_or_else(|| bad("fortran_order"))?;
        let shape = after(text, "'shape'").and_then(parse_shape).ok_or_else(|| bad("shape"))?;
        Ok(Self { dtype, fortran_order: order.starts_with("True"), shape })
    }
}

impl Dtype {
    fn parse(text: &str) -> Result<Self, Cause> {
        let refuse = || Cause::Dtype(text.to_owned());
        let mut rest = text.chars();
        let order = rest.next().filter(|c| "<>|=".contains(*c)).ok_or_else(refuse)?;
        let kind = rest.next().ok_or_else(refuse)?;
        let size = rest.as_str().parse().map_err(|_| refuse())?;
        let known = matches!((kind, size), ('f', 2 | 4 | 8) | ('i' | 'u', 1 | 2 | 4 | 8) | ('b', 1));
        let big_endian = order == '>' || (order == '=' && cfg!(target_endian = "big"));
        if known { Ok(Self { big_endian, kind, size, text: text.to_owned() }) } else { Err(refuse()) }
    }
}

/// A file that ends too early is damaged; one that the system cannot read may be sound.
fn unread(error: io::Error, damage: &str) -> Cause {
    if error.kind() == ErrorKind::UnexpectedEof { Cause::Header(damage.into()) } else { Cause::Io(error) }
}

fn read_length(reader: &mut impl Read, version: u8) -> Result<usize, Cause> {
    let mut bytes = [0; 4];
    let count = match version {
        1 => 2,
        2 | 3 => 4,
        v => return Err(Cause::Header(format!("version {v} is unknown"))),
    };
    reader.read_exact(&mut bytes[..count]).map_err(|error| unread(error, "truncated"))?;
    Ok(u32::from_le_bytes(bytes) as usize)
}

/// The text behind `key:`.
fn after<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    Some(text.split_once(key)?.1.trim_start().strip_prefix(':')?.trim_start())
}

fn parse_shape(text: &str) -> Option<Vec<usize>> {
    let inside = text.strip_prefix('(')?.split_once(')')?.0;
    let axes = inside.split(',').map(|axis| axis.trim().trim_end_matches('L'));
    axes.filter(|axis| !axis.is_empty()).map(|axis| axis.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk that gives some bytes and then fails.
    struct Failing<'a>(&'a [u8]);

    impl Read for Failing<'_> {
        fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
            if self.0.is_empty() { Err(io::Error::other("broken disk")) } else { self.0.read(out) }
        }
    }

    #[test]
    fn a_disk_that_fails_is_not_taken_for_a_damaged_file() {
        let start = b"\x93NUMPY\x01\x00\x76\x00{'descr'";
        for length in [0, 6, 8, 9, 10, 15] {
            let error = |cause: Result<Header, Cause>| cause.unwrap_err().to_string();
            let failed = error(Header::read(&mut Failing(&start[..length])));
            assert_eq!(failed, "broken disk", "after {length} bytes");
            let ended = error(Header::read(&mut &start[..length]));
            assert!(ended.contains("not a readable npy header"), "after {length} bytes: {ended}");
        }
    }
}
