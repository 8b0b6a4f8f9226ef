//! The reference decoder of the 4D stream, in order or at random (docs/STREAM.md).

use crate::changed_rows::decode_rows;
use crate::error::{InFile, Problem, StreamError};
use crate::frame_file::{Tag, decode, is_listed};
use crate::layers::{decode_change, decode_colours, decode_key, decode_uncertainty};
use crate::manifest::{Entry, Manifest, read_entries};
use crate::row::Row;
use crate::steps::Steps;
use ffgs_core::{Gaussians, PixelFilter, read_bytes};
use std::path::{Path, PathBuf};

/// A frame as a player shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedFrame {
    /// Frame of the capture.
    pub frame: u64,
    /// What stands still.
    pub static_layer: Gaussians,
    /// What moves. Between two key frames survivors keep their order, the dead are left out and the newborn come last.
    pub dynamic_layer: Gaussians,
    /// How well each dynamic position is known (the capture's unit), where the stream says it.
    pub uncertainty: Option<Vec<f32>>,
    /// Equirectangular JPEG.
    pub sky: Vec<u8>,
}

/// Reads a stream, in order or at random. Memory is that of one frame.
#[derive(Debug)]
pub struct Reader {
    folder: PathBuf,
    manifest: Manifest,
    entries: Vec<Entry>,
    state: Option<State>,
}

/// What the next frame builds upon.
#[derive(Debug)]
struct State {
    /// Place in the list.
    at: usize,
    /// Place of the frame that `base` is from.
    base_at: usize,
    base: Vec<Row>,
    still: Vec<Row>,
    moving: Vec<Row>,
    uncertainty: Option<Vec<f32>>,
    sky: Vec<u8>,
}

impl Reader {
    /// Opens the stream in a folder.
    ///
    /// # Errors
    /// When there is none, or it is of another version or damaged.
    pub fn open(folder: &Path) -> Result<Self, StreamError> {
        let manifest = Manifest::read(folder)?;
        let entries = read_entries(folder)?;
        Ok(Self { folder: folder.to_owned(), manifest, entries, state: None })
    }

    /// What holds for all frames.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The finished frames, ascending.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Looks for frames that were appended since.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn refresh(&mut self) -> Result<(), StreamError> {
        self.entries = read_entries(&self.folder)?;
        Ok(())
    }

    /// A frame of the capture. The one after the last frame read costs one file; any other those from its key frame on.
    ///
    /// # Errors
    /// When the stream does not have the frame, or a file that it needs is missing or damaged.
    pub fn read(&mut self, frame: u64) -> Result<DecodedFrame, StreamError> {
        let at = self.entries.iter().position(|e| e.frame == frame);
        let missing = || Problem::Missing(format!("the stream has no frame {frame}"));
        let at = at.ok_or_else(missing).in_file(&self.folder)?;
        for step in self.path_to(at)? {
            // On an error nothing half applied remains.
            let state = self.state.take();
            self.state = Some(self.apply(state, step)?);
        }
        let state = self.state.as_ref().ok_or_else(missing).in_file(&self.folder)?;
        let filter = self.manifest.filter();
        let (static_layer, dynamic_layer) = both(
            || gaussians(&state.still, &self.manifest.static_steps, filter),
            || gaussians(&state.moving, &self.manifest.dynamic_steps, filter),
        );
        Ok(DecodedFrame {
            frame,
            static_layer,
            dynamic_layer,
            uncertainty: state.uncertainty.clone(),
            sky: state.sky.clone(),
        })
    }

    /// CRC-32 of the integers of the static and of the dynamic layer of the last frame read: two decoders that agree on them
    /// agree on everything. docs/STREAM.md says of which bytes.
    pub fn fingerprint(&self) -> Option<[u32; 2]> {
        let state = self.state.as_ref()?;
        let of = |rows: &[Row], steps: &Steps| {
            let mut hash = crc32fast::Hasher::new();
            rows.iter().for_each(|row| hash.update(&row.bytes(steps.harmonics())));
            hash.finalize()
        };
        Some([of(&state.still, &self.manifest.static_steps), of(&state.moving, &self.manifest.dynamic_steps)])
    }

    /// Places in the list that must be applied in turn to arrive at `at`.
    fn path_to(&self, at: usize) -> Result<Vec<usize>, StreamError> {
        let before = |is: fn(&Entry) -> bool| {
            let found = self.entries[..=at].iter().rposition(is);
            let missing = || Problem::Missing("no key frame before the frame".into());
            found.ok_or_else(missing).in_file(&self.folder)
        };
        let (key, base) = (before(|e| e.key)?, before(|e| e.static_key)?);
        if let Some(state) = &self.state {
            if state.base_at == base && (key..=at).contains(&state.at) {
                return Ok((state.at + 1..=at).collect());
            }
            if state.base_at == base {
                return Ok((key..=at).collect());
            }
        }
        Ok(if base < key { std::iter::once(base).chain(key..=at).collect() } else { (key..=at).collect() })
    }

    fn apply(&self, state: Option<State>, at: usize) -> Result<State, StreamError> {
        let entry = &self.entries[at];
        let path = self.folder.join(&entry.file);
        let bytes = read_bytes(&path, entry.bytes).in_file(&path)?;
        let apply = || {
            if !is_listed(&bytes, entry.crc32) {
                return Err(Problem::Corrupt("not the file that the list names".into()));
            }
            self.apply_sections(state, at, &decode(&bytes)?)
        };
        apply().in_file(&path)
    }

    fn apply_sections(
        &self,
        state: Option<State>,
        at: usize,
        sections: &[(Tag, &[u8])],
    ) -> Result<State, Problem> {
        let entry = &self.entries[at];
        let (still_steps, moving_steps) = (&self.manifest.static_steps, &self.manifest.dynamic_steps);
        let find = |tag: Tag| sections.iter().find(|(t, _)| *t == tag).map(|(_, bytes)| *bytes);
        let absent = |tag: Tag| Problem::Corrupt(format!("no section {tag:?}"));
        let mut state = if entry.static_key {
            let section = find(Tag::StaticKey).ok_or_else(|| absent(Tag::StaticKey))?;
            State::starting(at, decode_key(section, still_steps)?)
        } else {
            state.ok_or_else(|| Problem::Missing("no static layer before this frame".into()))?
        };
        if entry.key {
            state.still.clone_from(&state.base);
        }
        let (still, moving) = (&mut state.still, &mut state.moving);
        let change_still = || {
            if let Some(section) = find(Tag::StaticRows) {
                decode_rows(still, still_steps, section);
            }
            if let Some(section) = find(Tag::StaticColours) {
                decode_colours(still, still_steps, section);
            }
        };
        let change_moving = || {
            if entry.key {
                let section = find(Tag::DynamicKey).ok_or_else(|| absent(Tag::DynamicKey))?;
                *moving = decode_key(section, moving_steps)?;
                return Ok(());
            }
            let section = find(Tag::DynamicChange).ok_or_else(|| absent(Tag::DynamicChange))?;
            decode_change(moving, moving_steps, section)
        };
        let ((), changed) = both(change_still, change_moving);
        changed?;
        state.uncertainty = find(Tag::Uncertainty).map(|bytes| decode_uncertainty(state.moving.len(), bytes));
        if let Some(sky) = find(Tag::Sky) {
            state.sky = sky.to_vec();
        }
        if [state.still.len(), state.moving.len()] != entry.gaussians {
            return Err(Problem::Corrupt(format!("other numbers of Gaussians than {:?}", entry.gaussians)));
        }
        state.at = at;
        Ok(state)
    }
}

impl State {
    fn starting(at: usize, base: Vec<Row>) -> Self {
        Self {
            at,
            base_at: at,
            still: base.clone(),
            base,
            moving: Vec::new(),
            uncertainty: None,
            sky: Vec::new(),
        }
    }
}

/// Does two things at a time: the layers do not depend on each other.
fn both<A: Send, B>(first: impl FnOnce() -> A + Send, second: impl FnOnce() -> B) -> (A, B) {
    std::thread::scope(|scope| {
        let first = scope.spawn(first);
        let second = second();
        (first.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), second)
    })
}

fn gaussians(rows: &[Row], steps: &Steps, filter: PixelFilter) -> Gaussians {
    let mut out = Gaussians::empty(steps.sh_degree).with_filter(filter);
    rows.iter().for_each(|row| steps.push(row, &mut out));
    out
}
