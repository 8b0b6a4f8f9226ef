//! The generator of captures (`fixtures/monaco`) in a virtual environment below the target folder.

use crate::{ffgs, setup, workspace};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

const SOURCES: &str = "fixtures/monaco";
/// Every file that says what is installed: when one changes, the environment is brought up to date.
const PINS: [&str; 3] = ["requirements-test.txt", "requirements.txt", "constraints.txt"];

/// Blender's wheel exists for this version of Python only.
const PYTHON_VERSION: (u8, u8) = (3, 11);
const PYTHONS: [&str; 4] = ["python3.11", "python3", "python", "/usr/bin/python3.11"];
const PYTHON_PACKAGE: &str = "python3.11-venv";
/// Debian packages of the libraries that Blender's module loads but does not bring.
const BLENDER_LIBRARIES: [&str; 7] =
    ["libgl1", "libsm6", "libx11-6", "libxfixes3", "libxi6", "libxkbcommon0", "libxrender1"];

/// What is installed: enough for the tests without Blender, or everything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Extent {
    /// `requirements-test.txt`
    Tests,
    /// `requirements.txt`: Blender (`bpy`) and Snakemake as well.
    Rendering,
}

impl Extent {
    fn requirements(self) -> &'static str {
        match self {
            Self::Tests => PINS[0],
            Self::Rendering => PINS[1],
        }
    }
}

/// `cargo xtask monaco ARGS`: `python -m monaco ARGS`, in the folder of the caller.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<ExitCode> {
    let environment = Environment::open(root)?;
    environment.install(Extent::Rendering, Pip::Talks)?;
    let mut python = environment.python();
    if args.first().is_some_and(|command| command == "tracks") {
        python.env("FFGS", ffgs::build(root)?);
    }
    let words = if args.is_empty() { vec!["--help".to_owned()] } else { args.to_vec() };
    let status = python.args(["-m", "monaco"]).args(words).status().context("cannot start Python")?;
    Ok(workspace::exit_code(status))
}

/// Whether pip shows its progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Pip {
    /// Progress bars and the names of the packages.
    Talks,
    /// Errors only.
    IsQuiet,
}

/// A virtual environment with Python 3.11.
#[derive(Debug)]
pub(crate) struct Environment {
    sources: PathBuf,
    folder: PathBuf,
}

impl Environment {
    /// Opens the environment; makes it where it is missing or its Python is gone.
    pub(crate) fn open(root: &Path) -> Result<Self> {
        let folder = workspace::target(root).join("monaco-venv");
        let environment = Self { sources: root.join(SOURCES), folder };
        if !is_usable(&environment.interpreter()) {
            environment.make()?;
        }
        Ok(environment)
    }

    fn make(&self) -> Result<()> {
        let python = find_python()?;
        println!("monaco: making a virtual environment in {}", self.folder.display());
        let status = Command::new(python)
            .args(["-m", "venv", "--clear"])
            .arg(&self.folder)
            .status()
            .with_context(|| format!("cannot start {python}"))?;
        ensure!(status.success(), "{python} -m venv {} failed; its words are above", self.folder.display());
        Ok(())
    }

    /// Installs the pinned packages unless that has been done; an interrupted installation is taken up again.
    pub(crate) fn install(&self, extent: Extent, pip: Pip) -> Result<()> {
        let pins = self.pins()?;
        let mark = self.folder.join(format!("{}.installed", extent.requirements()));
        if std::fs::read_to_string(&mark).is_ok_and(|text| text == pins) {
            return Ok(());
        }
        println!("monaco: installing {SOURCES}/{}", extent.requirements());
        self.pip(extent, pip)?;
        if extent == Extent::Rendering {
            self.load_blender()?;
        }
        std::fs::write(&mark, pins).with_context(|| format!("cannot write {}", mark.display()))
    }

    fn pins(&self) -> Result<String> {
        let read = |name: &str| {
            let path = self.sources.join(name);
            std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
        };
        PINS.iter().map(|name| read(name)).collect()
    }

    fn pip(&self, extent: Extent, pip: Pip) -> Result<()> {
        let mut command = self.python();
        command.args(["-m", "pip", "install", "--disable-pip-version-check", "--retries", "2"]);
        if pip == Pip::IsQuiet {
            command.arg("--quiet");
        }
        command.arg("--requirement").arg(self.sources.join(extent.requirements()));
        let status = command.status().context("cannot start pip")?;
        if status.success() {
            return Ok(());
        }
        let hint = match extent {
            Extent::Tests => "",
            Extent::Rendering => {
                " bpy, Blender's module, exists as a wheel for Python 3.11 on Linux (x86-64, glibc 2.28 or newer), \
                 Windows (x86-64) and macOS (arm64): elsewhere only the tests run, with `cargo xtask ci`."
            }
        };
        bail!(
            "pip could not install {SOURCES}/{}; its words are above. Is the package index reachable?{hint}",
            extent.requirements()
        );
    }

    /// Blender's module must load; the system libraries that it lacks are installed where that is possible.
    fn load_blender(&self) -> Result<()> {
        let load = || output_of(self.python().args(["-c", "import bpy"]));
        if load().is_ok() {
            return Ok(());
        }
        let installed = setup::install(&BLENDER_LIBRARIES);
        load().and(installed).context("Blender's module (bpy) does not load")
    }

    /// This environment's Python with the generator on its path.
    pub(crate) fn python(&self) -> Command {
        let mut command = Command::new(self.interpreter());
        command.env("PYTHONPATH", &self.sources);
        command
    }

    /// The same, started in the generator's folder, where its tests and its linter are configured.
    pub(crate) fn python_at_home(&self) -> Command {
        let mut command = self.python();
        command.current_dir(&self.sources);
        command
    }

    fn interpreter(&self) -> PathBuf {
        self.folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" })
    }
}

/// A Python 3.11 that can make virtual environments; installed where that is possible.
fn find_python() -> Result<&'static str> {
    let present = || PYTHONS.into_iter().find(is_usable);
    if let Some(python) = present() {
        return Ok(python);
    }
    let installed = setup::install(&[PYTHON_PACKAGE]);
    present().ok_or_else(|| missing_python(installed))
}

fn missing_python(installed: Result<()>) -> anyhow::Error {
    let help = "the generator needs Python 3.11 with its venv module (Blender's wheel is for no other version), and no \
                `python3.11`, `python3` or `python` on the PATH is one. Debian 12: `sudo apt-get install \
                python3.11-venv`; elsewhere `uv python install 3.11` or `pyenv install 3.11`, then put it on the PATH";
    installed.err().map_or_else(|| anyhow::anyhow!(help), |cause| cause.context(help))
}

fn is_usable(python: &impl AsRef<OsStr>) -> bool {
    let (major, minor) = PYTHON_VERSION;
    let code = format!("import sys, venv, ensurepip; sys.exit(sys.version_info[:2] != ({major}, {minor}))");
    output_of(Command::new(python).args(["-c", &code])).is_ok()
}

/// Runs a command silently; what it wrote to its standard error is the error.
fn output_of(command: &mut Command) -> Result<()> {
    let output = command.stdin(Stdio::null()).output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr).trim());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(folder: &Path) -> Environment {
        let sources = workspace::root().unwrap().join(SOURCES);
        Environment { sources, folder: folder.to_path_buf() }
    }

    /// A stand-in for the environment's Python that fails, and with it every installation.
    #[cfg(unix)]
    fn broken_python(environment: &Environment) {
        let script = environment.interpreter();
        std::fs::create_dir_all(script.parent().unwrap()).unwrap();
        std::fs::write(&script, "#!/bin/sh\nexit 1\n").unwrap();
        let executable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&script, executable).unwrap();
    }

    #[test]
    fn every_requirement_is_pinned() {
        for line in environment(Path::new("")).pins().unwrap().lines() {
            let plain = line.is_empty() || line.starts_with(['#', '-']);
            assert!(plain || line.contains("=="), "{line}");
        }
    }

    #[test]
    fn an_environment_without_python_is_not_usable() {
        assert!(!is_usable(&Path::new("/nowhere/python")));
        assert!(!is_usable(&"false"));
    }

    #[test]
    fn what_is_installed_is_not_installed_again() {
        let folder = tempfile::tempdir().unwrap();
        let environment = environment(folder.path());
        let mark = folder.path().join("requirements.txt.installed");
        std::fs::write(mark, environment.pins().unwrap()).unwrap();
        environment.install(Extent::Rendering, Pip::IsQuiet).unwrap(); // there is no Python that could do it
        assert!(environment.install(Extent::Tests, Pip::IsQuiet).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_failed_installation_is_reported_and_leaves_no_mark() {
        let folder = tempfile::tempdir().unwrap();
        let environment = environment(folder.path());
        broken_python(&environment);
        let error = environment.install(Extent::Rendering, Pip::IsQuiet).unwrap_err().to_string();
        assert!(error.contains("requirements.txt") && error.contains("bpy"), "{error}");
        assert!(!folder.path().join("requirements.txt.installed").exists());
    }

    #[test]
    fn the_message_without_python_names_the_package() {
        let error = missing_python(Err(anyhow::anyhow!("no apt-get")));
        let text = format!("{error:#}");
        assert!(text.contains(PYTHON_PACKAGE) && text.contains("no apt-get"), "{text}");
    }
}
