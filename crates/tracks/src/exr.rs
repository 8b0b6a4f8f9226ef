//! Optical flow in OpenEXR images, as renderers write it.

use crate::error::TracksError;
use crate::flow::{FlowFormat, RawFlow};
use ::exr::meta::MetaData;
use ::exr::prelude::{FlatImage, FlatSamples, ReadChannels, ReadLayers, read as read_image};
use ffgs_core::{ImageSize, open_input};
use half::slice::HalfFloatSliceExt;
use std::io::{BufReader, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Bytes per pixel of all layers and channels together: the reader unpacks them all, and a renderer may have written
/// many beside the flow.
const MAX_BYTES_PER_PIXEL: usize = 256;

/// Flow in an OpenEXR image.
pub(crate) const EXR: FlowFormat =
    FlowFormat { name: "exr", summary: "optical flow in the channels U, V of an OpenEXR image", read };

/// Reads the channels U, V (any case, f16, f32 or u32; also `LAYER.U`) of an OpenEXR image. Another size than
/// `expected` is refused from the header.
fn read(file: &Path, expected: ImageSize) -> Result<RawFlow, TracksError> {
    let io = |source| TracksError::Io { file: file.to_owned(), source };
    let fail = |reason: String| TracksError::Flow { file: file.to_owned(), reason };
    let mut opened = BufReader::new(open_input(file).map_err(io)?);
    let found = caught(|| judge(&mut opened, expected)).map_err(fail)?;
    if found != expected {
        return Err(TracksError::Size { file: file.to_owned(), expected, found });
    }
    opened.rewind().map_err(io)?;
    caught(|| decode(opened)).map_err(fail)
}

/// The decoder's arithmetic overflows on some damaged files, a panic where overflow is checked.
fn caught<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    // What a panic may leave half-changed is not looked at again.
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err("the decoder gave up".into()))
}

/// The size of the image; an error where unpacking it would take more than a flow of that size has.
fn judge(opened: &mut BufReader<std::fs::File>, expected: ImageSize) -> Result<ImageSize, String> {
    let meta = MetaData::read_from_buffered(opened, true).map_err(|e| e.to_string())?;
    let first = meta.headers.first().ok_or("no layer")?.layer_size;
    let bytes = meta.headers.iter().try_fold(0_usize, |sum, header| {
        let pixels = header.layer_size.0.checked_mul(header.layer_size.1)?;
        sum.checked_add(pixels.checked_mul(header.channels.bytes_per_pixel)?)
    });
    let size = ImageSize { width: first.0, height: first.1 };
    let most = expected.pixels().saturating_mul(MAX_BYTES_PER_PIXEL);
    if size == expected && bytes.is_none_or(|bytes| bytes > most) {
        let channels: usize = meta.headers.iter().map(|h| h.channels.list.len()).sum();
        return Err(format!("{channels} channels in all are more than a flow's file has; keep U and V"));
    }
    Ok(size)
}

/// Reads every layer and takes the flow's channels.
fn decode(opened: BufReader<std::fs::File>) -> Result<RawFlow, String> {
    let reader =
        read_image().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    // Single-threaded: views are read in parallel.
    let image: FlatImage = reader.non_parallel().from_buffered(opened).map_err(|e| e.to_string())?;
    flow_of(&image)
}

fn flow_of(image: &FlatImage) -> Result<RawFlow, String> {
    let channels =
        || image.layer_data.iter().flat_map(|layer| layer.channel_data.list.iter().map(move |c| (layer, c)));
    let find = |wanted: &str| {
        channels().find(|(_, c)| {
            let name = c.name.to_string();
            name.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case(wanted))
        })
    };
    let names = || channels().map(|(_, c)| c.name.to_string()).collect::<Vec<_>>();
    let missing = |wanted: &str| format!("no channel {wanted}; the file holds {:?}", names());
    let (layer, u) = find("U").ok_or_else(|| missing("U"))?;
    let (_, v) = find("V").ok_or_else(|| missing("V"))?;
    let size = ImageSize { width: layer.size.0, height: layer.size.1 };
    let (u, v) = (values(&u.sample_data), values(&v.sample_data));
    if u.len() != size.pixels() || v.len() != size.pixels() {
        return Err(format!(
            "U has {} values and V {}, the image {} pixels",
            u.len(),
            v.len(),
            size.pixels()
        ));
    }
    Ok(RawFlow { size, flow: u.into_iter().zip(v).map(|(u, v)| [u, v]).collect() })
}

fn values(samples: &FlatSamples) -> Vec<f32> {
    match samples {
        FlatSamples::F16(values) => values.to_f32_vec(),
        FlatSamples::F32(values) => values.clone(),
        FlatSamples::U32(values) => values.iter().map(|&v| v as f32).collect(),
    }
}
