use crate::TracksError;
use crate::dense::RawFlow;
use exr::meta::MetaData;
use exr::prelude::{FlatImage, FlatSamples, ReadChannels, ReadLayers, read};
use ffgs_core::ImageSize;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The reader allocates what the header says: larger images are damaged or hostile.
const MAX_PIXELS: usize = 1 << 27;

/// Reads the channels U, V (any case, f16, f32 or u32; also `LAYER.U`) of an OpenEXR image.
pub(crate) fn read_exr(file: &Path) -> Result<RawFlow, TracksError> {
    let open = File::open(file).map_err(|source| TracksError::Io { file: file.to_owned(), source })?;
    let fail = |reason: String| TracksError::Flow { file: file.to_owned(), reason };
    check_size(file).map_err(fail)?;
    let reader =
        read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    // Single-threaded: views are read in parallel.
    let image: FlatImage =
        reader.non_parallel().from_buffered(BufReader::new(open)).map_err(|e| fail(e.to_string()))?;
    flow_of(&image).map_err(fail)
}

fn check_size(file: &Path) -> Result<(), String> {
    let meta = MetaData::read_from_file(file, true).map_err(|e| e.to_string())?;
    let pixels = |size: (usize, usize)| size.0.checked_mul(size.1).filter(|n| *n <= MAX_PIXELS);
    let plausible = meta.headers.iter().all(|h| pixels((h.layer_size.0, h.layer_size.1)).is_some());
    if plausible { Ok(()) } else { Err("the image size is not plausible".into()) }
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
    samples.values_as_f32().collect()
}
