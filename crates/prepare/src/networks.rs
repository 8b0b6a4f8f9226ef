//! Networks that track beside the trackers of this project.

use crate::removal::remove;
use crate::{PrepareError, Progress, tracker_list, tracks};
use ffgs_core::{ImageSize, TrackerLevel, read_text, write_atomically};
use ffgs_dataset::{Capture, Split};
use ffgs_networks::{Description, Motion, Network, NetworkError};
use std::io::{self, Write};
use std::path::Path;

/// In the folder of a network's tracks: the checksum of the network and its description.
const MARK: &str = "network";
const MAX_MARK_BYTES: u64 = 1 << 10;

/// Networks, ready to run.
pub(crate) struct Networks(Vec<Network>);

impl Networks {
    /// Loads those that descriptions or names describe.
    pub(crate) fn load(arguments: &[String]) -> Result<Self, PrepareError> {
        let mut out: Vec<Network> = Vec::new();
        for argument in arguments {
            let description = Description::of(argument)?;
            let taken = out.iter().map(|n| n.description().name.as_str()).chain(tracks::names());
            if taken.into_iter().any(|name| name == description.name) {
                let reason = format!("another tracker has the name '{}'; change one", description.name);
                return Err(NetworkError::Description { file: argument.into(), reason }.into());
            }
            out.push(Network::load(description, rayon::current_num_threads())?);
        }
        Ok(Self(out))
    }

    /// Removes tracks that other versions of these networks made. Returns whether one of them has not tracked yet.
    ///
    /// Tracks of another program under the name of a network are an error.
    pub(crate) fn announce(&self, capture: &Path) -> Result<bool, PrepareError> {
        let mut is_new = false;
        for network in &self.0 {
            let folder = capture.join("tracks").join(&network.description().name);
            let mark = mark(network);
            match read_text(&folder.join(MARK), MAX_MARK_BYTES) {
                Ok(known) if known == mark => continue,
                Ok(_) => remove(&folder)?,
                Err(_) if folder.exists() => {
                    let reason =
                        "tracks of another program have this name: remove them, or rename the network".into();
                    return Err(PrepareError::Output { folder, reason });
                }
                Err(_) => {}
            }
            is_new = true;
        }
        Ok(is_new)
    }

    /// Tracks every view and step whose files are missing, and lists the networks. Returns what was done.
    pub(crate) fn make(
        &mut self,
        capture: &Capture,
        progress: &dyn Progress,
    ) -> Result<String, PrepareError> {
        if capture.frames() < 2 {
            return Ok(String::new());
        }
        let made: Result<Vec<String>, PrepareError> =
            self.0.iter_mut().map(|network| make_one(network, capture, progress)).collect();
        Ok(made?.concat())
    }
}

fn make_one(
    network: &mut Network,
    capture: &Capture,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let Description { name, flow, .. } = network.description().clone();
    let (views, steps) = (capture.views(Split::Train).len(), capture.frames() - 1);
    let mut found = 0;
    // First, so that a later run knows for whose tracks these are.
    let file = capture.root().join("tracks").join(&name).join(MARK);
    write_atomically(&file, |w| w.write_all(mark(network).as_bytes()))
        .map_err(|e: io::Error| PrepareError::io(&file, e))?;
    for view in 0..views {
        for frame in 1..=steps {
            found += step(network, capture, view, frame)?;
            progress.advance(&name, view * steps + frame, views * steps);
        }
    }
    let (level, format) = (network.description().level(), if flow.is_some() { "flo" } else { "npz" });
    let level = match level {
        TrackerLevel::Sparse => "sparse",
        TrackerLevel::Medium => "medium",
        TrackerLevel::Dense => "dense",
    };
    tracker_list::add(capture.root(), &[tracker_list::entry(&name, level, format)])?;
    let mean = if flow.is_some() {
        String::new()
    } else {
        format!("; {} per view and frame", found / (views * steps))
    };
    Ok(format!("; {name} ({level}, network{mean})"))
}

fn mark(network: &Network) -> String {
    format!("{:08x}\n", network.checksum())
}

/// Folders below `tracks/` that networks made.
pub(crate) fn made_folders(capture: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(capture.join("tracks")).into_iter().flatten().flatten();
    let marked = entries.filter(|entry| entry.path().join(MARK).is_file());
    marked.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

/// Tracks one step of a view, unless its file is there. Returns the number of pairs.
fn step(network: &mut Network, capture: &Capture, view: usize, frame: usize) -> Result<usize, PrepareError> {
    let description = network.description();
    let camera = &capture.views(Split::Train)[view].name;
    let suffix = if description.flow.is_some() { "flo" } else { "npz" };
    let file = tracks::path(capture.root(), &description.name, camera, frame, suffix);
    if file.exists() {
        return Ok(0);
    }
    let picture = |frame| capture.load_image(Split::Train, view, frame);
    let (before, now) = (picture(frame - 1)?, picture(frame)?);
    match network.motion(&before, &now)? {
        Motion::Flow(flow) => write_flow(&file, now.size(), &flow).map(|()| 0),
        Motion::Tracks(found) => tracks::write(&file, &found).map(|()| found.src.len()),
    }
}

/// Middlebury's format: "PIEH", width, height, then (u, v) per pixel, little-endian.
fn write_flow(file: &Path, size: ImageSize, flow: &[[f32; 2]]) -> Result<(), PrepareError> {
    let sides = [size.width, size.height].map(|side| (side as i32).to_le_bytes());
    let body: Vec<u8> = flow.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let write = |w: &mut io::BufWriter<std::fs::File>| {
        w.write_all(b"PIEH")?;
        w.write_all(sides.as_flattened())?;
        w.write_all(&body)
    };
    write_atomically(file, write).map_err(|e: io::Error| PrepareError::io(file, e))
}
