//! SPZ version 4 (github.com/nianticlabs/spz, README "File Format"): a plain header, a table of contents and one zstd stream
//! per attribute. Coordinates are kept as they are; the format's own RUB convention only matters between programs that
//! rename axes.

use crate::bytes::Cursor;
use crate::error::InFile;
use crate::format::Format;
use crate::quantise::{from_smallest_three, smallest_three, to_byte};
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, PixelFilter, logit, read_bytes, sigmoid, write_atomically};
use std::f32::consts::FRAC_1_SQRT_2;
use std::io::{Read, Write};
use std::path::Path;

pub(crate) const FORMAT: Format = Format {
    name: "spz",
    summary: "players of Niantic's SPZ, version 4",
    extension: ".spz",
    write: |file, splats| write_spz(file, splats.gaussians),
    read: Some(read_spz),
};

const MAGIC: &[u8; 4] = b"NGSP";
const VERSION: u32 = 4;
const HEAD: usize = 32;
/// The Gaussians of the largest memory that is sold take less.
const MAX_BYTES: u64 = 1 << 36;
/// Flag of files trained with the opacity compensation.
const ANTIALIASED: u8 = 1;
/// Fraction bits of a position that other writers use; more only where Gaussians are small.
const FRACTION_BITS: u32 = 12;
/// Positions are integers of so many bits.
const POSITION_BITS: u32 = 24;
/// A position's step is at most this share of the standard deviation of small Gaussians.
const STEP_PER_DEVIATION: f32 = 0.125;
/// Logarithmic scales: `byte / SCALE_STEPS - SCALE_OFFSET`.
const SCALE_STEPS: f32 = 16.0;
const SCALE_OFFSET: f32 = 10.0;
/// Constant coefficient: `(byte / 255 - 0.5) / COLOUR_SCALE`.
const COLOUR_SCALE: f32 = 0.15;
/// Largest magnitude of a rotation's component: nine bits.
const ROTATION_TOP: f32 = 511.0;
/// Compression level of the reference implementation.
const LEVEL: i32 = 12;
/// Opacities that a byte rounds to 0 or 1 come back as these logits' probabilities.
const LEAST_OPACITY: f32 = 1e-6;

/// Bits kept of the eight of a coefficient of degree 1, and of degrees 2 and 3, as in the reference implementation.
const SH_BITS: [u32; 2] = [5, 4];

/// Writes an SPZ file. Positions are rounded to a quarter of a millimetre in the capture's unit, or more finely where the
/// Gaussians are small, or more coarsely where they would not fit.
///
/// # Errors
/// When the columns do not match, or the file cannot be written.
fn write_spz(path: &Path, gaussians: &Gaussians) -> Result<(), SplatError> {
    let bytes = encode_spz(gaussians).in_file(path)?;
    write_atomically(path, |out| out.write_all(&bytes)).in_file(path)
}

/// Reads an SPZ file of version 4.
///
/// # Errors
/// When the file cannot be read, is of another version, truncated or corrupt.
fn read_spz(path: &Path) -> Result<Gaussians, SplatError> {
    let bytes = read_bytes(path, MAX_BYTES).in_file(path)?;
    decode_spz(&bytes).in_file(path)
}

/// The bytes of an SPZ file.
///
/// # Errors
/// When the columns do not match.
fn encode_spz(gaussians: &Gaussians) -> Result<Vec<u8>, Problem> {
    gaussians.validate().map_err(|e| Problem::Shape(e.to_string()))?;
    let fraction = fraction_bits(gaussians);
    let streams = streams(gaussians, fraction);
    let packed: Vec<Vec<u8>> =
        streams.iter().map(|s| zstd::bulk::compress(s, LEVEL)).collect::<Result<_, _>>()?;
    let mut out = Vec::new();
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend((gaussians.len() as u32).to_le_bytes());
    let flags = match gaussians.filter {
        PixelFilter::Compensated => ANTIALIASED,
        PixelFilter::Plain => 0,
    };
    out.extend([gaussians.sh_degree() as u8, fraction as u8, flags, streams.len() as u8]);
    out.extend((HEAD as u32).to_le_bytes());
    out.resize(HEAD, 0);
    for (plain, packed) in streams.iter().zip(&packed) {
        out.extend((packed.len() as u64).to_le_bytes());
        out.extend((plain.len() as u64).to_le_bytes());
    }
    packed.iter().for_each(|p| out.extend(p));
    Ok(out)
}

/// Positions, opacities, colours, scales, rotations and, above degree 0, harmonics.
fn streams(g: &Gaussians, fraction: u32) -> Vec<Vec<u8>> {
    let unit = (1_u64 << fraction) as f32;
    let position = |v: &f32| ((v * unit).round() as i32).to_le_bytes().into_iter().take(3);
    let colour = |sh: &[[f32; 3]]| sh[0].map(|v| to_byte(v * COLOUR_SCALE * 255.0 + 127.5));
    let scale = |s: &f32| to_byte((s + SCALE_OFFSET) * SCALE_STEPS);
    let mut out = vec![
        g.means.as_flattened().iter().flat_map(position).collect(),
        g.opacity_logits.iter().map(|&o| to_byte(sigmoid(o) * 255.0)).collect(),
        g.sh.chunks_exact(g.sh_stride()).flat_map(colour).collect(),
        g.log_scales.as_flattened().iter().map(scale).collect(),
        g.quats.iter().flat_map(|&q| rotation(q).to_le_bytes()).collect(),
    ];
    if g.sh_degree() > 0 {
        let bucket = |k: usize| 1 << (8 - SH_BITS[usize::from(k >= 4)]);
        let row = |sh: &[[f32; 3]]| -> Vec<u8> {
            let rows = sh.iter().enumerate().skip(1);
            rows.flat_map(|(k, rgb)| rgb.map(|v| harmonic(v, bucket(k)))).collect()
        };
        out.push(g.sh.chunks_exact(g.sh_stride()).flat_map(row).collect());
    }
    out
}

/// Fraction bits: those of other writers, more where the smallest twentieth of the Gaussians would move visibly, fewer where
/// the scene would not fit.
fn fraction_bits(g: &Gaussians) -> u32 {
    let far = g.means.as_flattened().iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let mut widths: Vec<f32> =
        g.log_scales.iter().map(|s| s.iter().fold(f32::NEG_INFINITY, |m, &v| m.max(v))).collect();
    widths.sort_unstable_by(f32::total_cmp);
    let small = widths.get(widths.len() / 20).map_or(1.0, |s| s.exp());
    let wanted = (1.0 / (STEP_PER_DEVIATION * small)).log2().ceil().max(FRACTION_BITS as f32) as u32;
    let room = (POSITION_BITS - 1) as f32 - far.max(f32::MIN_POSITIVE).log2().floor() - 1.0;
    wanted.min(room.clamp(0.0, POSITION_BITS as f32 - 1.0) as u32)
}

fn harmonic(value: f32, bucket: i32) -> u8 {
    let byte = (value * 128.0).round() as i32 + 128;
    // The middle of a bucket, so that 0 stays 0.
    ((byte + bucket / 2).div_euclid(bucket) * bucket).clamp(0, 255) as u8
}

/// Ten bits for each of the three smaller components in the order x, y, z, w: a sign and nine of magnitude.
fn rotation([w, x, y, z]: [f32; 4]) -> u32 {
    let identity = [w, x, y, z].iter().all(|v| *v == 0.0);
    let (largest, rest) = smallest_three(if identity { [0.0, 0.0, 0.0, 1.0] } else { [x, y, z, w] });
    rest.iter().fold(largest as u32, |word, v| {
        let magnitude = (ROTATION_TOP * v.abs() / FRAC_1_SQRT_2 + 0.5) as u32;
        word << 10 | u32::from(*v < 0.0) << 9 | magnitude.min(ROTATION_TOP as u32)
    })
}

fn unpack_rotation(word: u32) -> [f32; 4] {
    let component = |shift: u32| {
        let bits = word >> shift;
        let magnitude = FRAC_1_SQRT_2 * (bits & 511) as f32 / ROTATION_TOP;
        if bits & 512 == 0 { magnitude } else { -magnitude }
    };
    let [x, y, z, w] = from_smallest_three((word >> 30) as usize, [20, 10, 0].map(component));
    [w, x, y, z]
}

/// What the bytes of an SPZ file of version 4 hold. Nothing larger than a thousand times the file is allocated.
///
/// # Errors
/// When they are of another version, truncated or corrupt.
pub fn decode_spz(bytes: &[u8]) -> Result<Gaussians, Problem> {
    let header = Header::read(bytes)?;
    let mut out = Gaussians::empty(header.sh_degree).with_filter(header.filter);
    let n = header.count;
    let sizes = [9, 1, 3, 3, 4, 3 * (out.sh_stride() - 1)].map(|bytes_each| n.saturating_mul(bytes_each));
    let sizes = if header.sh_degree == 0 { &sizes[..5] } else { &sizes[..] };
    let streams = header.streams(bytes, sizes)?;
    let unit = (1_u64 << header.fraction) as f32;
    let position = |b: &[u8]| (i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) as f32 / unit;
    let rows3 = |stream: &[u8], value: &dyn Fn(u8) -> f32| -> Vec<[f32; 3]> {
        stream.chunks_exact(3).map(|b| [value(b[0]), value(b[1]), value(b[2])]).collect()
    };
    out.means = streams[0].chunks_exact(9).map(|b| [0, 3, 6].map(|i| position(&b[i..]))).collect();
    let opacity = |b: &u8| logit((f32::from(*b) / 255.0).clamp(LEAST_OPACITY, 1.0 - LEAST_OPACITY));
    out.opacity_logits = streams[1].iter().map(opacity).collect();
    let colours = rows3(&streams[2], &|b| (f32::from(b) / 255.0 - 0.5) / COLOUR_SCALE);
    out.log_scales = rows3(&streams[3], &|b| f32::from(b) / SCALE_STEPS - SCALE_OFFSET);
    let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    out.quats = streams[4].chunks_exact(4).map(|b| unpack_rotation(word(b))).collect();
    let rest = streams.get(5).map(|s| rows3(s, &|b| (f32::from(b) - 128.0) / 128.0)).unwrap_or_default();
    let above = out.sh_stride() - 1;
    for (i, dc) in colours.iter().enumerate() {
        out.sh.push(*dc);
        out.sh.extend_from_slice(&rest[i * above..(i + 1) * above]);
    }
    Ok(out)
}

struct Header {
    count: usize,
    sh_degree: usize,
    fraction: u32,
    filter: PixelFilter,
    streams: usize,
    contents: usize,
}

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, Problem> {
        let head = bytes.first_chunk::<HEAD>();
        let head = head.ok_or_else(|| Problem::Truncated("fewer bytes than an SPZ header".into()))?;
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        if !head.starts_with(MAGIC) {
            return Err(Problem::Header("this is not an SPZ file of version 4".into()));
        }
        if word(4) != VERSION {
            return Err(Problem::Header(format!("SPZ version {} is not {VERSION}", word(4))));
        }
        let [sh_degree, fraction, flags, streams] = [head[12], head[13], head[14], head[15]];
        if sh_degree > 3 || u32::from(fraction) >= POSITION_BITS {
            return Err(Problem::Header(format!("SH degree {sh_degree}, {fraction} fraction bits")));
        }
        Ok(Self {
            count: word(8) as usize,
            sh_degree: sh_degree.into(),
            fraction: fraction.into(),
            filter: if flags & ANTIALIASED == 0 { PixelFilter::Plain } else { PixelFilter::Compensated },
            streams: streams.into(),
            contents: word(16) as usize,
        })
    }

    /// The streams, each of the size that the count of Gaussians asks for.
    fn streams(&self, bytes: &[u8], sizes: &[usize]) -> Result<Vec<Vec<u8>>, Problem> {
        let cut = || Problem::Truncated("a stream ends early".into());
        if self.streams != sizes.len() {
            return Err(Problem::Corrupt(format!("{} streams, not {}", self.streams, sizes.len())));
        }
        let mut contents = Cursor(bytes.get(self.contents..).ok_or_else(cut)?);
        let table: Vec<[usize; 2]> = (0..self.streams)
            .map(|_| Ok([contents.length()?, contents.length()?]))
            .collect::<Result<_, Problem>>()?;
        let mut rest = contents.0;
        let mut out = Vec::new();
        for ([packed, plain], &size) in table.into_iter().zip(sizes) {
            let (stream, tail) = rest.split_at_checked(packed).ok_or_else(cut)?;
            rest = tail;
            if plain != size {
                return Err(Problem::Corrupt(format!("a stream of {plain} bytes, not {size}")));
            }
            out.push(inflate(stream, plain)?);
        }
        Ok(out)
    }
}

/// Decompresses exactly `size` bytes; memory grows with what is really there, not with what a header claims.
fn inflate(stream: &[u8], size: usize) -> Result<Vec<u8>, Problem> {
    let mut out = Vec::new();
    let reader = zstd::stream::read::Decoder::new(stream)?;
    reader.take(size as u64 + 1).read_to_end(&mut out).map_err(|e| Problem::Corrupt(e.to_string()))?;
    if out.len() == size { Ok(out) } else { Err(Problem::Corrupt("a stream has another size".into())) }
}
