//! The header of a PLY file: its encoding, elements and properties.

use crate::Problem;
use ffgs_core::PixelFilter;
use std::io::{BufRead, Read};

/// A header longer than this is not a splat file (ours has under 3 KiB).
const MAX_HEADER_BYTES: u64 = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(word: &str) -> Result<Self, Problem> {
        Ok(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(Problem::Header(format!("unknown type `{word}`"))),
        })
    }

    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Property {
    pub name: String,
    /// Type of the count in front of a list; `None` for a single value.
    pub list_count: Option<Scalar>,
    pub scalar: Scalar,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Least number of bytes of one row (an empty list still has its count).
    pub(crate) fn least_row_bytes(&self, encoding: Encoding) -> u64 {
        let bytes = |p: &Property| match encoding {
            Encoding::Ascii => 2,
            _ => p.list_count.unwrap_or(p.scalar).bytes() as u64,
        };
        self.properties.iter().map(bytes).sum()
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// As a comment says; plain without one.
    pub filter: PixelFilter,
}

/// Reads up to and including `end_header`.
pub(crate) fn read_header(reader: &mut impl BufRead) -> Result<Header, Problem> {
    let mut reader = reader.take(MAX_HEADER_BYTES);
    if next_line(&mut reader)? != "ply" {
        return Err(Problem::Header("the first line is not `ply`".into()));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut filter = PixelFilter::Plain;
    loop {
        let line = next_line(&mut reader)?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["comment", "SplatRenderMode:", "mip"] => filter = PixelFilter::Compensated,
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, _version] => encoding = Some(parse_encoding(name)?),
            ["element", name, count] => elements.push(parse_element(name, count)?),
            ["property", rest @ ..] => {
                let element = elements
                    .last_mut()
                    .ok_or_else(|| Problem::Header("`property` before any `element`".into()))?;
                element.properties.push(parse_property(rest, &line)?);
            }
            _ => return Err(Problem::Header(format!("line `{line}` is not understood"))),
        }
    }
    let encoding = encoding.ok_or_else(|| Problem::Header("no `format` line".into()))?;
    Ok(Header { encoding, elements, filter })
}

fn next_line(reader: &mut impl BufRead) -> Result<String, Problem> {
    let mut bytes = Vec::new();
    reader.read_until(b'\n', &mut bytes)?;
    if bytes.pop() != Some(b'\n') {
        return Err(Problem::Header("no `end_header` line".into()));
    }
    let line = String::from_utf8_lossy(&bytes);
    Ok(line.trim().chars().take(200).collect())
}

fn parse_encoding(name: &str) -> Result<Encoding, Problem> {
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        _ => Err(Problem::Header(format!("unknown format `{name}`"))),
    }
}

fn parse_element(name: &str, count: &str) -> Result<Element, Problem> {
    let bad = |_| Problem::Header(format!("element `{name}` has count `{count}`"));
    Ok(Element { name: name.to_owned(), count: count.parse().map_err(bad)?, properties: Vec::new() })
}

fn parse_property(words: &[&str], line: &str) -> Result<Property, Problem> {
    let (list_count, scalar, name) = match words {
        ["list", count, scalar, name] => (Some(Scalar::parse(count)?), scalar, name),
        [scalar, name] => (None, scalar, name),
        _ => return Err(Problem::Header(format!("line `{line}` is not understood"))),
    };
    if list_count.is_some_and(|c| !c.is_integer()) {
        return Err(Problem::Header(format!("the list count of `{name}` is not an integer")));
    }
    Ok(Property { name: (*name).to_owned(), list_count, scalar: Scalar::parse(scalar)? })
}

/// Line of a header that names the filter, as Brush and splat-transform read it; nothing for plain files.
pub(crate) fn ply_comment(filter: PixelFilter) -> &'static str {
    match filter {
        PixelFilter::Compensated => "comment SplatRenderMode: mip\n",
        PixelFilter::Plain => "",
    }
}
