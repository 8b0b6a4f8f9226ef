//! Layout: magic (8 bytes), version u32, payload length u64, payload, CRC-32 of all before it; little-endian.

use crate::bytes::{Cursor, put_f32s, put_f64s, put_text, put_u64};
use crate::error::InFile;
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, open_input, write_atomically};
use glam::{DMat3, DVec3};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::Path;

const MAGIC: &[u8; 8] = b"FFGSCKPT";
/// 2 added the last steps, 3 ids and information, 4 the flexibility, 5 what was hidden and known of the static layer, 6 what is put aside; older ones are
/// still read.
const VERSION: u32 = 6;
const HEAD: usize = 20;
const CHECKSUM: usize = 4;

/// All that the next frame needs: a run that continues from it ends with the same bytes as one never stopped.
/// Floats are kept bit by bit (NaN payloads and signed zeros too).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameState<'a> {
    /// The frame this is the state after.
    pub frame: u64,
    /// Static layer.
    pub static_layer: Cow<'a, Gaussians>,
    /// Dynamic layer.
    pub dynamic_layer: Cow<'a, Gaussians>,
    /// Position covariances of the dynamic layer (m^2).
    pub dynamic_covariances: Vec<DMat3>,
    /// Ids of the dynamic layer, which stay with a Gaussian over all frames.
    pub dynamic_ids: Vec<u32>,
    /// The first id that no Gaussian ever had.
    pub next_id: u32,
    /// Information (inverse variance) of each parameter of the dynamic layer but the positions, whose covariances stand
    /// above; empty when unknown.
    pub dynamic_information: Cow<'a, Gaussians>,
    /// Information of each parameter of the static layer; empty when unknown.
    pub static_information: Cow<'a, Gaussians>,
    /// Edge of a sky cube face (px); 0 without a sky.
    pub sky_face_size: usize,
    /// Sky texture, kept as it is.
    pub sky: Vec<f32>,
    /// Process noise of the last fused frame (m).
    pub q: f64,
    /// Last steps of the dynamic layer (m), for a prior of constant velocity; empty when unknown.
    pub dynamic_steps: Vec<DVec3>,
    /// Logarithm of the odds that a Gaussian of the dynamic layer departs from its rigid group; empty when unknown.
    pub dynamic_flexibility: Vec<f64>,
    /// Rounds in which each Gaussian of the static layer still is to be trained in full; empty when none is.
    pub static_hidden: Vec<u8>,
    /// Variance of SH coefficient 0 and of each other coefficient of the static layer; empty when unknown.
    pub static_colours: Vec<[f32; 2]>,
    /// Indices of the Gaussians of the static layer that are put aside in this frame, while others stand in their places.
    pub aside: Vec<u32>,
    /// The Gaussians that are put aside.
    pub aside_layer: Cow<'a, Gaussians>,
    /// Further real state by name.
    pub reals: BTreeMap<String, f64>,
    /// Further integer state by name (iteration counts, random-number positions).
    pub integers: BTreeMap<String, u64>,
}

/// Writes a checkpoint atomically.
///
/// # Errors
/// When the file cannot be written.
pub fn save_checkpoint(path: &Path, state: &FrameState) -> Result<(), SplatError> {
    for layer in [&state.static_layer, &state.dynamic_layer] {
        layer.validate().map_err(|e| Problem::Shape(e.to_string())).in_file(path)?;
    }
    let payload = encode(state);
    let mut bytes = Vec::with_capacity(HEAD + payload.len() + CHECKSUM);
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    put_u64(&mut bytes, payload.len() as u64);
    bytes.extend(payload);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    write_atomically(path, |out| out.write_all(&bytes)).in_file(path)
}

/// Reads a checkpoint; a truncated or altered file, one of another version, or one whose columns do not go together,
/// is an error.
///
/// # Errors
/// When the file cannot be read, is no state file of a version that is known, or is damaged.
pub fn load_checkpoint(path: &Path) -> Result<FrameState<'static>, SplatError> {
    let mut bytes = Vec::new();
    open_input(path).and_then(|mut file| file.read_to_end(&mut bytes)).in_file(path)?;
    payload(&bytes).and_then(|(version, payload)| decode(version, payload)).in_file(path)
}

/// Version and payload of a file.
fn payload(bytes: &[u8]) -> Result<(u32, &[u8]), Problem> {
    if !bytes.starts_with(MAGIC) {
        return Err(Problem::Header("this is not a checkpoint".into()));
    }
    let short = || Problem::Truncated(format!("{} bytes are too few for a checkpoint", bytes.len()));
    let (body, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or_else(short)?;
    let (head, payload) = body.split_at_checked(HEAD).ok_or_else(short)?;
    let mut cursor = Cursor(&head[MAGIC.len() + 4..]);
    let version = &head[MAGIC.len()..MAGIC.len() + 4];
    let known = (1..=VERSION).find(|v| v.to_le_bytes() == version);
    let version = known
        .ok_or_else(|| Problem::Header(format!("checkpoint version {version:?} is not 1 to {VERSION}")))?;
    let length = cursor.u64()?;
    if length != payload.len() as u64 {
        return Err(Problem::Truncated(format!("{} of {length} payload bytes", payload.len())));
    }
    if crc32fast::hash(body).to_le_bytes() != *checksum {
        return Err(Problem::Corrupt("the checksum differs".into()));
    }
    Ok((version, payload))
}

fn encode(state: &FrameState) -> Vec<u8> {
    let mut out = Vec::new();
    put_u64(&mut out, state.frame);
    put_layer(&mut out, &state.static_layer);
    put_layer(&mut out, &state.dynamic_layer);
    put_u64(&mut out, state.dynamic_covariances.len() as u64);
    state.dynamic_covariances.iter().for_each(|m| put_f64s(&mut out, &m.to_cols_array()));
    put_u64(&mut out, state.sky_face_size as u64);
    put_u64(&mut out, state.sky.len() as u64);
    put_f32s(&mut out, &state.sky);
    put_f64s(&mut out, [&state.q]);
    put_u64(&mut out, state.reals.len() as u64);
    for (name, value) in &state.reals {
        put_text(&mut out, name);
        put_f64s(&mut out, [value]);
    }
    put_u64(&mut out, state.integers.len() as u64);
    for (name, &value) in &state.integers {
        put_text(&mut out, name);
        put_u64(&mut out, value);
    }
    put_u64(&mut out, state.dynamic_steps.len() as u64);
    state.dynamic_steps.iter().for_each(|s| put_f64s(&mut out, &s.to_array()));
    put_u64(&mut out, state.dynamic_ids.len() as u64);
    state.dynamic_ids.iter().for_each(|id| out.extend(id.to_le_bytes()));
    put_u64(&mut out, u64::from(state.next_id));
    put_layer(&mut out, &state.dynamic_information);
    put_layer(&mut out, &state.static_information);
    put_u64(&mut out, state.dynamic_flexibility.len() as u64);
    put_f64s(&mut out, &state.dynamic_flexibility);
    put_u64(&mut out, state.static_hidden.len() as u64);
    out.extend(&state.static_hidden);
    put_u64(&mut out, state.static_colours.len() as u64);
    put_f32s(&mut out, state.static_colours.as_flattened());
    put_u64(&mut out, state.aside.len() as u64);
    state.aside.iter().for_each(|index| out.extend(index.to_le_bytes()));
    put_layer(&mut out, &state.aside_layer);
    out
}

fn put_layer(out: &mut Vec<u8>, layer: &Gaussians) {
    put_u64(out, layer.len() as u64);
    put_u64(out, layer.sh_degree() as u64);
    put_f32s(out, layer.means.as_flattened());
    put_f32s(out, layer.quats.as_flattened());
    put_f32s(out, layer.log_scales.as_flattened());
    put_f32s(out, &layer.opacity_logits);
    put_f32s(out, layer.sh.as_flattened());
}

fn decode(version: u32, payload: &[u8]) -> Result<FrameState<'static>, Problem> {
    let mut cursor = Cursor(payload);
    let frame = cursor.u64()?;
    let static_layer = Cow::Owned(layer(&mut cursor)?);
    let dynamic_layer: Cow<Gaussians> = Cow::Owned(layer(&mut cursor)?);
    let count = cursor.length()?;
    let dynamic_covariances = cursor.f64_rows::<9>(count)?.iter().map(DMat3::from_cols_array).collect();
    let sky_face_size = cursor.length()?;
    let texels = cursor.length()?;
    let sky = cursor.f32s(texels)?;
    let q = cursor.f64()?;
    let reals = named(&mut cursor, Cursor::f64)?;
    let integers = named(&mut cursor, Cursor::u64)?;
    let steps = if version >= 2 { cursor.length()? } else { 0 };
    let dynamic_steps = cursor.f64_rows::<3>(steps)?.into_iter().map(DVec3::from_array).collect();
    let (dynamic_ids, next_id) = ids(version, &mut cursor, dynamic_layer.len())?;
    let mut information = || if version >= 3 { layer(&mut cursor) } else { Ok(Gaussians::default()) };
    let (dynamic_information, static_information) = (Cow::Owned(information()?), Cow::Owned(information()?));
    let odds = if version >= 4 { cursor.length()? } else { 0 };
    let dynamic_flexibility = cursor.f64_rows::<1>(odds)?.into_iter().map(|[v]| v).collect();
    let hidden = if version >= 5 { cursor.length()? } else { 0 };
    let static_hidden = cursor.bytes(hidden)?.to_vec();
    let colours = if version >= 5 { cursor.length()? } else { 0 };
    let static_colours = cursor.f32_rows::<2>(colours)?;
    let places = if version >= 6 { cursor.length()? } else { 0 };
    let aside = cursor.u32s(places)?;
    let aside_layer = Cow::Owned(if version >= 6 { layer(&mut cursor)? } else { Gaussians::default() });
    if !cursor.0.is_empty() {
        return Err(Problem::Corrupt(format!("{} bytes too many", cursor.0.len())));
    }
    let state = FrameState {
        frame,
        static_layer,
        dynamic_layer,
        dynamic_covariances,
        dynamic_ids,
        next_id,
        dynamic_information,
        static_information,
        sky_face_size,
        sky,
        q,
        dynamic_steps,
        dynamic_flexibility,
        static_hidden,
        static_colours,
        aside,
        aside_layer,
        reals,
        integers,
    };
    check_lengths(&state).map(|()| state)
}

/// A sky has the texels of its faces, and every dynamic Gaussian the same columns or none of them does.
fn check_lengths(state: &FrameState) -> Result<(), Problem> {
    let texels = state.sky_face_size.checked_pow(2).and_then(|texels| texels.checked_mul(18));
    if texels != Some(state.sky.len()) {
        let (face, found) = (state.sky_face_size, state.sky.len());
        return Err(Problem::Corrupt(format!("a sky of faces of {face} px holds {found} values")));
    }
    let (fixed, moving) = (state.static_layer.len(), state.dynamic_layer.len());
    for (what, found, n) in [
        ("covariances", state.dynamic_covariances.len(), moving),
        ("last steps", state.dynamic_steps.len(), moving),
        ("ids", state.dynamic_ids.len(), moving),
        ("values of flexibility", state.dynamic_flexibility.len(), moving),
        ("rows of information", state.dynamic_information.len(), moving),
        ("rows of information", state.static_information.len(), fixed),
        ("counts of rounds", state.static_hidden.len(), fixed),
        ("variances of colours", state.static_colours.len(), fixed),
    ] {
        if found != 0 && found != n {
            return Err(Problem::Corrupt(format!("{found} {what} of {n} Gaussians")));
        }
    }
    let (places, aside) = (state.aside.len(), state.aside_layer.len());
    if places != aside {
        return Err(Problem::Corrupt(format!("{aside} Gaussians of {places} places are put aside")));
    }
    match state.aside.iter().find(|index| **index as usize >= fixed) {
        Some(index) => Err(Problem::Corrupt(format!("Gaussian {index} of {fixed} is put aside"))),
        None => Ok(()),
    }
}

/// Ids and the next free one; versions before 3 had none, and their Gaussians are numbered.
fn ids(version: u32, cursor: &mut Cursor<'_>, n: usize) -> Result<(Vec<u32>, u32), Problem> {
    if version < 3 {
        return Ok(((0..n as u32).collect(), n as u32));
    }
    let count = cursor.length()?;
    let ids = cursor.u32s(count)?;
    let next = cursor.u64()?;
    let next = u32::try_from(next).map_err(|_| Problem::Corrupt(format!("next id {next}")))?;
    Ok((ids, next))
}

fn layer(cursor: &mut Cursor<'_>) -> Result<Gaussians, Problem> {
    let n = cursor.length()?;
    let degree = cursor.length()?;
    if degree > 3 {
        return Err(Problem::Corrupt(format!("SH degree {degree}")));
    }
    let mut out = Gaussians::empty(degree);
    out.means = cursor.f32_rows(n)?;
    out.quats = cursor.f32_rows(n)?;
    out.log_scales = cursor.f32_rows(n)?;
    out.opacity_logits = cursor.f32s(n)?;
    out.sh = cursor.f32_rows(n.saturating_mul(out.sh_stride()))?;
    Ok(out)
}

fn named<'a, T>(
    cursor: &mut Cursor<'a>,
    value: impl Fn(&mut Cursor<'a>) -> Result<T, Problem>,
) -> Result<BTreeMap<String, T>, Problem> {
    let count = cursor.u64()?;
    (0..count).map(|_| Ok((cursor.text()?, value(cursor)?))).collect()
}
