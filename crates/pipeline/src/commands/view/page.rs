//! The files of the page that plays streams.

use anyhow::{Context, Result, bail};
use ffgs_core::write_atomically;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Our own, by their names.
pub(crate) const FILES: [(&str, &str); 16] = [
    ("index.html", include_str!("../../../web/index.html")),
    ("style.css", include_str!("../../../web/style.css")),
    ("player.js", include_str!("../../../web/player.js")),
    ("input.js", include_str!("../../../web/input.js")),
    ("frames.js", include_str!("../../../web/frames.js")),
    ("reader.js", include_str!("../../../web/reader.js")),
    ("columns.js", include_str!("../../../web/columns.js")),
    ("picture.js", include_str!("../../../web/picture.js")),
    ("choice.js", include_str!("../../../web/choice.js")),
    ("splats.js", include_str!("../../../web/splats.js")),
    ("colours.js", include_str!("../../../web/colours.js")),
    ("quality.js", include_str!("../../../web/quality.js")),
    ("overlay.js", include_str!("../../../web/overlay.js")),
    ("record.js", include_str!("../../../web/record.js")),
    ("sky.js", include_str!("../../../web/sky.js")),
    ("stream.js", include_str!("../../../web/stream.js")),
];

/// Name under which the page loads the PlayCanvas engine.
pub(crate) const ENGINE: &str = "playcanvas.mjs";
/// Names another place of the engine than that of `cargo xtask setup`.
const ENGINE_VARIABLE: &str = "FFGS_PLAYCANVAS";

/// The engine's file. It is no part of the program: `cargo xtask setup` gets it from npm and puts it beside the build.
pub(crate) fn engine() -> Result<PathBuf> {
    let installed = || {
        let program = std::env::current_exe().ok()?;
        let target = program.parent()?.parent()?;
        Some(target.join("players/node_modules/playcanvas/build/playcanvas.min.mjs"))
    };
    let place = std::env::var_os(ENGINE_VARIABLE).map(PathBuf::from).or_else(installed);
    match place {
        Some(file) if file.is_file() => Ok(file),
        place => bail!(
            "the PlayCanvas engine is not at {}: run `cargo xtask setup`, which gets it from npm, or set {ENGINE_VARIABLE} \
             to playcanvas.min.mjs",
            place.unwrap_or_default().display()
        ),
    }
}

fn put(file: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(file, |out| out.write_all(bytes))
        .with_context(|| format!("cannot write {}", file.display()))
}

/// Puts the page into a folder, to be served by any web server.
pub(crate) fn write_page(folder: &Path) -> Result<()> {
    let engine = engine()?;
    for (name, text) in FILES {
        put(&folder.join(name), text.as_bytes())?;
    }
    let bytes = std::fs::read(&engine).with_context(|| format!("cannot read {}", engine.display()))?;
    put(&folder.join(ENGINE), &bytes)
}
