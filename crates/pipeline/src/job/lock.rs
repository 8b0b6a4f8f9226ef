//! One writer at a time in an output folder.
//!
//! The system's file lock is what counts where there is one: it ends with its process, however that ends. Some network file
//! systems have none, or do not tell other machines of it. For these the file says who holds it and when that process was
//! last alive.

use crate::outputs::folder::RunFolder;
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How often a holder says that it is alive.
const BEAT: Duration = Duration::from_secs(10);
/// A holder on another machine that has been silent for so long is dead, if its clock is right.
const SILENCE: Duration = Duration::from_mins(1);
/// How long a holder on another machine that seems silent is watched: its clock may be wrong, but it says that it is alive.
const WATCH: Duration = if cfg!(test) { Duration::from_millis(300) } else { Duration::from_secs(30) };
/// Tries, when the file is removed by another holder in the moment of taking it.
const TRIES: usize = 10;

/// The right to write into a folder; given back when dropped.
#[derive(Debug)]
pub struct FolderLock {
    path: PathBuf,
    stop: Option<Sender<()>>,
    beats: Option<JoinHandle<()>>,
}

/// The process that holds a folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Holder {
    /// Start of the machine, unique among machines; empty where the system does not say.
    boot: String,
    pid: u32,
    /// When the lock was taken (ns since 1970): two locks of one process differ.
    taken: u64,
    /// When the holder was last alive (s since 1970).
    alive: u64,
}

impl FolderLock {
    /// Takes the folder, which is made when there is none.
    ///
    /// # Errors
    /// When another process writes into it, the lock file cannot be written, or parts of the folder are links.
    pub fn take(folder: &Path) -> Result<Self> {
        let path = folder.join("run.lock");
        let cannot = || format!("cannot write {}; is the folder writable, the disk full?", path.display());
        std::fs::create_dir_all(folder).with_context(cannot)?;
        RunFolder(folder.to_owned()).refuse_links()?;
        // A link or a pipe of whoever made the folder would be written through.
        if std::fs::symlink_metadata(&path).is_ok_and(|info| !info.is_file()) {
            bail!("{} is a link, pipe or folder and no lock; remove it", path.display());
        }
        for _ in 0..TRIES {
            let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
            let mut file = options.with_context(cannot)?;
            let before = read(&mut file);
            let locked = match file.try_lock() {
                Ok(()) => true,
                Err(TryLockError::WouldBlock) => bail!(in_use(folder, before.as_ref())),
                Err(TryLockError::Error(_)) => false,
            };
            if before.as_ref().is_some_and(|holder| holder.is_alive(locked, || speaks(&path, holder))) {
                bail!(in_use(folder, before.as_ref()));
            }
            let mine = Holder::new();
            write(&mut file, &mine).with_context(cannot)?;
            // The file may have been removed by its last holder since it was opened: then this lock is of nothing.
            if File::open(&path).ok().and_then(|mut now| read(&mut now)).as_ref() == Some(&mine) {
                return Ok(Self::beating(path, file, mine));
            }
        }
        bail!("{} is locked by one process after another; choose another --out", folder.display())
    }

    fn beating(path: PathBuf, mut file: File, mut mine: Holder) -> Self {
        let (stop, stopped) = channel();
        let beats = std::thread::spawn(move || {
            while stopped.recv_timeout(BEAT) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                mine.alive = seconds(SystemTime::now());
                // A full disk must not end the run; the system's lock still holds.
                let _ = write(&mut file, &mine);
            }
        });
        Self { path, stop: Some(stop), beats: Some(beats) }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // Removed while it is held, so that nobody can hold a file that is removed afterwards.
        let _ = std::fs::remove_file(&self.path);
        drop(self.stop.take());
        if let Some(beats) = self.beats.take() {
            let _ = beats.join();
        }
    }
}

impl Holder {
    fn new() -> Self {
        let now = SystemTime::now();
        let taken = now.duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos() as u64);
        Self { boot: boot(), pid: std::process::id(), taken, alive: seconds(now) }
    }

    /// Whether this holder still writes, when the system's lock could be taken (`locked`) or could not tell. One on another
    /// machine that seems silent, or to live in the future, is asked by `speaks`.
    fn is_alive(&self, locked: bool, speaks: impl FnOnce() -> bool) -> bool {
        let here = !self.boot.is_empty() && self.boot == boot();
        if here {
            return !locked && Path::new("/proc").join(self.pid.to_string()).exists();
        }
        let silent = seconds(SystemTime::now()).checked_sub(self.alive);
        silent.is_some_and(|silent| silent < SILENCE.as_secs()) || speaks()
    }
}

/// Whether the lock of `holder` changes while it is watched.
fn speaks(path: &Path, holder: &Holder) -> bool {
    tracing::info!("{}: waiting {} s for a sign of its holder", path.display(), WATCH.as_secs());
    (0..30).any(|_| {
        std::thread::sleep(WATCH / 30);
        File::open(path).ok().and_then(|mut file| read(&mut file)).is_some_and(|now| now != *holder)
    })
}

fn in_use(folder: &Path, holder: Option<&Holder>) -> String {
    let who = holder.map_or_else(String::new, |h| format!(" (process {})", h.pid));
    let folder = folder.display();
    format!("another run writes into {folder}{who}; wait for its end, stop it, or choose another --out")
}

fn boot() -> String {
    std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default().trim().to_owned()
}

fn seconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |t| t.as_secs())
}

fn read(file: &mut File) -> Option<Holder> {
    let mut text = String::new();
    file.rewind().and_then(|()| file.take(4096).read_to_string(&mut text)).ok()?;
    serde_json::from_str(&text).ok()
}

/// Replaces the file's text; both are of nearly one length, so that a reader seldom sees half of it.
fn write(file: &mut File, holder: &Holder) -> std::io::Result<()> {
    let text = serde_json::to_string(holder)?;
    file.rewind()?;
    file.write_all(text.as_bytes())?;
    file.set_len(text.len() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_writer_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let first = FolderLock::take(&out).unwrap();
        let error = FolderLock::take(&out).unwrap_err().to_string();
        assert!(error.contains("another run writes into") && error.contains("process"), "{error}");
        drop(first);
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
        FolderLock::take(&out).unwrap();
    }

    #[test]
    fn a_dead_holder_gives_way_and_one_on_another_machine_until_it_is_silent() {
        let folder = tempfile::tempdir().unwrap();
        let leave = |holder: &Holder| {
            let text = serde_json::to_string(holder).unwrap();
            std::fs::write(folder.path().join("run.lock"), text).unwrap();
        };
        // Killed here: the system has given its lock back.
        leave(&Holder { pid: 1, ..Holder::new() });
        drop(FolderLock::take(folder.path()).unwrap());
        // On a network file system: the other machine's lock is not seen.
        let elsewhere = Holder { boot: "elsewhere".into(), ..Holder::new() };
        leave(&elsewhere);
        assert!(FolderLock::take(folder.path()).unwrap_err().to_string().contains("another run"));
        leave(&Holder { alive: elsewhere.alive - 2 * SILENCE.as_secs(), ..elsewhere });
        drop(FolderLock::take(folder.path()).unwrap());
        std::fs::write(folder.path().join("run.lock"), "damaged").unwrap();
        drop(FolderLock::take(folder.path()).unwrap());
    }

    #[test]
    fn clocks_of_machines_may_differ() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.lock");
        let hour = 3600;
        let now = seconds(SystemTime::now());
        for alive in [now - hour, now + hour] {
            let leave = |alive| {
                let holder = Holder { boot: "elsewhere".into(), alive, ..Holder::new() };
                std::fs::write(&path, serde_json::to_string(&holder).unwrap()).unwrap();
            };
            leave(alive);
            let told = std::thread::scope(|scope| {
                let taking = scope.spawn(|| FolderLock::take(folder.path()).map(drop));
                std::thread::sleep(WATCH / 3);
                leave(alive + BEAT.as_secs());
                taking.join().unwrap().unwrap_err().to_string()
            });
            assert!(told.contains("another run writes into"), "{told}");
            // Nothing more is heard of it.
            drop(FolderLock::take(folder.path()).unwrap());
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_lock_file_is_not_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let (lock, other) = (folder.path().join("run.lock"), folder.path().join("other"));
        std::fs::write(&other, "precious").unwrap();
        std::os::unix::fs::symlink(&other, &lock).unwrap();
        let told = FolderLock::take(folder.path()).unwrap_err().to_string();
        assert!(told.contains("run.lock is a link"), "{told}");
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "precious");
        std::fs::remove_file(&lock).unwrap();
        std::fs::create_dir(&lock).unwrap();
        assert!(
            FolderLock::take(folder.path())
                .unwrap_err()
                .to_string()
                .contains("run.lock is a link, pipe or folder")
        );
    }

    #[test]
    fn without_the_systems_lock_a_holder_here_lives_as_long_as_its_process() {
        let own = Holder::new();
        if !own.boot.is_empty() {
            let silent = || false;
            assert!(own.is_alive(false, silent) && !own.is_alive(true, silent));
            assert!(!Holder { pid: u32::MAX, ..own }.is_alive(false, silent));
        }
    }
}
