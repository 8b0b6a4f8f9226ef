//! Which picture of each camera belongs to which frame.

use crate::moments::{by_moments, offset};
use crate::names::plain_name;
use crate::schedule::{Schedule, Sequence};
use crate::{PrepareError, Request};
use ffgs_core::read_text;
use std::collections::BTreeMap;
use std::path::Path;

/// A hundred cameras for an hour at 100 pictures per second take a gigabyte.
const MAX_TIMESTAMPS_BYTES: u64 = 1 << 30;

/// Rates that differ by less are the same: containers round them.
const SAME_RATE: f64 = 0.002;

/// Matches pictures by timestamps, else by the videos' rates and the offsets.
pub(crate) fn schedule(
    sequences: &[Sequence],
    timestamps: Option<&Path>,
    request: &Request,
) -> Result<Schedule, PrepareError> {
    check_offsets(sequences, request)?;
    let table = timestamps.map(|file| read_timestamps(file, sequences)).transpose()?.flatten();
    let mut schedule = match table {
        Some(table) => by_timestamps(&table, sequences, request),
        None => by_moments(sequences, request).unwrap_or_else(|| by_rate(sequences, request)),
    };
    let all = schedule.frames.len();
    let taken = schedule.frames.into_iter().skip(request.start).step_by(request.every.get());
    schedule.frames = taken.take(request.count.unwrap_or(usize::MAX)).collect();
    match request.count {
        Some(0) => Err(PrepareError::Footage("--count 0 takes no frame: it is the number of frames".into())),
        _ if schedule.frames.is_empty() => {
            let reason =
                format!("no frame is left: the cameras have {all} in common, --start is {}", request.start);
            Err(PrepareError::Footage(reason))
        }
        Some(count) if schedule.frames.len() < count => {
            let found = schedule.frames.len();
            Err(PrepareError::Footage(format!(
                "{count} frames were asked for, only {found} are there (of {all} in all)"
            )))
        }
        _ => Ok(schedule),
    }
}

/// `[sync][camera]`: index of the picture and its time.
type Table = Vec<Vec<Option<(usize, f64)>>>;

/// Reads `sync_index, cam_id, frame_time` of caliscope; the pictures of a camera are numbered in the order of its
/// rows. `None` when the file has other columns, or does not name the cameras.
fn read_timestamps(file: &Path, sequences: &[Sequence]) -> Result<Option<Table>, PrepareError> {
    let text = read_text(file, MAX_TIMESTAMPS_BYTES).map_err(|e| PrepareError::io(file, e))?;
    let mut lines = text.lines().map(|l| l.split(',').map(str::trim).collect::<Vec<_>>());
    let heading = lines.next().unwrap_or_default();
    let column = |names: &[&str]| heading.iter().position(|h| names.contains(h));
    let columns =
        (column(&["sync_index"]), column(&["cam_id", "port", "camera"]), column(&["frame_time", "time"]));
    let (Some(sync), Some(camera), Some(time)) = columns else { return Ok(None) };
    let mut rows: BTreeMap<i64, Vec<Option<(usize, f64)>>> = BTreeMap::new();
    let mut seen = vec![0; sequences.len()];
    for (number, words) in lines.enumerate().filter(|(_, w)| w.len() >= heading.len()) {
        let damaged =
            || PrepareError::picture(file, format!("line {} is not sync, camera, time", number + 2));
        let key = words[sync].parse().map_err(|_| damaged())?;
        let seconds: f64 = words[time].parse().map_err(|_| damaged())?;
        let fits = |s: &Sequence| s.name == words[camera] || s.name == format!("cam_{}", words[camera]);
        let Some(c) = sequences.iter().position(fits) else { continue };
        let row = rows.entry(key).or_insert_with(|| vec![None; sequences.len()]);
        row[c] = Some((seen[c], seconds));
        seen[c] += 1;
    }
    let named = seen.iter().all(|n| *n > 0);
    Ok(named.then(|| rows.into_values().collect()))
}

fn check_offsets(sequences: &[Sequence], request: &Request) -> Result<(), PrepareError> {
    let is_known = |name: &str| sequences.iter().any(|s| s.name == plain_name(name));
    let Some(unknown) = request.offsets.keys().find(|name| !is_known(name)) else {
        return Ok(());
    };
    let known = sequences.iter().map(|s| s.name.as_str()).collect::<Vec<_>>().join(", ");
    Err(PrepareError::Footage(format!("--offset names camera {unknown}; the cameras are {known}")))
}

/// The picture of a camera that shows the moment of picture `i` (which may be negative), if the camera has one.
fn shifted(sequence: &Sequence, i: i64, request: &Request) -> Option<usize> {
    usize::try_from(i.checked_add(offset(sequence, request))?).ok().filter(|i| *i < sequence.pictures)
}

/// An offset moves a camera against its own timestamps: clocks of cameras can be wrong.
fn by_timestamps(table: &Table, sequences: &[Sequence], request: &Request) -> Schedule {
    let mut schedule = Schedule::default();
    let mut spread: f64 = 0.0;
    for row in table {
        let at = |(entry, s): (&Option<(usize, f64)>, &Sequence)| {
            entry.and_then(|(i, time)| Some((shifted(s, i as i64, request)?, time)))
        };
        let Some(row) = row.iter().zip(sequences).map(at).collect::<Option<Vec<_>>>() else { continue };
        let times = row.iter().map(|(_, t)| *t);
        spread = spread.max(times.clone().fold(f64::MIN, f64::max) - times.fold(f64::MAX, f64::min));
        schedule.frames.push(row.iter().map(|(i, _)| *i).collect());
    }
    if schedule.frames.len() < table.len() {
        let lost = table.len() - schedule.frames.len();
        schedule.skipped.push(format!("{lost} of {} moments of timestamps.csv lack a camera", table.len()));
    }
    let moved = if request.offsets.is_empty() { "" } else { ", but for the cameras of --offset" };
    schedule.assumed.push(format!("pictures belong together by timestamps.csv{moved}"));
    schedule.spread = Some(spread);
    schedule
}

fn by_rate(sequences: &[Sequence], request: &Request) -> Schedule {
    let slowest = sequences.iter().filter_map(|s| s.rate).fold(f64::INFINITY, f64::min);
    let ratio =
        |s: &Sequence| s.rate.map(|r| r / slowest).filter(|r| (r - 1.0).abs() > SAME_RATE).unwrap_or(1.0);
    let index = |s: &Sequence, frame: usize| shifted(s, (frame as f64 * ratio(s)).round() as i64, request);
    let longest = sequences.iter().map(|s| s.pictures).max().unwrap_or(0);
    let frames = (0..longest).filter_map(|t| sequences.iter().map(|s| index(s, t)).collect()).collect();
    let mut schedule = Schedule { frames, ..Schedule::default() };
    describe(sequences, ratio, &mut schedule);
    schedule
}

fn describe(sequences: &[Sequence], ratio: impl Fn(&Sequence) -> f64, schedule: &mut Schedule) {
    let counts = || sequences.iter().map(|s| s.pictures);
    let (least, most) = (counts().min().unwrap_or(0), counts().max().unwrap_or(0));
    if most > 1 {
        schedule.assumed.push("the cameras started together (--offset CAMERA=FRAMES shifts one)".to_owned());
    }
    if least != most {
        let text = format!(
            "the cameras have {least} to {most} pictures, of which {} are of all cameras when they are taken in their order",
            schedule.frames.len()
        );
        schedule.skipped.push(text);
    }
    for s in sequences.iter().filter(|s| ratio(s) != 1.0) {
        let rate = s.rate.unwrap_or_default();
        schedule.assumed.push(format!(
            "camera {} has {rate:.2} pictures per second: the nearest in time are taken",
            s.name
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence(name: &str, pictures: usize, rate: f64) -> Sequence {
        Sequence { name: name.into(), pictures, rate: Some(rate), moments: None }
    }

    fn request() -> Request {
        Request::new("a".into(), "b".into())
    }

    #[test]
    fn rates_and_offsets_pick_the_pictures() {
        let cameras = [sequence("a", 10, 30.0), sequence("b", 20, 60.0), sequence("c", 10, 30.0001)];
        let request = Request {
            offsets: [("c".into(), 2)].into(),
            start: 1,
            every: std::num::NonZeroUsize::new(2).unwrap(),
            ..request()
        };
        let schedule = schedule(&cameras, None, &request).unwrap();
        assert_eq!(schedule.frames, [[1, 2, 3], [3, 6, 5], [5, 10, 7], [7, 14, 9]]);
        assert!(schedule.assumed.iter().any(|a| a.contains("60.00")));
        let early = Request { offsets: [("c".into(), -3)].into(), ..request };
        assert_eq!(super::schedule(&cameras, None, &early).unwrap().frames[0], [4, 8, 1]);
    }

    #[test]
    fn what_is_not_there_is_refused() {
        let cameras = [sequence("a", 10, 30.0), sequence("b", 5, 30.0)];
        let fails = |request: &Request| schedule(&cameras, None, request).unwrap_err().to_string();
        assert!(fails(&Request { start: 5, ..request() }).contains("5 in common"));
        assert!(fails(&Request { count: Some(6), ..request() }).contains("only 5"));
        let none = fails(&Request { count: Some(0), ..request() });
        assert!(none.contains("--count 0") && !none.contains("--start"), "{none}");
        assert!(fails(&Request { offsets: [("z".into(), 1)].into(), ..request() }).contains("a, b"));
    }

    #[test]
    fn timestamps_match_pictures_though_one_was_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("timestamps.csv");
        // Camera 1 has no picture at moment 8.
        let text = "sync_index,cam_id,frame_time\n7,0,1.00\n7,1,1.01\n8,0,1.10\n9,1,1.22\n9,0,1.20\n";
        std::fs::write(&file, text).unwrap();
        let cameras = [sequence("cam_0", 3, 10.0), sequence("cam_1", 2, 10.0)];
        let schedule = schedule(&cameras, Some(&file), &request()).unwrap();
        assert_eq!(schedule.frames, [[0, 0], [2, 1]]);
        assert!((schedule.spread.unwrap() - 0.02).abs() < 1e-9);
        assert_eq!(schedule.skipped.len(), 1);
        // Camera 0 is one picture ahead of its own times.
        let moved = Request { offsets: [("cam_0".into(), -1)].into(), ..request() };
        let found = super::schedule(&cameras, Some(&file), &moved).unwrap();
        assert_eq!(found.frames, [[1, 1]]);
        assert!(found.assumed[0].contains("--offset"));
        let unknown = Request { offsets: [("cam_9".into(), 1)].into(), ..request() };
        assert!(super::schedule(&cameras, Some(&file), &unknown).is_err());
    }
}
