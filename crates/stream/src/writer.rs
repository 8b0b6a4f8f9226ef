//! The encoder of the 4D stream: key frames, and between them motions of groups, residuals, births and deaths (docs/STREAM.md).

use crate::changed_rows::{count, encode_rows};
use crate::error::{InFile, Problem, StreamError};
use crate::frame_file::{Tag, checksum, encode};
use crate::layers::{Change, encode_change, encode_colours, encode_key, encode_uncertainty};
use crate::manifest::{Entry, FRAMES, MANIFEST, Manifest, cut_unfinished, read_entries};
use crate::motion::{Motion, Pair, clusters, nearest, robust_fit};
use crate::row::{MAX_GROUPS, Row};
use crate::steps::{Measures, Precision, Steps};
use crate::target::Target;
use ffgs_core::{Gaussians, refuse_link, spatial_order, write_atomically};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A frame to append.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Frame of the capture, behind those already written.
    pub frame: u64,
    /// What stands still. As long as its Gaussians keep their number and most their shape, only what changes is written.
    pub static_layer: &'a Gaussians,
    /// What moves.
    pub dynamic_layer: &'a Gaussians,
    /// Persistent name of each dynamic Gaussian: equal in two frames for the same one.
    pub ids: &'a [u32],
    /// How well each dynamic position is known (the capture's unit), when that is to be written.
    pub uncertainty: Option<&'a [f32]>,
    /// Equirectangular JPEG; written in key frames, and where it is given as changed.
    pub sky: &'a [u8],
    /// Whether the sky differs visibly from the last one written.
    pub sky_has_changed: bool,
    /// How much errors of each static and each dynamic Gaussian show: squared blending weights, summed over the pixels of some
    /// views; not negative. Without it all count alike.
    pub importance: Option<[&'a [f32]; 2]>,
}

impl<'a> Frame<'a> {
    fn static_target(&self, steps: &'a Steps) -> Target<'a> {
        Target::new(self.static_layer, steps, self.importance.map(|of| of[0]))
    }

    fn dynamic_target(&self, steps: &'a Steps) -> Target<'a> {
        Target::new(self.dynamic_layer, steps, self.importance.map(|of| of[1]))
    }
}

/// Appends frames to a stream. Memory is that of two frames.
#[derive(Debug)]
pub struct Writer {
    folder: PathBuf,
    manifest: Manifest,
    key_every: u64,
    /// Frames since the last key.
    since_key: u64,
    last_frame: Option<u64>,
    still: Option<Still>,
    moving: Option<Moving>,
    /// Whether what a decoder has is not known: a frame was encoded, and its files may not be there.
    failed: bool,
}

/// The static layer as last written.
#[derive(Debug)]
struct Still {
    /// In the last static key.
    base: Vec<Row>,
    now: Vec<Row>,
}

impl Still {
    /// Whether sending all of a layer is better than what has changed.
    fn is_far_from(&self, target: &Target, steps: &Steps) -> bool {
        let n = self.base.len();
        target.layer.len() != n || 2 * count(&self.base, steps, |i| target.measures(i)) > n
    }
}

/// The dynamic layer as last written.
#[derive(Debug)]
struct Moving {
    rows: Vec<Row>,
    ids: Vec<u32>,
}

impl Writer {
    /// Begins a stream in a folder that has none. `manifest` says everything but the steps, which are derived from the first
    /// frame; a key frame follows every `key_every` frames.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn create(
        folder: &Path,
        mut manifest: Manifest,
        first: [&Gaussians; 2],
        precision: [&Precision; 2],
        key_every: u64,
    ) -> Result<Self, StreamError> {
        manifest.stamp();
        manifest.static_steps = Steps::of(first[0], precision[0]);
        manifest.dynamic_steps = Steps::of(first[1], precision[1]);
        let path = folder.join(MANIFEST);
        let text = serde_json::to_string_pretty(&manifest).in_file(&path)? + "\n";
        write_atomically(&path, |out| out.write_all(text.as_bytes())).in_file(&path)?;
        Ok(Self::with(folder, manifest, key_every, None))
    }

    /// Goes on with a stream; its next frame is a key frame. A last line of the list that its writer did not finish is cut off.
    ///
    /// # Errors
    /// When the folder holds no readable stream, or the list cannot be cut.
    pub fn append(folder: &Path, key_every: u64) -> Result<Self, StreamError> {
        let manifest = Manifest::read(folder)?;
        cut_unfinished(folder)?;
        let entries = read_entries(folder)?;
        Ok(Self::with(folder, manifest, key_every, entries.last().map(|e| e.frame)))
    }

    fn with(folder: &Path, manifest: Manifest, key_every: u64, last_frame: Option<u64>) -> Self {
        let folder = folder.to_owned();
        Self {
            folder,
            manifest,
            key_every,
            since_key: 0,
            last_frame,
            still: None,
            moving: None,
            failed: false,
        }
    }

    /// What holds for all frames.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The last frame written.
    pub fn last_frame(&self) -> Option<u64> {
        self.last_frame
    }

    /// Writes a frame: its file, whole or not at all, and then its line in the list.
    ///
    /// # Errors
    /// When columns do not match or are not finite, the frame is not behind the last one, or a file cannot be written. After
    /// the last, every frame is refused: [`Writer::append`] finds out what is there and goes on with a key frame.
    pub fn push(&mut self, frame: &Frame) -> Result<Entry, StreamError> {
        self.check(frame).in_file(&self.folder)?;
        let steps = &self.manifest.static_steps;
        let target = frame.static_target(steps);
        let static_key = self.still.as_ref().is_none_or(|still| still.is_far_from(&target, steps));
        let key = static_key || self.moving.is_none() || self.since_key >= self.key_every;
        let mut sections = Vec::new();
        self.static_sections(frame, static_key, key, &mut sections);
        self.dynamic_sections(frame, key, &mut sections);
        let sky = key || frame.sky_has_changed;
        if sky {
            sections.push((Tag::Sky, frame.sky.to_vec()));
        }
        let gaussians = [frame.static_layer.len(), frame.dynamic_layer.len()];
        // The layers are already those of this frame.
        self.failed = true;
        let entry = self.store(frame.frame, &sections, [key, static_key, sky], gaussians)?;
        self.failed = false;
        self.since_key = if key { 1 } else { self.since_key + 1 };
        self.last_frame = Some(frame.frame);
        Ok(entry)
    }

    fn check(&self, frame: &Frame) -> Result<(), Problem> {
        if self.failed {
            return Err(Problem::Failed);
        }
        let shape = |text: String| Err(Problem::Shape(text));
        for (layer, steps) in [
            (frame.static_layer, &self.manifest.static_steps),
            (frame.dynamic_layer, &self.manifest.dynamic_steps),
        ] {
            layer.validate().map_err(|e| Problem::Shape(e.to_string()))?;
            if layer.sh_degree() != steps.sh_degree {
                return shape(format!("SH degree {} in a stream of {}", layer.sh_degree(), steps.sh_degree));
            }
            if !layer.is_finite() {
                return shape(format!("frame {} holds a value that is not finite", frame.frame));
            }
        }
        let n = frame.dynamic_layer.len();
        if frame.ids.len() != n || frame.uncertainty.is_some_and(|u| u.len() != n) {
            return shape(format!("{n} dynamic Gaussians, {} names", frame.ids.len()));
        }
        let counts = [frame.static_layer.len(), n];
        if frame.importance.is_some_and(|of| of.map(<[f32]>::len) != counts) {
            return shape(format!("importances of other numbers of Gaussians than {counts:?}"));
        }
        match self.last_frame {
            Some(last) if last >= frame.frame => shape(format!("frame {} after frame {last}", frame.frame)),
            _ => Ok(()),
        }
    }

    fn static_sections(&mut self, frame: &Frame, static_key: bool, key: bool, out: &mut Vec<(Tag, Vec<u8>)>) {
        let steps = &self.manifest.static_steps;
        let target = frame.static_target(steps);
        let target = |i: usize| target.measures(i);
        if static_key {
            let count = frame.static_layer.len();
            let rows: Vec<Row> = (0..count).map(|i| Row::rounded(&target(i), steps, 0)).collect();
            out.push((Tag::StaticKey, encode_key(&rows, steps)));
            self.still = Some(Still { base: rows.clone(), now: rows });
        } else if let Some(still) = &mut self.still {
            if key {
                still.now.clone_from(&still.base);
            }
            if count(&still.now, steps, target) > 0 {
                out.push((Tag::StaticRows, encode_rows(&mut still.now, steps, target)));
            }
            out.push((Tag::StaticColours, encode_colours(&mut still.now, steps, target)));
        }
    }

    fn dynamic_sections(&mut self, frame: &Frame, key: bool, out: &mut Vec<(Tag, Vec<u8>)>) {
        let steps = &self.manifest.dynamic_steps;
        let (moving, section) = match self.moving.take() {
            Some(moving) if !key => change(moving, frame, steps),
            _ => all(frame, steps),
        };
        out.push((if key { Tag::DynamicKey } else { Tag::DynamicChange }, section));
        if let Some(uncertainty) = frame.uncertainty {
            let place: BTreeMap<u32, f32> =
                frame.ids.iter().copied().zip(uncertainty.iter().copied()).collect();
            let sorted: Vec<f32> =
                moving.ids.iter().map(|id| place.get(id).copied().unwrap_or(0.0)).collect();
            out.push((Tag::Uncertainty, encode_uncertainty(&sorted)));
        }
        self.moving = Some(moving);
    }

    fn store(
        &self,
        frame: u64,
        sections: &[(Tag, Vec<u8>)],
        [key, static_key, sky]: [bool; 3],
        gaussians: [usize; 2],
    ) -> Result<Entry, StreamError> {
        let file = format!("{frame:06}.4df");
        let (path, bytes) = (self.folder.join(&file), encode(sections));
        write_atomically(&path, |out| out.write_all(&bytes)).in_file(&path)?;
        let entry = Entry {
            frame,
            file,
            bytes: bytes.len() as u64,
            crc32: checksum(&bytes),
            key,
            static_key,
            sky,
            gaussians,
            sections: sections.iter().map(|(tag, bytes)| (tag.name(), bytes.len() as u64)).collect(),
        };
        let list = self.folder.join(FRAMES);
        let line = serde_json::to_string(&entry).in_file(&list)? + "\n";
        refuse_link(&list).in_file(&list)?;
        let mut out = OpenOptions::new().create(true).append(true).open(&list).in_file(&list)?;
        out.write_all(line.as_bytes()).and_then(|()| out.sync_data()).in_file(&list)?;
        Ok(entry)
    }
}

/// Every row, in spatial order, assigned to new groups.
fn all(frame: &Frame, steps: &Steps) -> (Moving, Vec<u8>) {
    let (layer, target) = (frame.dynamic_layer, frame.dynamic_target(steps));
    let order = spatial_order(&layer.means);
    let points: Vec<[f64; 3]> = order.iter().map(|&i| layer.means[i].map(f64::from)).collect();
    let (groups, _) = clusters(&points, MAX_GROUPS);
    let rows: Vec<Row> =
        order.iter().zip(groups).map(|(&i, group)| Row::rounded(&target.measures(i), steps, group)).collect();
    let section = encode_key(&rows, steps);
    (Moving { rows, ids: order.iter().map(|&i| frame.ids[i]).collect() }, section)
}

/// What has changed since the last frame.
fn change(moving: Moving, frame: &Frame, steps: &Steps) -> (Moving, Vec<u8>) {
    let (layer, target) = (frame.dynamic_layer, frame.dynamic_target(steps));
    let place: BTreeMap<u32, usize> = frame.ids.iter().copied().zip(0..).collect();
    let now: Vec<Option<usize>> = moving.ids.iter().map(|id| place.get(id).copied()).collect();
    let position = |row: &Row| row.position.map(|v| f64::from(v) * steps.position);
    let mut pairs = vec![Vec::new(); MAX_GROUPS];
    for (row, i) in moving.rows.iter().zip(&now) {
        if let Some(i) = i {
            pairs[usize::from(row.group)].push((position(row), layer.means[*i].map(f64::from)));
        }
    }
    let motions: Vec<Motion> = pairs.iter().map(|pairs| robust_fit(pairs)).collect();
    let centres: Vec<[f64; 3]> = pairs.iter().map(|pairs| centre(pairs)).collect();
    let known: BTreeSet<u32> = moving.ids.iter().copied().collect();
    let new = spatial_order(&layer.means).into_iter().filter(|&i| !known.contains(&frame.ids[i]));
    let new: Vec<usize> = new.collect();
    let birth = |&i: &usize| {
        let group = nearest(&centres, &layer.means[i].map(f64::from));
        Row::rounded(&target.measures(i), steps, group)
    };
    let births: Vec<Row> = new.iter().map(birth).collect();
    let targets: Vec<Option<Measures>> = now.iter().map(|i| i.map(|i| target.measures(i))).collect();
    let mut rows = moving.rows;
    let section =
        encode_change(&mut rows, steps, &Change { motions: &motions, targets: &targets, births: &births });
    let kept = moving.ids.into_iter().zip(now).filter_map(|(id, i)| i.map(|_| id));
    let ids = kept.chain(new.into_iter().map(|i| frame.ids[i])).collect();
    (Moving { rows, ids }, section)
}

/// Middle of where a group is now; far away for an empty one, so that nothing is born into it.
fn centre(pairs: &[Pair]) -> [f64; 3] {
    if pairs.is_empty() {
        return [f64::MAX.sqrt() / 4.0; 3];
    }
    [0, 1, 2].map(|k| pairs.iter().map(|p| p.1[k]).sum::<f64>() / pairs.len() as f64)
}
