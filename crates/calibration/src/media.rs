//! The videos and folders of images below a folder, to which a calibration's cameras are assigned by name.

use crate::{CalibrationError, Pictures};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// How far below the footage's folder pictures are looked for.
const DEPTH: usize = 4;
const VIDEOS: [&str; 8] = ["mp4", "mov", "mkv", "avi", "m4v", "webm", "mpg", "mts"];
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Name of a folder with pictures of the empty scene.
pub const CLEAN_PLATES: &str = "clean_plates";
/// Folders whose pictures are masks, the empty scene or a program's own output, not footage.
const NOT_FOOTAGE: [&str; 10] =
    [CLEAN_PLATES, "mask", "masks", "seg", "bgmask", "bgmasks", "depth", "depths", "motion_masks", "sparse"];

/// The videos and image folders below a folder.
#[derive(Clone, Debug, Default)]
pub struct Media {
    videos: Vec<PathBuf>,
    /// Folder to its images, in natural order.
    folders: BTreeMap<PathBuf, Vec<PathBuf>>,
}

impl Media {
    /// Looks through `folder`. Hidden files and folders of masks are passed over.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn find(folder: &Path) -> Result<Self, CalibrationError> {
        let mut media = Self::default();
        media.visit(folder, DEPTH)?;
        media.videos.sort_by(|a, b| natural_order(a, b));
        media.folders.values_mut().for_each(|files| files.sort_by(|a, b| natural_order(a, b)));
        Ok(media)
    }

    /// All videos, in natural order of their paths.
    pub fn videos(&self) -> &[PathBuf] {
        &self.videos
    }

    /// Image folders with at least one image.
    pub fn folders(&self) -> impl Iterator<Item = (&PathBuf, &[PathBuf])> {
        self.folders.iter().map(|(folder, files)| (folder, files.as_slice()))
    }

    /// The video or image folder of a camera that goes by one of `names`. A name fits a whole file stem or folder
    /// name; case does not matter. The first name that fits wins; of several files with it the shallowest does.
    pub fn of_camera(&self, names: &[String]) -> Option<Pictures> {
        names.iter().find_map(|name| self.named(name))
    }

    /// As [`Self::of_camera`]; where no name fits, the only video or image folder whose name is spelt otherwise (`cam01` for `cam_1`), the only
    /// video in a folder of that name (`back/session_3.mp4`), or the only one with that word in its name (`session_3-back.mp4`), which
    /// `assumed` tells.
    pub fn likely_of_camera(&self, names: &[String], assumed: &mut Vec<String>) -> Option<Pictures> {
        if let Some(pictures) = self.of_camera(names) {
            assumed.extend(self.told_of_several(names, &pictures));
            return Some(pictures);
        }
        if let Some((path, pictures)) = names.iter().find_map(|name| self.spelt_otherwise(name)) {
            assumed.push(format!("{} has the pictures of camera '{}'", path.display(), names[0]));
            return Some(pictures);
        }
        let in_folder =
            |name: &String| self.only_video(|video| video.parent().is_some_and(|p| is_named(p, name)));
        let with_word = |name: &String| self.only_video(|video| has_words(&stem(video), name));
        let video = names.iter().find_map(in_folder).or_else(|| names.iter().find_map(with_word))?;
        let beside = self.videos.iter().filter(|v| v.parent() == video.parent() && shows_something_else(v));
        let others: Vec<String> = beside.map(|v| file_name(v)).collect();
        let told = if others.is_empty() {
            String::new()
        } else {
            let others = others.join(", ");
            format!(
                "; {others} beside it is passed over for its name (--clean-plates takes pictures of the empty scene)"
            )
        };
        assumed.push(format!("{} is the video of camera '{}'{told}", video.display(), names[0]));
        Some(Pictures::Video(video.clone()))
    }

    /// Why [`Self::likely_of_camera`] found nothing for a camera, and what to do where it could not choose.
    pub fn why_none(&self, names: &[String]) -> String {
        const SHOWN: usize = 5;
        let found = self.candidates(names);
        let name = &names[0];
        let in_words = |paths: &[&Path]| {
            let shown: Vec<String> =
                paths.iter().take(SHOWN).map(|path| path.display().to_string()).collect();
            shown.join(", ") + if paths.len() > SHOWN { " and others" } else { "" }
        };
        if found.is_empty() {
            let all: Vec<&Path> =
                self.videos.iter().chain(self.folders.keys()).map(PathBuf::as_path).collect();
            let there = if all.is_empty() { "no video and no picture".to_owned() } else { in_words(&all) };
            let called: BTreeSet<&str> = names.iter().map(String::as_str).collect();
            let called = called.into_iter().collect::<Vec<_>>().join(", ");
            return format!(
                "camera '{name}' has no video or folder called {called}; there is {there}, at most {} folders below",
                DEPTH - 1
            );
        }
        format!(
            "camera '{name}' may have any of {}: rename the one with its footage to '{name}{}', or leave that one alone there",
            in_words(&found),
            found[0].extension().map_or_else(String::new, |ending| format!(".{}", ending.display()))
        )
    }

    /// Videos and image folders in a folder of one of the names; without any, videos with one of the names among their words.
    fn candidates(&self, names: &[String]) -> Vec<&Path> {
        let below =
            |path: &Path| path.parent().is_some_and(|folder| names.iter().any(|name| is_named(folder, name)));
        let all = self.videos.iter().chain(self.folders.keys()).map(PathBuf::as_path);
        let found: Vec<&Path> = all.filter(|path| below(path)).collect();
        let with_word = |video: &&PathBuf| names.iter().any(|name| has_words(&stem(video), name));
        if found.is_empty() {
            return self.videos.iter().filter(with_word).map(PathBuf::as_path).collect();
        }
        found
    }

    /// Which pictures were taken, where several videos and folders go by a name of the camera.
    fn told_of_several(&self, names: &[String], taken: &Pictures) -> Option<String> {
        let goes_by = |called: &dyn Fn(&str) -> bool| names.iter().any(|name| called(name));
        let videos = self.videos.iter().filter(|v| goes_by(&|name| stem(v).eq_ignore_ascii_case(name)));
        let folders = self.folders.keys().filter(|folder| goes_by(&|name| is_named(folder, name)));
        let all = videos.count() + folders.count();
        let taken = match taken {
            Pictures::Video(file) => Some(file.as_path()),
            Pictures::Files(files) => files.first().and_then(|file| file.parent()),
        }?;
        (all > 1).then(|| {
            format!(
                "{} has the pictures of camera '{}', of {all} that go by its name",
                taken.display(),
                names[0]
            )
        })
    }

    /// The only video or image folder that is called `name`, which is no number, but for separators and leading zeros.
    fn spelt_otherwise(&self, name: &str) -> Option<(&Path, Pictures)> {
        let is_it =
            |called: &str| name.chars().any(char::is_alphabetic) && spelling(called) == spelling(name);
        let videos = self.videos.iter().filter(|video| is_it(&stem(video)));
        let videos = videos.map(|video| (video.as_path(), Pictures::Video(video.clone())));
        let folders = self
            .folders
            .iter()
            .filter(|(path, _)| path.file_name().is_some_and(|n| is_it(&n.to_string_lossy())));
        let folders = folders.map(|(path, files)| (path.as_path(), Pictures::Files(files.clone())));
        let mut found = videos.chain(folders);
        let first = found.next()?;
        found.next().is_none().then_some(first)
    }

    /// The only video that fits, or the only one of these that is footage by its name.
    fn only_video(&self, fits: impl Fn(&Path) -> bool) -> Option<&PathBuf> {
        let all: Vec<&PathBuf> = self.videos.iter().filter(|video| fits(video)).collect();
        let named: Vec<&PathBuf> = all.iter().copied().filter(|video| !shows_something_else(video)).collect();
        match (all.as_slice(), named.as_slice()) {
            ([only], _) | (_, [only]) => Some(only),
            _ => None,
        }
    }

    /// The single image that is called by one of `names`.
    pub fn image_of_camera(&self, names: &[String]) -> Option<Pictures> {
        let images = || self.folders.values().flatten();
        let named = |name: &String| images().find(|image| stem(image).eq_ignore_ascii_case(name));
        names.iter().find_map(named).map(|image| Pictures::Files(vec![image.clone()]))
    }

    fn named(&self, name: &str) -> Option<Pictures> {
        let fits = |path: &&PathBuf| stem(path).eq_ignore_ascii_case(name);
        let depth = |path: &&PathBuf| path.components().count();
        let video = self.videos.iter().filter(fits).min_by_key(depth);
        let folder = || self.folders.keys().filter(|p| is_named(p, name)).min_by_key(depth);
        video
            .map(|v| Pictures::Video(v.clone()))
            .or_else(|| Some(Pictures::Files(self.folders[folder()?].clone())))
    }

    fn visit(&mut self, folder: &Path, depth: usize) -> Result<(), CalibrationError> {
        let entries = fs::read_dir(folder).map_err(|e| CalibrationError::io(folder, e))?;
        for entry in entries {
            let path = entry.map_err(|e| CalibrationError::io(folder, e))?.path();
            if is_footage(&path) {
                self.take(path, depth)?;
            }
        }
        Ok(())
    }

    fn take(&mut self, path: PathBuf, depth: usize) -> Result<(), CalibrationError> {
        if path.is_dir() {
            let footage = !NOT_FOOTAGE.iter().any(|name| is_named(&path, name));
            return if depth > 0 && footage { self.visit(&path, depth - 1) } else { Ok(()) };
        }
        let ending = ending(&path);
        if VIDEOS.contains(&ending.as_str()) {
            self.videos.push(path);
        } else if IMAGES.contains(&ending.as_str()) {
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            self.folders.entry(folder).or_default().push(path);
        }
        Ok(())
    }
}

/// Not hidden, and not a capture that was prepared of the footage beside it.
pub(crate) fn is_footage(path: &Path) -> bool {
    let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
    !hidden && !path.join("prepare.json").exists()
}

/// Whether a file is a video or an image, by its name.
pub(crate) fn is_picture(path: &Path) -> bool {
    let ending = ending(path);
    VIDEOS.contains(&ending.as_str()) || IMAGES.contains(&ending.as_str())
}

/// The ending of a file's name, in lower case.
fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Whether a video was made to calibrate the camera or shows the empty scene, by its name.
fn shows_something_else(video: &Path) -> bool {
    const BEGINNINGS: [&str; 9] =
        ["calib", "intrinsic", "extrinsic", "checker", "chess", "charuco", "background", "empty", "clean"];
    let name = stem(video).to_lowercase();
    name.split(|c: char| !c.is_alphanumeric())
        .any(|word| BEGINNINGS.iter().any(|with| word.starts_with(with)))
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The file name without folder and ending.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Images of one folder in natural order; none when there is no such folder.
pub(crate) fn images_in(folder: &Path) -> Vec<PathBuf> {
    let mut media = Media::default();
    // A folder that cannot be read has no images for us; the caller reports that.
    let _ = media.visit(folder, 0);
    let mut files = media.folders.remove(folder).unwrap_or_default();
    files.sort_by(|a, b| natural_order(a, b));
    files
}

/// A number of so many digits is the serial number of a camera; a shorter one may count anything.
const SERIAL_DIGITS: usize = 4;

/// Whether the words of `name`, a serial number or no number, come one after the other in `text`; case does not matter.
fn has_words(text: &str, name: &str) -> bool {
    let words = |text: &str| -> Vec<String> {
        text.to_lowercase().split(|c: char| !c.is_alphanumeric()).map(ToOwned::to_owned).collect()
    };
    let (text, name_words) = (words(text), words(name));
    let tells = name.chars().any(char::is_alphabetic) || name.len() >= SERIAL_DIGITS;
    tells && text.windows(name_words.len()).any(|run| run == name_words)
}

/// A name in lower case without separators, as runs of letters and numbers: `cam_01` and `Cam1` are spelt alike.
fn spelling(name: &str) -> Vec<(bool, usize, String)> {
    chunks(&name.to_lowercase().replace(|c: char| !c.is_alphanumeric(), ""))
}

fn is_named(path: &Path, name: &str) -> bool {
    path.file_name().is_some_and(|n| n.to_string_lossy().eq_ignore_ascii_case(name))
}

/// Orders `cam2` before `cam10`: digits compare by value.
pub(crate) fn natural_order(a: &Path, b: &Path) -> Ordering {
    let parts = |p: &Path| chunks(&p.to_string_lossy());
    parts(a).cmp(&parts(b)).then_with(|| a.cmp(b))
}

/// Runs of digits and of other characters; digits as (length without leading zeros, text).
fn chunks(text: &str) -> Vec<(bool, usize, String)> {
    let mut out: Vec<(bool, usize, String)> = Vec::new();
    for c in text.chars() {
        match out.last_mut() {
            Some((digits, _, run)) if *digits == c.is_ascii_digit() => run.push(c),
            _ => out.push((c.is_ascii_digit(), 0, c.to_string())),
        }
    }
    for (digits, length, run) in &mut out {
        if *digits {
            *run = run.trim_start_matches('0').to_owned();
            *length = run.len();
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    /// A folder of empty files, and what is found in it.
    fn laid_out(files: &[&str]) -> (TempDir, Media) {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
        let media = Media::find(folder.path()).unwrap();
        (folder, media)
    }

    #[test]
    fn numbers_order_by_value() {
        let mut names: Vec<PathBuf> =
            ["c10.png", "c9.png", "c009a.png", "b11.png"].iter().map(PathBuf::from).collect();
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["b11.png", "c9.png", "c009a.png", "c10.png"].map(PathBuf::from));
    }

    #[test]
    fn a_camera_is_found_by_any_of_its_names() {
        let (folder, media) = laid_out(&[
            "videos/cam_1.mp4",
            "deep/er/CAM_1.mp4",
            "images/03/1.png",
            "masks/04/1.png",
            ".x/cam_5.mp4",
        ]);
        let of = |names: &[&str]| media.of_camera(&names.iter().map(ToString::to_string).collect::<Vec<_>>());
        assert_eq!(of(&["1", "cam_1"]), Some(Pictures::Video(folder.path().join("videos/cam_1.mp4"))));
        assert_eq!(of(&["03"]), Some(Pictures::Files(vec![folder.path().join("images/03/1.png")])));
        assert_eq!((of(&["04"]), of(&["cam_5"])), (None, None));
    }

    /// The layouts of SLEAP's, Anipose's and Qualisys' sessions.
    #[test]
    fn a_video_is_found_by_its_folder_or_by_a_word_of_its_name() {
        let files = [
            "back/trial.mp4",
            "back/boards/trial-back.mp4",
            "2019-08-02-vid01-camA.mp4",
            "2019-08-02-vid01-cam_B.mp4",
            "one-C.mp4",
            "two-C.mp4",
            "trial_Miqus_1_23087.avi",
        ];
        let (folder, media) = laid_out(&files);
        let mut assumed = Vec::new();
        let mut of = |name: &str| {
            let names = [name.to_owned(), format!("cam{name}"), format!("cam_{name}")];
            media.likely_of_camera(&names, &mut assumed)
        };
        let video = |file: &str| Some(Pictures::Video(folder.path().join(file)));
        assert_eq!(of("back"), video("back/trial.mp4"));
        assert_eq!([of("A"), of("b")], [video(files[2]), video(files[3])]);
        assert_eq!([of("C"), of("02"), of("vid")], [None, None, None], "two, a number, a part of a word");
        assert_eq!([of("23087"), of("2308")], [video(files[6]), None], "a serial number of Qualisys");
        assert!(assumed.len() == 4 && assumed[1].contains("vid01-camA.mp4"), "{assumed:?}");
    }

    #[test]
    fn videos_of_something_else_are_told_by_their_names() {
        let others = ["cam1/background.avi", "cam1/checkerboard.avi", "cam1/intrinsics.avi"];
        let (folder, media) = laid_out(
            &[&others[..], &["cam1/video.avi", "cam2/a.avi", "cam2/b.avi", "cam3/empty.avi"]].concat(),
        );
        let mut assumed = Vec::new();
        let mut of = |name: &str| media.likely_of_camera(&[name.to_owned()], &mut assumed);
        let video = |file: &str| Some(Pictures::Video(folder.path().join(file)));
        assert_eq!([of("cam1"), of("cam2")], [video("cam1/video.avi"), None], "two that are footage");
        assert_eq!(of("cam3"), video("cam3/empty.avi"), "the only one");
        assert!(
            assumed[0].contains("background.avi, checkerboard.avi, intrinsics.avi beside it"),
            "{assumed:?}"
        );
    }

    /// Pose2Sim's calibrations call `cam_01` what its videos call `cam01`.
    #[test]
    fn a_name_may_be_spelt_otherwise() {
        let files = [
            "videos/cam01.mp4",
            "videos/Cam-2.mp4",
            "images/camera_3/1.png",
            "a/view4.mp4",
            "b/view_04.mp4",
            "7.mp4",
        ];
        let (folder, media) = laid_out(&files);
        let mut assumed = Vec::new();
        let mut of = |name: &str| media.likely_of_camera(&[name.to_owned()], &mut assumed);
        let video = |file: &str| Some(Pictures::Video(folder.path().join(file)));
        assert_eq!([of("cam_01"), of("cam02")], [video(files[0]), video(files[1])]);
        assert_eq!(of("camera3"), Some(Pictures::Files(vec![folder.path().join(files[2])])));
        assert_eq!(
            [of("view.4"), of("cam_10"), of("07")],
            [None, None, None],
            "two, another number, no word"
        );
        assert!(
            assumed.len() == 3 && assumed[0].ends_with("cam01.mp4 has the pictures of camera 'cam_01'"),
            "{assumed:?}"
        );
    }

    #[test]
    fn one_of_several_videos_of_a_camera_is_told() {
        let (_folder, media) =
            laid_out(&["calibration/port_1.mp4", "recordings/trial/port_1.mp4", "port_2.mp4"]);
        let mut assumed = Vec::new();
        for name in ["port_1", "port_2"] {
            assert!(media.likely_of_camera(&[name.to_owned()], &mut assumed).is_some());
        }
        assert!(assumed.len() == 1 && assumed[0].contains("calibration/port_1.mp4"), "{assumed:?}");
        assert!(assumed[0].ends_with("of camera 'port_1', of 2 that go by its name"), "{assumed:?}");
    }
}
