//! Reading of PLY splats, ASCII or binary, of any SH degree; damaged files are refused.

use crate::error::InFile;
use crate::ply_header::{Element, Encoding, Property, Scalar, read_header};
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, open_input, sh_coefficients};
use glam::DMat3;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read, Seek};
use std::path::Path;

/// A longer word in an ascii body is not a number.
const MAX_WORD_BYTES: usize = 64;

/// What a splat PLY holds.
#[derive(Clone, Debug, PartialEq)]
pub struct PlySplats {
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// Position covariances (m^2), one per Gaussian, when the file has them.
    pub covariances: Option<Vec<DMat3>>,
    /// Ids that stay with a Gaussian over all frames, when the file has them.
    pub ids: Option<Vec<u32>>,
}

/// Reads a 3DGS PLY, ascii or binary. Unknown properties and elements are skipped; the SH degree follows from the
/// number of `f_rest_*`. Truncated files, missing properties and values that are not finite are errors.
///
/// # Errors
/// When the file cannot be read, is no binary PLY of splats, or is damaged.
pub fn read_ply(path: &Path) -> Result<PlySplats, SplatError> {
    read_file(path).in_file(path)
}

fn read_file(path: &Path) -> Result<PlySplats, Problem> {
    let file = open_input(path)?;
    let length = file.metadata()?.len();
    let mut reader = BufReader::new(file);
    let header = read_header(&mut reader)?;
    let mut left = length.saturating_sub(reader.stream_position()?);
    let mut body = Body { reader, encoding: header.encoding };
    for element in &header.elements {
        left = room_for(element, header.encoding, left)?;
        if element.name == "vertex" {
            let mut out = read_vertices(&mut body, element)?;
            out.gaussians.filter = header.filter;
            return Ok(out);
        }
        for _ in 0..element.count {
            body.row(&element.properties, |_, _| ())?;
        }
    }
    Err(Problem::Header("no element `vertex`".into()))
}

/// Bytes left after `element`, so that a hostile count is refused before anything is allocated for it.
fn room_for(element: &Element, encoding: Encoding, left: u64) -> Result<u64, Problem> {
    if element.count > 0 && element.properties.is_empty() {
        return Err(Problem::Header(format!("element `{}` has no properties", element.name)));
    }
    // The last word of an ascii file may lack its line end.
    let needed = element.count.checked_mul(element.least_row_bytes(encoding)).map(|n| n.saturating_sub(1));
    match needed {
        Some(needed) if needed <= left => Ok(left - needed),
        _ => Err(Problem::Truncated(format!(
            "{} rows of `{}` do not fit in the {left} bytes left",
            element.count, element.name
        ))),
    }
}

/// Where the columns of a splat lie in a row: indices of properties.
struct Columns {
    mean: [usize; 3],
    quat: [usize; 4],
    log_scale: [usize; 3],
    opacity: usize,
    dc: [usize; 3],
    rest: Vec<usize>,
    covariance: Option<[usize; 6]>,
    id: Option<usize>,
    sh_degree: usize,
}

impl Columns {
    fn find(properties: &[Property]) -> Result<Self, Problem> {
        let find = |name: &str| {
            let found = properties.iter().position(|p| p.name == name && p.list_count.is_none());
            found.ok_or_else(|| Problem::MissingProperty(name.to_owned()))
        };
        let rest_count = properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        let sh_degree = (0..=3).find(|&d| 3 * (sh_coefficients(d) - 1) == rest_count);
        let sh_degree = sh_degree.ok_or_else(|| {
            Problem::Header(format!("{rest_count} `f_rest_*` properties; 0, 9, 24 or 45 are possible"))
        })?;
        let covariance = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"].map(find);
        Ok(Self {
            mean: all(["x", "y", "z"].map(find))?,
            quat: all(["rot_0", "rot_1", "rot_2", "rot_3"].map(find))?,
            log_scale: all(["scale_0", "scale_1", "scale_2"].map(find))?,
            opacity: find("opacity")?,
            dc: all(["f_dc_0", "f_dc_1", "f_dc_2"].map(find))?,
            rest: (0..rest_count).map(|i| find(&format!("f_rest_{i}"))).collect::<Result<_, _>>()?,
            covariance: all(covariance).ok(),
            id: find("id").ok(),
            sh_degree,
        })
    }

    fn needed(&self) -> Vec<usize> {
        let mut out = self.rest.clone();
        out.extend(self.mean.iter().chain(&self.quat).chain(&self.log_scale).chain(&self.dc));
        out.push(self.opacity);
        out.extend(self.covariance.iter().flatten());
        out
    }

    fn push(&self, row: &[f64], out: &mut PlySplats) {
        let g = &mut out.gaussians;
        let value = |column: usize| row[column] as f32;
        g.means.push(self.mean.map(value));
        g.quats.push(self.quat.map(value));
        g.log_scales.push(self.log_scale.map(value));
        g.opacity_logits.push(value(self.opacity));
        g.sh.push(self.dc.map(value));
        let per_channel = self.rest.len() / 3;
        for k in 0..per_channel {
            g.sh.push([0, 1, 2].map(|c| value(self.rest[c * per_channel + k])));
        }
        if let (Some(columns), Some(covariances)) = (self.covariance, &mut out.covariances) {
            let [xx, xy, xz, yy, yz, zz] = columns.map(|c| row[c]);
            covariances.push(DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]));
        }
        if let (Some(column), Some(ids)) = (self.id, &mut out.ids) {
            ids.push(row[column] as u32);
        }
    }
}

fn all<const N: usize>(found: [Result<usize, Problem>; N]) -> Result<[usize; N], Problem> {
    let mut out = [0; N];
    for (out, found) in out.iter_mut().zip(found) {
        *out = found?;
    }
    Ok(out)
}

fn read_vertices(body: &mut Body, element: &Element) -> Result<PlySplats, Problem> {
    let columns = Columns::find(&element.properties)?;
    let needed = columns.needed();
    let covariances = columns.covariance.map(|_| Vec::new());
    let ids = columns.id.map(|_| Vec::new());
    let mut out = PlySplats { gaussians: Gaussians::empty(columns.sh_degree), covariances, ids };
    let mut row = vec![0.0; element.properties.len()];
    for i in 0..element.count {
        body.row(&element.properties, |column, value| row[column] = value)?;
        // Tested after rounding to f32: what does not fit is infinite there.
        if let Some(&bad) = needed.iter().find(|&&c| !(row[c] as f32).is_finite()) {
            let name = &element.properties[bad].name;
            return Err(Problem::BadValue(format!("`{name}` of vertex {i} is not finite: {}", row[bad])));
        }
        columns.push(&row, &mut out);
    }
    Ok(out)
}

struct Body {
    reader: BufReader<File>,
    encoding: Encoding,
}

impl Body {
    /// Reads one row; `set` gets each single value with its property's index, lists are skipped.
    fn row(&mut self, properties: &[Property], mut set: impl FnMut(usize, f64)) -> Result<(), Problem> {
        for (column, property) in properties.iter().enumerate() {
            match property.list_count {
                None => set(column, self.value(property.scalar)?),
                Some(count) => {
                    let count = self.value(count)?;
                    for _ in 0..count as u64 {
                        self.value(property.scalar)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, Problem> {
        match self.encoding {
            Encoding::Ascii => self.word(),
            Encoding::LittleEndian => self.binary(scalar, false),
            Encoding::BigEndian => self.binary(scalar, true),
        }
    }

    fn binary(&mut self, scalar: Scalar, big_endian: bool) -> Result<f64, Problem> {
        let mut raw = [0; 8];
        let bytes = &mut raw[..scalar.bytes()];
        self.reader.read_exact(bytes).map_err(truncated)?;
        if big_endian {
            bytes.reverse();
        }
        let [a, b, c, d, ..] = raw;
        Ok(match scalar {
            Scalar::I8 => f64::from(a as i8),
            Scalar::U8 => f64::from(a),
            Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
            Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
            Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Scalar::F64 => f64::from_le_bytes(raw),
        })
    }

    fn word(&mut self) -> Result<f64, Problem> {
        let mut word = Vec::new();
        while let Some(&byte) = self.reader.fill_buf()?.first() {
            self.reader.consume(1);
            match (byte.is_ascii_whitespace(), word.is_empty()) {
                (true, true) => {}
                (true, false) => break,
                (false, _) => word.push(byte),
            }
            if word.len() > MAX_WORD_BYTES {
                break;
            }
        }
        let text = String::from_utf8_lossy(&word);
        match (text.is_empty(), text.parse()) {
            (true, _) => Err(Problem::Truncated("the last rows are missing".into())),
            (_, Ok(value)) => Ok(value),
            (_, Err(_)) => Err(Problem::BadValue(format!("`{text}` is not a number"))),
        }
    }
}

fn truncated(error: std::io::Error) -> Problem {
    match error.kind() {
        ErrorKind::UnexpectedEof => Problem::Truncated("the last rows are missing".into()),
        _ => Problem::Io(error),
    }
}
