//! Pictures that belong together by when they were taken: the times of videos that dropped frames, the numbers of files of which some are missing.

use crate::Request;
use crate::names::plain_name;
use crate::schedule::{Schedule, Sequence};
use ffgs_core::{counted, median};
use std::path::{Path, PathBuf};

/// Pictures come at an even rate when none is farther from it than this part of the time between two.
const EVEN: f64 = 0.25;
/// A picture is of a moment when it was taken within this part of the time between two, and a little more for rounding.
const NEAR: f64 = 0.51;
/// Numbers of files count from one start when all cameras have at least this part of those of the camera that has fewest.
const COMMON: f64 = 0.8;

/// The numbers at the end of the names of files, or before what follows; `None` where they do not ascend.
pub(crate) fn numbers(files: &[PathBuf]) -> Option<Vec<f64>> {
    let found: Vec<f64> = files.iter().map(|file| number(file)).collect::<Option<_>>()?;
    found.windows(2).all(|pair| pair[0] < pair[1]).then_some(found)
}

/// The last number in a file's name.
fn number(file: &Path) -> Option<f64> {
    let name = file.file_stem()?.to_str()?;
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let before = name[..end].char_indices().rev().find(|(_, c)| !c.is_ascii_digit());
    let start = before.map_or(0, |(at, c)| at + c.len_utf8());
    // Larger numbers are no longer whole in f64.
    (end - start < 16).then(|| name[start..end].parse().ok()).flatten()
}

/// The frames by which a camera began too early.
pub(crate) fn offset(sequence: &Sequence, request: &Request) -> i64 {
    let named = request.offsets.iter().find(|(name, _)| plain_name(name) == sequence.name);
    named.map_or(0, |(_, frames)| *frames)
}

/// Matches pictures by their moments; `None` where these tell nothing that their order does not, or are not known of all cameras.
pub(crate) fn by_moments(sequences: &[Sequence], request: &Request) -> Option<Schedule> {
    let clocks: Vec<Clock> = sequences.iter().map(|s| Clock::new(s, request)).collect::<Option<_>>()?;
    let are_videos = sequences.iter().all(|s| s.rate.is_some());
    let are_files = sequences.iter().all(|s| s.rate.is_none());
    let wanted = if are_videos && clocks.iter().any(|clock| !clock.is_even()) {
        // The slowest camera, and of several that which dropped least.
        let slowest = clocks.iter().map(|clock| clock.step).fold(0.0, f64::max);
        let slow = clocks.iter().filter(|clock| clock.step > (1.0 - EVEN) * slowest);
        slow.max_by_key(|clock| clock.moments.len())?.of_common()
    } else if are_files && lack_different_numbers(&clocks) {
        all_numbers(&clocks)
    } else {
        return None;
    };
    let at = |moment: &f64| clocks.iter().map(|clock| clock.picture_at(*moment)).collect::<Option<Vec<_>>>();
    let frames: Vec<Vec<usize>> = wanted.iter().filter_map(at).collect();
    let mut schedule = Schedule { frames, ..Schedule::default() };
    let by = if are_videos {
        "the times in the videos, of which some lack frames or have no even rate; all cameras started together (--offset CAMERA=FRAMES shifts one)"
    } else {
        "the numbers in their names"
    };
    schedule.assumed.push(format!("pictures belong together by {by}"));
    let lost = wanted.len() - schedule.frames.len();
    if lost > 0 {
        let moments = counted(wanted.len(), "moment");
        schedule.skipped.push(format!(
            "{lost} of {moments} lack a picture of a camera: {}",
            lacking(sequences, &clocks, &wanted)
        ));
    }
    Some(schedule)
}

/// How many of the moments each camera lacks.
fn lacking(sequences: &[Sequence], clocks: &[Clock], wanted: &[f64]) -> String {
    let of = |(s, clock): (&Sequence, &Clock)| {
        let count = wanted.iter().filter(|moment| clock.picture_at(**moment).is_none()).count();
        (count > 0).then(|| format!("{} lacks {count}", s.name))
    };
    sequences.iter().zip(clocks).filter_map(of).collect::<Vec<_>>().join(", ")
}

/// The moments of a camera's pictures.
struct Clock<'a> {
    moments: &'a [f64],
    /// Between two pictures, usually.
    step: f64,
    /// By how much the camera began too early.
    early: f64,
}

impl<'a> Clock<'a> {
    fn new(sequence: &'a Sequence, request: &Request) -> Option<Self> {
        let moments = sequence.moments.as_deref().filter(|moments| moments.len() == sequence.pictures)?;
        let step = median(moments.windows(2).map(|pair| pair[1] - pair[0])).unwrap_or(1.0);
        Some(Self { moments, step, early: offset(sequence, request) as f64 * step })
    }

    fn is_even(&self) -> bool {
        let [first, .., last] = self.moments else { return true };
        let mean = (last - first) / (self.moments.len() - 1) as f64;
        let off = |(i, moment): (usize, &f64)| (moment - first - i as f64 * mean).abs();
        self.moments.iter().enumerate().map(off).fold(0.0, f64::max) <= EVEN * self.step
    }

    /// Its own moments, on the clock that all cameras have in common.
    fn of_common(&self) -> Vec<f64> {
        self.moments.iter().map(|moment| moment - self.early).collect()
    }

    /// The picture of a moment of the common clock.
    fn picture_at(&self, moment: f64) -> Option<usize> {
        let own = moment + self.early;
        let after = self.moments.partition_point(|at| *at < own);
        let distance = |i: &usize| (self.moments[*i] - own).abs();
        let near =
            [after.checked_sub(1), Some(after)].into_iter().flatten().filter(|i| *i < self.moments.len());
        near.min_by(|a, b| distance(a).total_cmp(&distance(b))).filter(|i| distance(i) <= NEAR * self.step)
    }
}

/// Whether some cameras lack numbers that others have, and not only because each counts from a start of its own.
fn lack_different_numbers(clocks: &[Clock]) -> bool {
    let is_consecutive = |clock: &Clock| clock.moments.windows(2).all(|pair| pair[1] - pair[0] == clock.step);
    let is_alike = |clock: &Clock| {
        is_consecutive(clock)
            && clock.moments.len() == clocks[0].moments.len()
            && clock.step == clocks[0].step
    };
    if clocks.iter().all(is_alike) || clocks.iter().all(|clock| clock.moments == clocks[0].moments) {
        return false;
    }
    let common = |moment: &&f64| {
        clocks.iter().all(|clock| clock.moments.binary_search_by(|at| at.total_cmp(moment)).is_ok())
    };
    let fewest = clocks.iter().min_by_key(|clock| clock.moments.len()).map_or(&[][..], |clock| clock.moments);
    fewest.iter().filter(common).count() as f64 >= COMMON * fewest.len() as f64
}

fn all_numbers(clocks: &[Clock]) -> Vec<f64> {
    let mut all: Vec<f64> = clocks.iter().flat_map(Clock::of_common).collect();
    all.sort_unstable_by(f64::total_cmp);
    all.dedup();
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Request {
        Request::new("a".into(), "b".into())
    }

    fn files(name: &str, numbers: &[u32]) -> Sequence {
        let files: Vec<PathBuf> = numbers.iter().map(|n| format!("cam_7/img_{n:04}.png").into()).collect();
        Sequence { name: name.into(), pictures: files.len(), rate: None, moments: super::numbers(&files) }
    }

    fn video(name: &str, times: Vec<f64>, rate: f64) -> Sequence {
        Sequence { name: name.into(), pictures: times.len(), rate: Some(rate), moments: Some(times) }
    }

    /// Frames at a rate, without some.
    fn times(count: usize, rate: f64, without: &[usize]) -> Vec<f64> {
        (0..count)
            .filter(|i| !without.contains(i))
            .map(|i| (i as f64 / rate * 1000.0).round() / 1000.0)
            .collect()
    }

    #[test]
    fn a_missing_file_costs_its_moment_and_shifts_nothing() {
        let cameras =
            [files("a", &[0, 1, 2, 3, 4, 5]), files("b", &[0, 1, 2, 4, 5]), files("c", &[0, 1, 2, 3, 4, 5])];
        let schedule = by_moments(&cameras, &request()).unwrap();
        assert_eq!(schedule.frames, [[0, 0, 0], [1, 1, 1], [2, 2, 2], [4, 3, 4], [5, 4, 5]]);
        assert!(schedule.skipped[0].contains("1 of 6 moments") && schedule.skipped[0].contains("b lacks 1"));
        let first = [files("a", &[0, 1, 2, 3, 4, 5]), files("b", &[1, 2, 3, 4, 5])];
        assert_eq!(by_moments(&first, &request()).unwrap().frames[0], [1, 0]);
        let early = Request { offsets: [("b".to_owned(), 1)].into(), ..request() };
        assert_eq!(
            by_moments(&cameras, &early).unwrap().frames,
            [[0, 1, 0], [1, 2, 1], [3, 3, 3], [4, 4, 4]]
        );
    }

    #[test]
    fn numbers_that_tell_nothing_leave_the_order() {
        let same = [files("a", &[3, 4, 5]), files("b", &[3, 4, 5])];
        assert!(by_moments(&same, &request()).is_none());
        let own_starts = [files("a", &[0, 1, 2, 3, 4, 5]), files("b", &[1, 2, 3, 4, 5, 6])];
        assert!(by_moments(&own_starts, &request()).is_none(), "each counts from its own start");
        let far = [files("a", &[0, 1, 2, 3]), files("b", &[100, 101, 102])];
        assert!(by_moments(&far, &request()).is_none(), "nothing in common");
        let unnamed = Sequence { moments: None, ..files("b", &[0, 1]) };
        assert!(by_moments(&[files("a", &[0, 1, 2]), unnamed], &request()).is_none());
        let same_number = ["a_v2.png", "b_v2.png"].map(PathBuf::from);
        assert_eq!((numbers(&same_number), number(Path::new("a.png"))), (None, None));
        assert_eq!(number(Path::new("12_left.png")), Some(12.0));
        assert_eq!(number(Path::new("frame é07.png")), Some(7.0));
    }

    #[test]
    fn frames_that_a_video_dropped_are_found_by_its_times() {
        let cameras = [
            video("a", times(12, 30.0, &[]), 30.0),
            video("b", times(12, 30.0, &[4, 5]), 25.0),
            video("c", times(24, 60.0, &[]), 60.0),
        ];
        let schedule = by_moments(&cameras, &request()).unwrap();
        let frames: Vec<usize> = schedule.frames.iter().map(|row| row[0]).collect();
        assert_eq!(frames, [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]);
        assert_eq!(schedule.frames[4], [6, 4, 12]);
        assert!(schedule.skipped[0].contains("2 of 12 moments") && schedule.skipped[0].contains("b lacks 2"));
        let even = [video("a", times(700, 29.97, &[]), 29.97), video("b", times(699, 29.97, &[]), 29.97)];
        assert!(by_moments(&even, &request()).is_none(), "even rates need no times");
        let one = [video("a", times(700, 29.97, &[]), 29.97), video("b", times(700, 29.97, &[350]), 29.93)];
        assert_eq!(by_moments(&one, &request()).unwrap().frames[350], [351, 350]);
    }

    #[test]
    fn an_offset_shifts_a_camera_of_an_uneven_rate() {
        let cameras = [video("a", times(8, 30.0, &[]), 30.0), video("b", times(10, 30.0, &[5]), 27.0)];
        let early = Request { offsets: [("b".to_owned(), 2)].into(), ..request() };
        let frames = by_moments(&cameras, &early).unwrap().frames;
        // Its frame 5, of the moment 3, was dropped.
        assert_eq!(frames, [[0, 2], [1, 3], [2, 4], [4, 5], [5, 6], [6, 7], [7, 8]]);
    }
}
